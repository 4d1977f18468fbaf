"""Description of a camera (optics, lenslets, sensor) and the plan of its scan.

- ``main_lens``: photographic main lens or microscope
- ``lattice``: lenslet array, square or hexagonal, one or three types
- ``pupil_lenslets``: the single lenslets of a Fourier light-field microscope
- ``sensor``: pixels and noise
- ``distortion``: distortion of the micro-image lattice, and the manufacturer's distortion of the lens
- ``description``: the complete camera; depths, steps, JSON; which values are stated, measured, derived or assumed
- ``presets``: built-in cameras
- ``quantities``: names, units and usual limits of the values
- ``draft``: an incomplete camera, each value with its source; ``written``: values as users write them
- ``_doubts``: checks for implausible values: wrong units, and parts that do not match
- ``derived``: quantities derived from a camera, and the assumed values they depend on
- ``importers/``: readers for camera descriptions of other programs, one module per format
- ``shadow``: size of the image of a point
- ``stage``: relation between stage axes and the image
- ``plan``: the positions to record, and their order
- ``regions``: several regions of the field in one plan; ``_plan_files``: plans in the formats of other programs
- ``forecast``: time, disk space and memory of a scan
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.camera._face import *  # noqa: F403
    from lfcal.camera._shared import *  # noqa: F403

lazy_face(__name__)
