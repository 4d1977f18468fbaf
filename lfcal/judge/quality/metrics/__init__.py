"""The quality metrics, one module per family; each lists its metrics in ``METRICS``.

- ``order``, ``stage``: assignment of frames to positions, and accuracy of the stage
- ``frames``, ``planes``, ``repeats``, ``session``: missing, copied, unusual, dark or misordered frames and planes
- ``cutout``, ``light``, ``noise``, ``saturation``, ``sensor``: values of the frames
- ``target``: frames of many points
- ``tiling``: whether one cell represents the field
- ``file``: whether H contains what it states

To add a metric, add a module here, or an entry point of group ``lfcal.metrics``.
"""
