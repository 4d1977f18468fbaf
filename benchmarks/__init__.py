"""Side-by-side timings, outside the installed package: ``python -m benchmarks NAME`` in the folder of the source.

One public module per benchmark, each with ``register(app)``; modules with an underscore are what they share.
"""
