"""A fit as its files tell of it later: what was found, when, and of which camera."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError, InputError, parse_json, read_text
from lfcal.camera import Camera
from lfcal.fit import FORMAT

__all__ = ["Dated", "fits_in", "read_dated"]

NAME, CAMERA = "fit.json", "camera.json"


@dataclass(frozen=True, eq=False)
class Dated:
    """One fit among others of the same camera.

    Attributes
    ----------
    label
        Its folder.
    when, recorded
        When the patterns were recorded, else when they were fitted (UTC); whether it is the former, None: the file's
        own time, for neither is known.
    camera
        The camera as found.
    values
        Value of each parameter by name, and its standard deviation with all else held.
    units, groups_of
        Unit, and group of unknowns, of each.
    groups
        Groups of unknowns that were fitted.
    complete
        Whether the model sufficed.
    middle_um
        The scanned region's middle (x, y) from the sensor's centre (µm).
    depths_um
        Depths as planned.
    """

    label: str
    when: datetime
    recorded: bool | None
    camera: Camera
    values: Mapping[str, tuple[float, float]]
    units: Mapping[str, str]
    groups_of: Mapping[str, str]
    groups: frozenset[str]
    complete: bool
    middle_um: tuple[float, float]
    depths_um: tuple[float, ...]


def fits_in(path: str | os.PathLike[str]) -> list[Path]:
    """Return the folders of the fits that a path names: a fit's folder or its fit.json, or a folder of such folders.

    Raises
    ------
    InputError
        If there is none.
    """
    place = Path(path)
    if place.is_file():
        return [place.parent]
    if (place / NAME).is_file():
        return [place]
    found = sorted(one.parent for one in place.glob(f"*/{NAME}")) if place.is_dir() else []
    if not found:
        got = "none" if place.is_dir() else "no such folder"
        raise InputError.expected(f"fits in {place}", f"{NAME} of lfcal fit", got, "name the folder that a fit wrote")
    return found


def read_dated(folder: str | os.PathLike[str], label: str = "") -> Dated:
    """Return the fit in a folder; ``label`` is what it is called, its folder's name by default.

    Raises
    ------
    FileFormatError
        If its files are no fit's, or damaged.
    StorageError
        If they cannot be read.
    """
    place = Path(folder)
    path = place / NAME
    data = parse_json(read_text(path), str(path))
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise FileFormatError.expected(str(path), "what lfcal fit writes", "something else", "name a fit's folder")
    camera = _camera(place / CAMERA)
    try:
        rows = data["parameters"]
        # what is held is the same in all of them
        values = {
            str(one["name"]): (_number(one["value"]), _number(one.get("sigma_held", one["sigma"]))) for one in rows
        }
        when, recorded = _when(data, path)
        # a region in the middle of the sensor where an older file does not say
        x, y = data.get("middle_um") or (0.0, 0.0)
        return Dated(
            label or place.resolve().name,
            when,
            recorded,
            camera,
            values,
            {str(one["name"]): str(one["unit"]) for one in rows},
            {str(one["name"]): str(one["group"]) for one in rows},
            frozenset(str(name) for name in data["groups"]),
            bool(data["complete"]),
            (_number(x), _number(y)),
            tuple(_number(z) for z in data["depths_um"]),
        )
    except (KeyError, TypeError, ValueError):
        raise FileFormatError.expected(str(path), "what lfcal fit writes", "a damaged file", "fit again") from None


def _camera(path: Path) -> Camera:
    try:
        return Camera.from_json(read_text(path))
    except InputError as error:
        raise FileFormatError(f"{path}: {error}") from None


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(value)
    return float(value)


def _when(data: Mapping[str, Any], path: Path) -> tuple[datetime, bool | None]:
    for name, recorded in (("recorded", True), ("fitted", False)):
        said = data.get(name)
        if isinstance(said, str) and said:
            found = datetime.fromisoformat(said)
            return found.astimezone(UTC) if found.tzinfo else found.replace(tzinfo=UTC), recorded
    return datetime.fromtimestamp(path.stat().st_mtime, UTC), None
