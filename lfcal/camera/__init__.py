"""What the optics are.

- ``main_lens``: photographic main lens or microscope
- ``lattice``: lenslet array, square or hexagonal, one or three types
- ``sensor``: pixels and noise
- ``distortion``: the maker's distortion, kept with the camera
- ``marks``: which values are stated, measured, derived or assumed
- ``description``: the whole camera; depths, steps, JSON
- ``presets``: cameras that come with lfcal
- ``quantities``: what the values are called, their units and usual limits
- ``draft``: a camera in the making, each value with where it comes from
- ``doubts``: mistaken units, parts that do not fit each other
- ``derived``: what follows from a camera, and whether from assumed values
- ``importers/``: descriptions of cameras that others wrote, one format a file
- ``shadow``: how far the image of a point spreads
- ``stage``: how a stage's axes move the image
- ``lens_centre``: the micro-image centre next to a pixel
- ``plan``: which positions are recorded, and in which order
- ``regions``: several regions of the field in one plan
- ``forecast``: what that costs in time, disk and memory
"""

from lfcal.camera.derived import Derived, derived_of
from lfcal.camera.description import Camera
from lfcal.camera.distortion import BrownDistortion, LatticeDistortion
from lfcal.camera.doubts import doubts
from lfcal.camera.draft import Draft
from lfcal.camera.forecast import Forecast
from lfcal.camera.importers.camera_format import Imported, Wanted
from lfcal.camera.importers.opening import CAMERA_FORMATS, import_camera
from lfcal.camera.importers.raytrix_xml import read_raytrix_xml
from lfcal.camera.lattice import LensletLattice, LensType
from lfcal.camera.main_lens import MainLens, Microscope
from lfcal.camera.marks import MARKS, Marks
from lfcal.camera.plan import ScanPlan
from lfcal.camera.presets import PRESETS, preset
from lfcal.camera.quantities import QUANTITIES, Quantity, has_value, quantities_of, value_at
from lfcal.camera.regions import RegionPlan
from lfcal.camera.sensor import Sensor
from lfcal.camera.stage import StageAxes

__all__ = [
    "CAMERA_FORMATS",
    "MARKS",
    "PRESETS",
    "QUANTITIES",
    "BrownDistortion",
    "Camera",
    "Derived",
    "Draft",
    "Forecast",
    "Imported",
    "LatticeDistortion",
    "LensType",
    "LensletLattice",
    "MainLens",
    "Marks",
    "Microscope",
    "Quantity",
    "RegionPlan",
    "ScanPlan",
    "Sensor",
    "StageAxes",
    "Wanted",
    "derived_of",
    "doubts",
    "has_value",
    "import_camera",
    "preset",
    "quantities_of",
    "read_raytrix_xml",
    "value_at",
]
