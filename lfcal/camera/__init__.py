"""What the optics are.

- ``main_lens``: photographic main lens or microscope
- ``lattice``: lenslet array, square or hexagonal, one or three types
- ``sensor``: pixels and noise
- ``description``: the whole camera; depths, steps, JSON
- ``presets``: cameras that come with lfcal
- ``raytrix``: Raytrix calibration XML
- ``plan``: the scan plan and its forecast
"""

from lfcal.camera.description import Camera
from lfcal.camera.lattice import LensletLattice, LensType
from lfcal.camera.main_lens import MainLens, Microscope
from lfcal.camera.presets import PRESETS, preset
from lfcal.camera.sensor import Sensor

__all__ = ["PRESETS", "Camera", "LensType", "LensletLattice", "MainLens", "Microscope", "Sensor", "preset"]
