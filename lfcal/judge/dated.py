"""Read fits and inspections from their files, with their times, for trends."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from lfcal.base import RANK, FileFormatError, InputError, Merit, parse_json, read_text, stated_format
from lfcal.camera import Camera
from lfcal.fit import FORMAT as FIT_FORMAT
from lfcal.judge.quality import QualityReport

__all__ = [
    "DatedFit",
    "DatedInspection",
    "MetricScale",
    "MetricValue",
    "fits_in",
    "inspection_of",
    "inspections_in",
    "labels_of",
    "read_dated_fit",
    "read_inspection",
]

FIT, CAMERA = "fit.json", "camera.json"
QUALITY, QUALITY_FORMAT = "quality.json", "lfcal-quality"


@dataclass(frozen=True, eq=False)
class DatedFit:
    """One fit in a series of fits of the same camera.

    Attributes
    ----------
    label
        Name of the fit in the series, such as the name of its folder.
    when, recorded
        Time of the recording, or else of the fit (UTC), and whether ``when`` is the time of the recording. If neither
        is known, ``recorded`` is None and ``when`` is the time of the file.
    camera
        The fitted camera.
    values
        Value and standard deviation of each parameter, by name. The standard deviation assumes that the parameters that
        were not fitted have exactly their described values.
    units, groups_of
        Unit and group of each parameter.
    groups
        Names of the groups of unknowns that were fitted.
    complete
        Whether the model was complete.
    middle_um
        Middle (x, y) of the scanned region relative to the centre of the sensor (µm).
    depths_um
        Planned depths of the planes (µm).
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

    @property
    def verdict(self) -> str:
        """Whether the model was complete, as text."""
        return "the model is complete" if self.complete else "the model is incomplete"


def fits_in(path: str | os.PathLike[str]) -> list[Path]:
    """Return the folders of the fits at a path.

    ``path`` is the folder of a fit, its ``fit.json``, or a folder that contains such folders.

    Raises
    ------
    InputError
        If there is no fit at ``path``.
    """
    place = Path(path)
    if place.is_file():
        return [place.parent]
    if (place / FIT).is_file():
        return [place]
    found = sorted(one.parent for one in place.glob(f"*/{FIT}")) if place.is_dir() else []
    if not found:
        got = "none" if place.is_dir() else "no such folder"
        raise InputError.expected(f"fits in {place}", f"{FIT}, written by lfcal fit", got, "give the folder of a fit")
    return found


