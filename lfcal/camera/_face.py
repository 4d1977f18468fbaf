"""The public names of `lfcal.camera`, each loaded on first use."""

from __future__ import annotations

from lfcal.camera._doubts import doubts
from lfcal.camera.derived import Derived, derived_of, not_stated_for_noise
from lfcal.camera.description import MARKS, Camera, Marks
from lfcal.camera.distortion import BrownDistortion, LatticeDistortion
from lfcal.camera.draft import Draft
from lfcal.camera.forecast import Forecast
from lfcal.camera.importers import CAMERA_FORMATS, Imported, ImportOptions, import_camera, read_camera, read_raytrix_xml
from lfcal.camera.lattice import LensletLattice, LensType
from lfcal.camera.main_lens import MainLens, Microscope
from lfcal.camera.plan import ScanPlan, moved_onto_sensor
from lfcal.camera.presets import PRESETS, preset
from lfcal.camera.pupil_lenslets import NoLatticeError, PupilLenslets
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
    "ImportOptions",
    "Imported",
    "LatticeDistortion",
    "LensType",
    "LensletLattice",
    "MainLens",
    "Marks",
    "Microscope",
    "NoLatticeError",
    "PupilLenslets",
    "Quantity",
    "RegionPlan",
    "ScanPlan",
    "Sensor",
    "StageAxes",
    "derived_of",
    "doubts",
    "has_value",
    "import_camera",
    "moved_onto_sensor",
    "not_stated_for_noise",
    "preset",
    "quantities_of",
    "read_camera",
    "read_raytrix_xml",
    "value_at",
]
