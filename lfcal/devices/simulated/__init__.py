"""A simulated camera and stage.

- ``backend``: the backend, and `simulated_rig` for scripts and tests
- ``camera``, ``stage``: the devices; ``optics``: what light reaches the sensor, ``targets``: of many points
- ``faults``: what can be made to go wrong
"""
