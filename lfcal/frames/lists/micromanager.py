"""Micro-Manager's metadata as a list of frames: where the stage stood, exposures, size of a pixel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.base import FileFormatError, parse_json, read_text
from lfcal.frames.lists.listing import Listing
from lfcal.frames.part import parse_roi

__all__ = ["micromanager_list", "read_micromanager"]

MAX_BYTES = 1 << 30


_PLACES = ("XPositionUm", "YPositionUm", "ZPositionUm")


def micromanager_list(folder: Path) -> Path | None:
    """Return the metadata file of a folder that Micro-Manager saved; None where there is none, or several."""
    found = sorted(path for path in folder.glob("*metadata.txt") if path.is_file())
    return found[0] if len(found) == 1 else None


def read_micromanager(path: Path) -> tuple[Listing, dict[str, Any]]:
    """Return the frames of ``metadata.txt`` or ``…_metadata.txt`` with their stage coordinates, and common facts.

    Versions 1.4 (``FrameKey-…``) and 2.0 (``Metadata-…``): ``XPositionUm``, ``YPositionUm``, ``ZPositionUm``,
    ``Exposure-ms``, ``FileName``. Facts: ``pixel_um`` (``PixelSizeUm``, in object space), ``bit_depth`` and
    ``saturation``, and ``roi`` (``ROI``, the region of the camera as column, row, width and height).

    Raises
    ------
    FileFormatError
        If it is not Micro-Manager's, or an entry lacks its place.
    """
    body = parse_json(read_text(path, limit=MAX_BYTES), str(path), finite=False)
    entries = list(_frames(body))
    if not entries:
        raise FileFormatError.expected(
            str(path), "Micro-Manager's metadata of each frame", "none", "name a list of the frames with --manifest"
        )
    places = np.array([[_number(path, entry, key) for key in _PLACES] for entry in entries])
    exposures = [_optional(entry.get("Exposure-ms")) for entry in entries]
    known = tuple(ms / 1e3 for ms in exposures if ms is not None and ms > 0)
    files = tuple(str(entry["FileName"]) for entry in entries)
    note = f"positions: of the stage, as Micro-Manager wrote them to {path.name}"
    listing = Listing(
        path.name, files, (0,) * len(files), places, "um", known if len(known) == len(files) else None, notes=(note,)
    )
    facts: dict[str, Any] = {}
    size, bits = _optional(entries[0].get("PixelSizeUm")), _optional(entries[0].get("BitDepth"))
    if size:
        facts["pixel_um"] = size
    if bits and 1 <= bits <= 16:
        facts |= {"bit_depth": int(bits), "saturation": float((1 << int(bits)) - 1)}
    if (roi := parse_roi(entries[0].get("ROI"))) is not None:
        facts["roi"] = roi
    return replace(listing, roi=roi), facts


def _frames(body: Any) -> Iterator[dict[str, Any]]:
    """Yield the entry of each frame, in the order of the file."""
    if not isinstance(body, dict):
        return
    for key, entry in body.items():
        if str(key).startswith(("FrameKey", "Metadata-")) and isinstance(entry, dict) and entry.get("FileName"):
            yield entry


def _number(path: Path, entry: dict[str, Any], key: str) -> float:
    value = _optional(entry.get(key))
    if value is None and key != "ZPositionUm":
        raise FileFormatError.expected(
            f"{path}, {key} of {entry['FileName']}", "a number", entry.get(key), "record with the stage, or give a list"
        )
    return math.nan if value is None else value


def _optional(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None
