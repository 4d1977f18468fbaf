"""The public names of `lfcal.camera.importers`, each loaded on first use."""

from __future__ import annotations

from lfcal.camera.importers.camera_format import CameraFormat

__all__ = [
    "CameraFormat",
]
