"""Flats and darks on disk, as single frames with exposures from names and files."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, StorageError
from lfcal.frames.aligned import shifted
from lfcal.frames.formats import image_suffixes, open_image, split_dataset

__all__ = ["CalibrationFrame", "find_frames"]

_UNITS = {"us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
# 10ms, exp_0.5s, 2p5ms; no letter may follow, or 3sets would be three seconds
_EXPOSURE = re.compile(r"(?<![\d.])(\d+(?:[.p]\d+)?)[ _]?(us|µs|ms|sec|s)(?![a-z])", re.IGNORECASE)


@dataclass(frozen=True, eq=False)
class CalibrationFrame:
    """A flat or dark frame that is read on demand.

    Attributes
    ----------
    source
        Path of the file, or the frame itself as an array ``(rows, columns)``.
    page
        Page of the file, from 0.
    exposure_s
        Exposure time (s); None if neither the file nor its name nor its folder's name states it.
    group
        Subfolder of the folder given to `find_frames`. Frames of different subfolders are different light levels.
    shift
        Number of bits by which left-aligned samples are shifted to the right.
    """

    source: Path | NDArray[Any]
    page: int = 0
    exposure_s: float | None = None
    group: str = ""
    shift: int = 0

    @property
    def label(self) -> str:
        """Name of the frame for messages."""
        if not isinstance(self.source, Path):
            return f"frame {self.page}"
        return f"{self.source.name}[{self.page}]" if self.page else self.source.name

    def read(self) -> NDArray[Any]:
        """Return the samples ``(rows, columns)``, shifted to the right by ``shift`` bits.

        Raises
        ------
        InputError
            If samples are not finite, or cannot be shifted without loss.
        """
        if isinstance(self.source, Path):
            image = open_image(self.source)
            try:
                values = image.read(self.page)
            finally:
                image.close()
        else:
            values = self.source
        if values.dtype.kind == "f" and not np.isfinite(values).all():
            raise InputError.expected(self.label, "finite samples", "NaN or infinity", "leave this frame out")
        return shifted(values, self.shift, self.label) if self.shift else values

    def moved(self, shift: int) -> CalibrationFrame:
        """Return the frame with its samples shifted to the right by ``shift`` bits instead of by the present number."""
        return replace(self, shift=shift)


def find_frames(path: Path) -> tuple[list[CalibrationFrame], dict[str, Any]]:
    """Return the frames in an image file, or in a folder and its subfolders, and the facts that their files state.

    The facts are ``cfa``, ``bit_depth`` and ``black_level``, as in `FrameMetadata`; unknown ones are missing.

    Frames are in the natural order of their names. The exposure is read from the file (``exposure_s``). If it is not
    there, it is read from the name of the file or its folder, such as ``flat_10ms_3.tif`` or ``0.5s/``.

    Raises
    ------
    LfcalError
        If there are no frames, or a file cannot be opened.
    """
    if not split_dataset(path)[0].exists():
        raise StorageError(f"{path}: no such file or folder; check the path")
    found: list[CalibrationFrame] = []
    facts: dict[str, Any] = {}
    for file in _files(path):
        image = open_image(file)
        try:
            facts |= {k: v for k, v in image.metadata.items() if k in ("cfa", "bit_depth", "black_level")}
            stated = _stated(image.metadata.get("exposure_s"), image.pages)
            pages = image.pages
        finally:
            image.close()
        inside = file.relative_to(path) if path.is_dir() else Path(file.name)
        named = _exposure_in(inside.stem) or next(filter(None, map(_exposure_in, reversed(inside.parent.parts))), None)
        group = str(inside.parent) if inside.parent.parts else ""
        found += [CalibrationFrame(file, k, stated[k] or named, group) for k in range(pages)]
    if not found:
        raise InputError.expected(f"frames in {path}", "images", "none", "check the folder")
    return found, facts


def _files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    suffixes = image_suffixes()
    files = [p for p in path.rglob("*") if p.is_file() and p.suffix.lower() in suffixes and not p.name.startswith(".")]
    return sorted(files, key=lambda p: _natural(str(p.relative_to(path))))


def _natural(text: str) -> list[tuple[int, str]]:
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", text) if part]


def _stated(value: Any, pages: int) -> list[float | None]:
    """Return the exposures that a file states, one per page."""
    if value is None:
        return [None] * pages
    known = np.broadcast_to(np.asarray(value, float).ravel(), (pages,)).tolist() if np.size(value) in (1, pages) else []
    return [v if np.isfinite(v) and v > 0 else None for v in known] or [None] * pages


def _exposure_in(name: str) -> float | None:
    match = _EXPOSURE.search(name)
    if match is None:
        return None
    return (float(match[1].lower().replace("p", ".")) * _UNITS[match[2].lower()]) or None
