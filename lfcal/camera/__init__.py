"""What the optics are.

- ``main_lens``: photographic main lens or microscope
- ``lattice``: lenslet array, square or hexagonal, one or three types
- ``sensor``: pixels and noise
- ``distortion``: the maker's distortion, kept with the camera
- ``marks``: which values are stated, measured, derived or assumed
- ``description``: the whole camera; depths, steps, JSON
- ``presets``: cameras that come with lfcal
- ``raytrix``: Raytrix calibration XML
- ``shadow``: how far the image of a point spreads
- ``stage``: how a stage's axes move the image
- ``plan``: which positions are recorded, and in which order
- ``forecast``: what that costs in time, disk and memory
"""

from lfcal.camera.description import Camera
from lfcal.camera.distortion import BrownDistortion, LatticeDistortion
from lfcal.camera.forecast import Forecast
from lfcal.camera.lattice import LensletLattice, LensType
from lfcal.camera.main_lens import MainLens, Microscope
from lfcal.camera.marks import MARKS, Marks
from lfcal.camera.plan import ScanPlan
from lfcal.camera.presets import PRESETS, preset
from lfcal.camera.raytrix import read_raytrix_xml
from lfcal.camera.sensor import Sensor
from lfcal.camera.stage import StageAxes

__all__ = [
    "MARKS",
    "PRESETS",
    "BrownDistortion",
    "Camera",
    "Forecast",
    "LatticeDistortion",
    "LensType",
    "LensletLattice",
    "MainLens",
    "Marks",
    "Microscope",
    "ScanPlan",
    "Sensor",
    "StageAxes",
    "preset",
    "read_raytrix_xml",
]
