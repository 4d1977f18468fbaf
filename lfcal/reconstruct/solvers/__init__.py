"""Solvers, one module each.

- ``choice``: all solvers by name
- ``em`` (Richardson-Lucy, ISRA), ``least_squares``; ``records`` is what they report
- ``measurement``, ``penalty``, ``acceleration``, ``subsets``, ``smoothing``: what solvers are made of
"""
