"""Side-by-side timings: one module per benchmark, each with ``register(app)``; run by ``python -m benchmarks``."""
