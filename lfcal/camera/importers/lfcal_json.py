"""Reader for lfcal's own camera.json; refuses other JSON files."""

from __future__ import annotations

from pathlib import Path

from lfcal.base import FileFormatError, InputError
from lfcal.camera.description import Camera
from lfcal.camera.draft import Draft
from lfcal.camera.importers.camera_format import CameraFormat, Imported, ImportOptions

__all__ = ["FORMAT"]


def _read(text: str, source: Path, options: ImportOptions) -> Imported:
    try:
        camera = Camera.from_json(text)
    except InputError as error:
        raise FileFormatError(f"{source}: {error}") from None
    if options.values:
        camera = Draft.of(camera, options.values).camera(camera.name)
    return Imported(camera)


FORMAT = CameraFormat("camera.json", (".json",), lambda head: head[:1] in ("{", "["), _read, rank=90)
