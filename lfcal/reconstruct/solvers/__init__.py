"""Solvers, one module each, found by registry; other distributions bring theirs (``docs/adding_a_solver.md``).

- ``choice``: all solvers by name; ``solver``: what one is; ``records``: what it reports
- ``richardson_lucy``, ``total_variation``, ``tikhonov``, ``biggs_andrews``, ``nesterov``, ``ordered_subsets``,
  ``phase_space``, ``isra``: the multiplicative ones; ``em`` is the iteration they share
- ``least_squares``: conjugate gradients, for linear problems
- ``measurement``, ``penalty``, ``acceleration``, ``subsets``, ``smoothing``: what solvers are made of
"""
