"""What other packages of lfcal use of `lfcal.camera.importers`, and nobody else: it may change."""

from __future__ import annotations

from lfcal.camera.importers.camera_format import Imported, Wanted
from lfcal.camera.importers.opening import CAMERA_FORMATS, import_camera, read_camera
from lfcal.camera.importers.raytrix_xml import read_raytrix_xml

__all__ = [
    "CAMERA_FORMATS",
    "Imported",
    "Wanted",
    "import_camera",
    "read_camera",
    "read_raytrix_xml",
]
