"""Camera descriptions in any format: the interface of a reader, shared checks, and the reader for a file."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lfcal.base import FileFormatError, Registry, UnsafeFileError, check_regular, storage_errors
from lfcal.camera.description import Camera

__all__ = [
    "CAMERA_FORMATS",
    "CameraFormat",
    "ImportOptions",
    "Imported",
    "file_text",
    "import_camera",
    "number",
    "read_camera",
    "required",
]

MAX_BYTES = 1 << 24


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """Options for importing a camera file, and values that replace those of the file.

    Attributes
    ----------
    values
        Values that replace those of the file, by path, such as ``"sensor.pixel_um"`` (see `Draft`).
    resolution
        Name of the resolution preset to use from a Micro-Manager configuration; may be empty if there is only one.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ImportOptions, import_camera
    >>> options = ImportOptions({"optics.f_number": 5.6})
    >>> print(import_camera(Path("session", "camera.json"), options).camera.optics.f_number)
    5.6
    """

    values: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    resolution: str = ""


@dataclass(frozen=True, slots=True)
class Imported:
    """Imported camera (``camera``), whose values all have marks, and notes on the import (``notes``), one line each.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import Imported, import_camera
    >>> found: Imported = import_camera(Path("session", "camera.json"))
    >>> print(found.camera.name, found.camera.sensor.shape, found.notes)
    bench (sample session) (80, 96) ()
    """

    camera: Camera
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CameraFormat:
    """Reader for one format of files that describe a camera.

    Attributes
    ----------
    name
        Display name, such as ``"Raytrix XML"``.
    suffixes
        Usual file suffixes, only for file dialogs; the format is recognised from the text of the file.
    recognises
        Function that returns whether a file has this format, from the first characters of its text.
    read
        Function that returns the imported camera from the text and the path of the file and the `ImportOptions`. It
        raises `FileFormatError` if the text is invalid.
    rank
        Priority: formats are tried in ascending order of this number.
    """

    name: str
    suffixes: tuple[str, ...]
    recognises: Callable[[str], bool]
    read: Callable[[str, Path, ImportOptions], Imported]
    rank: int = 50


def required(entries: Mapping[str, Any], name: str, what: str) -> Any:
    """Return the entry ``name`` of ``entries``; raise `FileFormatError`, which names ``what``, if it is missing."""
    if name not in entries:
        raise FileFormatError.expected(what, f"the entry {name!r}", "none", "add this entry")
    return entries[name]


def number(entries: Mapping[str, Any], name: str, what: str, scale: float = 1.0) -> float | None:
    """Return the number in the entry ``name`` times ``scale``; None if the entry is missing or null.

    The result is rounded to 15 significant digits. Raise `FileFormatError`, which names ``what``, if the entry is not a
    finite number.
    """
    value = entries.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise FileFormatError.expected(f"{what}: {name}", "a number", repr(value)[:40], "replace it with a number")
    return float(f"{value * scale:.15g}")


def file_text(source: Path) -> str:
    """Return the text of the file ``source``: UTF-8, or UTF-16 with a byte-order mark, of at most `MAX_BYTES`.

    Raises
    ------
    FileFormatError
        If the file is not such text.
    UnsafeFileError
        If the file is larger.
    StorageError
        If the file cannot be read.
    """
    check_regular(source)
    with storage_errors(source), source.open("rb") as file:
        # one byte more than allowed shows that the file is too large, without reading all of it
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise UnsafeFileError.expected(
            str(source), "a camera description of at most 16 MB", "a larger file", "check the path"
        )
    utf16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        return data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError:
        raise FileFormatError.expected(
            str(source),
            "a camera description in UTF-8 or UTF-16 text",
            "binary data, or text in another encoding",
            "save the file as UTF-8",
        ) from None


CAMERA_FORMATS: Registry[CameraFormat] = Registry(
    "camera format", "lfcal.camera.importers", "FORMAT", "lfcal.camera_formats", order=lambda f: (f.rank, f.name)
)
"""All formats; the first that recognises a text reads it."""

HEAD = 1 << 14
"""Number of characters by which a format is recognised."""


def read_camera(path: str | os.PathLike[str], options: ImportOptions | None = None) -> Camera:
    """Return the camera described by a file in any supported format; `import_camera` also returns notes.

    The parameters and errors are those of `import_camera`.

    Examples
    --------
    >>> from lfcal import read_camera
    >>> print(read_camera("session/camera.json").name)
    bench (sample session)
    """
    return import_camera(path, options).camera


def import_camera(path: str | os.PathLike[str], options: ImportOptions | None = None) -> Imported:
    """Return the camera described by a file, with a mark for the origin of every value, and notes.

    Parameters
    ----------
    path
        Path of the file: ``camera.json``, Raytrix XML, oLaF YAML, metadata of napari-LF, configuration or metadata of
        Micro-Manager, or a format added by a plug-in package. The file must be UTF-8 or UTF-16 text of at most 16 MB.
    options
        Values that replace those of the file, and further options. None: none.

    Raises
    ------
    FileFormatError
        If the format is unknown, or an entry is missing or invalid.
    InputError
        If a value of the file or in ``options`` is invalid for a camera.
    UnsafeFileError
        If the file is too large, or is XML with a document type or entities.
    StorageError
        If the file cannot be read.

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
            return form.read(text, source, options or ImportOptions())
    names = ", ".join(form.name for form in CAMERA_FORMATS)
    raise FileFormatError.expected(
        str(source),
        f"a camera description ({names})",
        "a file of another format",
        "describe the camera with lfcal camera new",
    )
