"""Benchmarks, outside the installed package: ``python -m benchmarks NAME`` in the folder of the source.

There is one public module per benchmark, each with ``register(app)``. Modules with an underscore contain shared code.
"""
