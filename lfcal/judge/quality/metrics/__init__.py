"""The quality metrics, one module per family; each names its metrics in ``METRICS``.

- ``order``, ``stage``: did frames and positions belong together, and did the stage go where it should?
- ``frames``, ``planes``, ``repeats``, ``session``: missing, copied, odd, dark, misordered
- ``cutout``, ``light``, ``noise``, ``saturation``, ``sensor``: the frames' values
- ``target``: frames of many points
- ``tiling``: does one cell stand for the field?
- ``file``: does H hold what it says?

A new module here, or an entry point of group ``lfcal.metrics``, is all a new metric takes.
"""
