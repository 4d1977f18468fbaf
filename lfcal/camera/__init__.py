"""What the optics are.

- ``main_lens``: photographic main lens or microscope
- ``lattice``: lenslet array, square or hexagonal, one or three types
- ``sensor``: pixels and noise
- ``distortion``: the maker's distortion, kept with the camera
- ``description``: the whole camera; depths, steps, JSON; which values are stated, measured, derived or assumed
- ``presets``: cameras that come with lfcal
- ``quantities``: what the values are called, their units and usual limits
- ``draft``: a camera in the making, each value with where it comes from
- ``_doubts``: mistaken units, parts that do not fit each other
- ``derived``: what follows from a camera, and whether from assumed values
- ``importers/``: descriptions of cameras that others wrote, one format a file
- ``shadow``: how far the image of a point spreads
- ``stage``: how a stage's axes move the image
- ``plan``: which positions are recorded, and in which order
- ``regions``: several regions of the field in one plan
- ``forecast``: what that costs in time, disk and memory
"""

from typing import TYPE_CHECKING

from lfcal._lazy import lazy_face

if TYPE_CHECKING:
    from lfcal.camera._face import *  # noqa: F403
    from lfcal.camera._shared import *  # noqa: F403

lazy_face(__name__)
