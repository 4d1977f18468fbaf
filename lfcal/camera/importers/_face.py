"""The public names of `lfcal.camera.importers`: each is loaded when it is asked for."""

from __future__ import annotations

from lfcal.camera.importers.camera_format import CameraFormat

__all__ = [
    "CameraFormat",
]
