"""What reads the description of a camera, and the checks such readers share."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from lfcal.base import FileFormatError, UnsafeFileError, check_regular, storage_errors
from lfcal.camera.description import Camera

__all__ = ["CameraFormat", "Imported", "Wanted", "file_text", "number", "required"]

MAX_BYTES = 1 << 24


@dataclass(frozen=True, slots=True)
class Wanted:
    """What the user says beside the file.

    Attributes
    ----------
    values
        Values by path (`lfcal.camera.draft.Draft`), which go before those of the file.
    resolution
        Name of the resolution preset of a Micro-Manager configuration; empty where there is one only.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import Wanted, import_camera
    >>> wanted = Wanted({"optics.f_number": 5.6})
    >>> print(import_camera(Path("session", "camera.json"), wanted).camera.optics.f_number)
    5.6
    """

    values: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    resolution: str = ""


@dataclass(frozen=True, slots=True)
class Imported:
    """A camera from a file, every value marked, and what is to be said of it, one line each.

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
    """A kind of file that describes a camera.

    Attributes
    ----------
    name
        For people: ``"Raytrix XML"``.
    suffixes
        Usual endings, for file dialogues; recognition goes by the text.
    recognises
        Whether a text, given its first characters, is of this kind.
    read
        Returns the camera of (text, file, what the user says); raises `FileFormatError`.
    rank
        Formats are asked from low to high.
    """

    name: str
    suffixes: tuple[str, ...]
    recognises: Callable[[str], bool]
    read: Callable[[str, Path, Wanted], Imported]
    rank: int = 50


def required(entries: Mapping[str, Any], name: str, what: str) -> Any:
    """Return the entry called ``name``; raise where it is missing."""
    if name not in entries:
        raise FileFormatError.expected(what, f"the entry {name!r}", "none", "add it")
    return entries[name]


def number(entries: Mapping[str, Any], name: str, what: str, scale: float = 1.0) -> float | None:
    """Return a number times ``scale``; None where the entry is missing or null."""
    value = entries.get(name)
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise FileFormatError.expected(f"{what}: {name}", "a number", repr(value)[:40], "correct it")
    return float(f"{value * scale:.15g}")


def file_text(source: Path) -> str:
    """Return the text of a description, UTF-8 or UTF-16, at most 16 MB."""
    check_regular(source)
    with storage_errors(source), source.open("rb") as file:
        # one byte more than allowed shows that the file is too large, without reading all of it
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise UnsafeFileError.expected(str(source), "a camera description of at most 16 MB", "more", "check the path")
    utf16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    try:
        return data.decode("utf-16" if utf16 else "utf-8-sig")
    except UnicodeDecodeError:
        raise FileFormatError.expected(
            str(source), "a camera description, text in UTF-8 or UTF-16", "other bytes", "check the path"
        ) from None
