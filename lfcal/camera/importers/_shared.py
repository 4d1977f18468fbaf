"""Names of `lfcal.camera.importers` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.camera.importers.camera_format import CAMERA_FORMATS, Imported, ImportOptions, import_camera, read_camera
from lfcal.camera.importers.raytrix_xml import read_raytrix_xml

__all__ = [
    "CAMERA_FORMATS",
    "ImportOptions",
    "Imported",
    "import_camera",
    "read_camera",
    "read_raytrix_xml",
]