def read_dated_fit(folder: str | os.PathLike[str], label: str = "") -> DatedFit:
    """Return the fit in a folder; ``label`` is the name of the fit, by default the name of the folder.

    Raises
    ------
    FileFormatError
        If the files are damaged, or do not belong to a fit.
    StorageError
        If the files cannot be read.
    """
    place = Path(folder)
    path = place / FIT
    data = parse_json(read_text(path), str(path))
    if not isinstance(data, dict) or data.get("format") != FIT_FORMAT:
        raise FileFormatError.expected(
            str(path), "a file written by lfcal fit", stated_format(data), "give the folder of a fit"
        )
    camera = _camera(place / CAMERA)
    try:
        rows = data["parameters"]
        # fixed quantities are the same in all of them
        values = {
            str(one["name"]): (_number(one["value"]), _number(one.get("sigma_held", one["sigma"]))) for one in rows
        }
        when, recorded = _when(data, path)
        # older files do not state the region: use the middle of the sensor
        x, y = data.get("middle_um") or (0.0, 0.0)
        return DatedFit(
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
        raise FileFormatError.expected(
            str(path), "a file written by lfcal fit", "a damaged file", "run lfcal fit again"
        ) from None


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


@dataclass(frozen=True, slots=True)
class MetricValue:
    """Value of a metric in one session (NaN if unknown), and its rating, such as ``"good"``."""

    value: float
    merit: Merit


@dataclass(frozen=True, slots=True)
class MetricScale:
    """Title and unit of a metric, and its limits for good and bad values."""

    title: str
    unit: str
    good: float
    bad: float


@dataclass(frozen=True, eq=False)
class DatedInspection:
    """One inspection in a series of inspections of the same camera.

    Attributes
    ----------
    label, when, dated
        Name, time of the inspection (UTC), and whether this time is stated in the file; if not, it is the time of the
        file.
    verdict, merit
        Verdict as a sentence, and rating as a word, such as ``"good"``.
    values, scales
        Value and scale of each metric by its key.
    faults
        Fraction of the light that each fault changes, by its title. None: H was not compared with a camera.
    period
        Number of positions ``(ny, nx)`` of H; None if not stated.
    """

    label: str
    when: datetime
    dated: bool
    verdict: str
    values: Mapping[str, MetricValue]
    scales: Mapping[str, MetricScale]
    faults: Mapping[str, float] | None
    period: tuple[int, int] | None = None
    merit: Merit = "unknown"


def read_inspection(path: str | os.PathLike[str], label: str) -> DatedInspection:
    """Return a result of ``lfcal inspect``, with the name ``label`` in its series.

    ``path`` is the folder of a report, its ``quality.json``, or a file with the output of ``--json``.

    Raises
    ------
    FileFormatError
        If the file is not such a result, or is damaged.
    StorageError
        If the file cannot be read.
    """
    place = Path(path) / QUALITY if Path(path).is_dir() else Path(path)
    data = parse_json(read_text(place), str(place), remedy="run lfcal inspect again")
    if not isinstance(data, dict) or data.get("format") != QUALITY_FORMAT:
        raise FileFormatError.expected(
            str(place), "a file written by lfcal inspect", stated_format(data), "give the folder of its report"
        )
    try:
        said = data.get("inspected")
        when = datetime.fromisoformat(said) if isinstance(said, str) else None
        own = datetime.fromtimestamp(place.stat().st_mtime, UTC)
        model = data.get("model")
        faults = None
        if isinstance(model, Mapping) and model["compared"]:
            faults = {str(one["title"]): float(one["share"]) for one in model["faults"]}
        return _inspection(label, own if when is None else when, when is not None, data, faults)
    except (KeyError, TypeError, ValueError):
        remedy = "run lfcal inspect again"
        raise FileFormatError.expected(
            str(place), "a file written by lfcal inspect", "a damaged file", remedy
        ) from None


def inspection_of(report: QualityReport, label: str, when: datetime) -> DatedInspection:
    """Return the new inspection ``report`` as an entry ``label`` of a series.

    ``when`` is the time of the file that was inspected.
    """
    return _inspection(label, when, False, report.to_dict(), None)


def _inspection(
    label: str, when: datetime, dated: bool, data: Mapping[str, Any], faults: dict[str, float] | None
) -> DatedInspection:
    values, scales = {}, {}
    for one in data["metrics"]:
        key = str(one["key"])
        value = math.nan if one["value"] is None else float(one["value"])
        merit: Merit = one["merit"]
        if merit not in RANK:
            raise ValueError(merit)
        values[key] = MetricValue(value, merit)
        scales[key] = MetricScale(str(one["title"]), str(one["unit"]), float(one["good"]), float(one["bad"]))
    when = when if when.tzinfo is not None else when.replace(tzinfo=UTC)
    shape = data.get("shape")
    period = (int(shape[1]), int(shape[2])) if isinstance(shape, list | tuple) and len(shape) == 5 else None
    verdict, merit = str(data["verdict"]), data.get("merit", "unknown")
    if merit not in RANK:
        raise ValueError(merit)
    return DatedInspection(label, when.astimezone(UTC), dated, verdict, values, scales, faults, period, merit)


def inspections_in(path: Path) -> list[Path]:
    """Return the files of the inspections at a path.

    ``path`` is a file, the folder of a report with its ``quality.json``, or a folder that contains such folders.

    Raises
    ------
    InputError
        If there is no inspection at ``path``.
    """
    if path.is_file():
        return [path]
    found = [path / QUALITY] if (path / QUALITY).is_file() else []
    if not found and path.is_dir():
        found = sorted(path.glob(f"*/{QUALITY}"))
    if not found:
        got = "none" if path.is_dir() else "no such folder"
        raise InputError.expected(
            f"inspections in {path}",
            f"{QUALITY}, written by lfcal inspect --report, or an H file",
            got,
            "give the folder of the report",
        )
    return found


def labels_of(places: Sequence[Path]) -> list[str]:
    """Return the shortest names that distinguish the files ``places``, with the same number of parent folders in each.

    The name ``quality.json`` after a folder is omitted.
    """
    for above in range(1, 8):
        reported = ["/".join(place.parts[-above:]) for place in places]
        if len(set(reported)) == len(reported):
            return [label.removesuffix(f"/{QUALITY}") for label in reported]
    return [str(place) for place in places]
