"""The description of a camera in whatever format it is in."""

from __future__ import annotations

import os
from pathlib import Path

from lfcal.base import FileFormatError, Registry
from lfcal.camera.description import Camera
from lfcal.camera.importers.camera_format import CameraFormat, Imported, Wanted, file_text

__all__ = ["CAMERA_FORMATS", "import_camera", "read_camera"]

CAMERA_FORMATS: Registry[CameraFormat] = Registry(
    "camera format", "lfcal.camera.importers", "FORMAT", "lfcal.camera_formats", order=lambda f: (f.rank, f.name)
)
"""Every format there is; the first that recognises a text reads it."""

HEAD = 1 << 14
"""Characters that a format is recognised by."""


def read_camera(path: str | os.PathLike[str], wanted: Wanted | None = None) -> Camera:
    """Return the camera that a file in any known format describes; `import_camera` tells how its values are known, too.

    Raises what `import_camera` raises.

    Examples
    --------
    >>> from lfcal import read_camera
    >>> print(read_camera("session/camera.json").name)
    bench (sample session)
    """
    return import_camera(path, wanted).camera


def import_camera(path: str | os.PathLike[str], wanted: Wanted | None = None) -> Imported:
    """Return the camera that a file describes, every value marked as stated, derived or assumed.

    Parameters
    ----------
    path
        camera.json, Raytrix XML, oLaF yaml, metadata of napari-LF, configuration or metadata of Micro-Manager, or
        what other packages add. UTF-8 or UTF-16, at most 16 MB.
    wanted
        Values that the user states, which go before the file's.

    Raises
    ------
    FileFormatError
        If it is none of these, or an entry is missing or wrong.
    InputError
        If a value of ``wanted`` is refused.
    StorageError
        If it cannot be read.

    Examples
    --------
    >>> from lfcal.camera import import_camera
    >>> found = import_camera("session/camera.json")
    >>> camera = found.camera
    >>> print(camera.name, camera.sensor.shape, f"{camera.pitch_px:.2f} px, f/{camera.optics.f_number:g}")
    bench (sample session) (80, 96) 11.00 px, f/4
    """
    source = Path(path)
    text = file_text(source)
    head = text[:HEAD].lstrip()
    for form in CAMERA_FORMATS:
        if form.recognises(head):
            return form.read(text, source, wanted or Wanted())
    names = ", ".join(form.name for form in CAMERA_FORMATS)
    raise FileFormatError.expected(
        str(source), f"a camera description ({names})", "something else", "describe it with lfcal camera new"
    )
