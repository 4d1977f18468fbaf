"""Target of many points as the task PlanTarget, and its plan as table rows and drawings. No Qt."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, LfcalError, Work, drain, format_length, format_seconds, format_share, read_text
from lfcal.camera import ScanPlan
from lfcal.records import rows
from lfcal.tasks import PlanScan, PlanTarget
from lfcal_gui.models import PLAN_FILE, Project, ScanRates, shown_of

if TYPE_CHECKING:
    from lfcal.targets import TargetPlan
    from lfcal.tasks import TargetPlanned

PEAK = 0.8
"""Default fraction of the full well that the brightest pixel reaches."""

MOST_DRAWN = 6000
"""Largest number of points drawn; of more, only those of the first frames."""

RATES = ("speed", "frame_rate")
"""Fields shared by the forecasts of scan and target; the form of the scan shows them."""

OF_SCAN = (*RATES, "half_cell", "peak")
"""Fields in the form of the scan that are settings of the page instead of values of the plan."""

HELD_OF_TARGET = frozenset({"plan", "out", *RATES})
"""Fields of `lfcal.tasks.PlanTarget` that are not in the form of the target."""

ROWS = {row.name: row for kind in (PlanScan, PlanTarget) for row in rows(kind)}
TABLE = ("Plane", "Frames", "At least", "Points", "Phases", "Crosstalk")


@dataclass(frozen=True)
class PlanSettings(ScanRates):
    """Values of the fields of `lfcal.tasks.PlanTarget`; an empty ``source`` is a single point.

    ``half_cell`` and ``peak`` are those of `lfcal.tasks.PlanScan`.
    """

    source: str = ""
    tolerance: float = 0.1
    crosstalk: float = 0.005
    most_frames: int | None = None
    pose: str = ""
    regions: str = ""
    pose_within: str = ""
    signal: float | None = None
    half_cell: bool = False
    peak: float | None = PEAK

    @classmethod
    def read(cls, data: object) -> tuple[Self, tuple[str, ...]]:
        """Return the settings in ``data``, also with names of earlier projects, and the reasons for refused values."""
        if isinstance(data, Mapping):
            earlier = {"tolerance_px": "tolerance"}
            data = {earlier.get(name, name): "" if value == "point" else value for name, value in data.items()}
        return super().read(data)

    @property
    def many(self) -> bool:
        """Whether a target of many points is planned."""
        return bool(self.source)

    def usable(self) -> None:
        """Raise `InputError` if the task would refuse a value."""
        target_task(self if self.many else replace(self, source="array"))

    def changed(self, key: str, value: Any) -> Self:
        """Return the settings with one value changed; raise `InputError` if the value is refused."""
        given = value.strip() if isinstance(value, str) else value
        made = replace(self, **{key: ROWS[key].value(given, ROWS[key].label)})
        made.usable()
        return made

    def shown(self) -> dict[str, Any]:
        """Return the values shown in the forms."""
        of_scan = shown_of(PlanScan, {"half_cell": self.half_cell, "peak": self.peak})
        return shown_of(PlanTarget, self.to_dict()) | {key: of_scan[key] for key in ("half_cell", "peak")}

    @classmethod
    def of_plan(cls, plan: TargetPlan) -> PlanSettings:
        """Return the settings with which ``plan`` was made, as far as the plan contains them."""
        from lfcal.targets import target_words

        return cls(target_words(plan.target), plan.tolerance_px, max(plan.crosstalk), None, plan.target.pose.words)

    def at_rates_of(self, other: PlanSettings) -> PlanSettings:
        """Return the settings with the speed, frame rate and brightest pixel of ``other``."""
        return replace(self, speed=other.speed, frame_rate=other.frame_rate, peak=other.peak)


def target_task(settings: PlanSettings, out: str = "target_plan.json") -> PlanTarget:
    """Return the task that plans the target; raise `InputError` if the settings are invalid."""
    own = {one.name: getattr(settings, one.name) for one in fields(settings) if one.name not in ("half_cell", "peak")}
    return PlanTarget(plan=Path(PLAN_FILE), out=Path(out), **own)


def refused_setting(project: Project, key: str, value: Any) -> str:
    """Return why a setting of the plan cannot have a value; empty: it can."""
    state = project.state
    try:
        settings = PlanSettings.of(state).changed(key, value).into(state)
    except LfcalError as error:
        return str(error)
    return project.held(replace(state, settings=settings))


@dataclass(frozen=True, eq=False)
class PlaneDrawing:
    """Drawing of a plane.

    Attributes
    ----------
    points
        ``(n, 3)`` as (frame, row, column): images whose cutouts are on the sensor (px).
    few, many
        Smallest and largest number of points in a frame.
    shown
        Number of frames that show each position within the tolerance ``(ny, nx)``.
    """

    points: NDArray[np.float64]
    few: int
    many: int
    shown: NDArray[np.intp]

    @property
    def coverage(self) -> float:
        """Fraction of the positions that at least one frame shows."""
        return float((self.shown > 0).mean())

    def drawn(self) -> NDArray[np.float64]:
        """Return the points of as many first frames as can be drawn, at least those of the first frame."""
        if len(self.points) <= MOST_DRAWN:
            return self.points
        last = max(1.0, self.points[MOST_DRAWN, 0])
        drawn: NDArray[np.float64] = self.points[self.points[:, 0] < last]
        return drawn


@dataclass(frozen=True, eq=False)
class PlannedTarget:
    """A target plan with its drawings.

    Attributes
    ----------
    made
        Result of the task.
    planes
        Drawing of each plane.
    coding
        Advice on showing several frames together (coded frames); empty if it does not apply.
    """

    made: TargetPlanned
    planes: tuple[PlaneDrawing, ...]
    coding: str = ""

    @property
    def plan(self) -> TargetPlan:
        """The plan."""
        return self.made.plan

    @property
    def coding_briefly(self) -> str:
        """Short form of the advice on coded frames, for small windows."""
        verdict, *reasons = re.split(r" at (?=\d)", self.coding, maxsplit=1)
        return f"{verdict}." if reasons else verdict

    def summary(self) -> list[tuple[str, str, str]]:
        """Return rows (quantity, value for this target, value for a single point)."""
        ours, single = self.plan.forecast(**self.made.task.rates), self.made.forecast
        total = "Time, no readout" if ours.readout_hours is None else "Time"
        parts = {
            total: "hours",
            "  exposing": "exposure_hours",
            "  settling": "settle_hours",
            "  moving": "move_hours",
            "  reading out": "readout_hours",
        }
        return [
            ("Frames", f"{ours.frames:,}", f"{single.frames:,}"),
            *(
                (name, format_seconds(3600 * getattr(ours, key)), format_seconds(3600 * getattr(single, key)))
                for name, key in parts.items()
                if getattr(ours, key) is not None
            ),
            *self._expected(),
            *self._regions(single.frames, ours.frames),
        ]

    def _expected(self) -> Iterator[tuple[str, str, str]]:
        """Yield rows of expected noise in the middle plane and covered phases of all, for all and half of the frames.

        All planes have the same number of phases.
        """
        errors = self.made.facts["expected_error"]
        if not all(len(found["error"]) for found in errors):
            return
        middle = errors[len(errors) // 2]
        half = max(1, len(middle["error"]) // 2) - 1
        yield "Noise, middle plane", format_share(middle["error"][-1]), format_share(middle["single_point"])
        yield "  half-way", format_share(middle["error"][half]), ""
        halves = [found["shown"][max(1, len(found["shown"]) // 2) - 1] for found in errors]
        yield "Phases, all planes", format_share(float(np.mean([plane.coverage for plane in self.planes]))), "100 %"
        yield "  half-way", format_share(float(np.mean(halves))), ""

    def _regions(self, single: int, frames: int) -> Iterator[tuple[str, str, str]]:
        if "regions" in self.made.facts:
            found = self.made.facts["regions"]["regions"]
            yield f"Frames, {len(found)} regions", f"{frames:,}", f"{len(found) * single:,}"
            yield "  points in each", f"≥ {min(min(one['points']) for one in found):,}", ""


def iter_target(scan: ScanPlan, settings: PlanSettings) -> Work[PlannedTarget]:
    """Plan the target, as a job."""
    made = yield from target_task(settings).iter_planned(scan)
    return (yield from iter_drawn(made))


def iter_drawn(made: TargetPlanned) -> Work[PlannedTarget]:
    """Return a target plan with its drawings."""
    planes, count = [], len(made.plan.scan.depths_um)
    clock = Clock("finding covered phases", count)
    for z in range(count):
        yield clock.at(z)
        planes.append(_drawing(made.plan, z))
    return PlannedTarget(made, tuple(planes), _coding(made))


def _coding(made: TargetPlanned) -> str:
    """Return, as text, whether coded frames (several subsets of points at the same time) reduce the noise."""
    if made.plan.lit is not None:
        return "Frames of a display that shows several subsets of points together, coded with an S-matrix."
    words = "" if made.verdict is None else f"{made.verdict.frames_words}."
    return words[:1].upper() + words[1:]


def read_plan(path: str, settings: PlanSettings | None = None) -> ScanPlan | PlannedTarget:
    """Return the plan of a scan or of a target that is stored in a file.

    A target plan is returned with its forecast, for the speed, frame rate and brightest pixel of ``settings``.

    Raises
    ------
    LfcalError
        If the file contains no plan.
    """
    text = read_text(Path(path))
    if '"lfcal-target-plan"' not in text[:200]:
        return ScanPlan.from_json(text)
    from lfcal.targets import TargetPlan, coding_verdict

    plan = TargetPlan.from_json(text)
    task = target_task(PlanSettings("array").at_rates_of(settings or PlanSettings()))
    return drain(iter_drawn(task.planned(plan, None if plan.lit else coding_verdict(plan))))


def _drawing(plan: TargetPlan, z: int) -> PlaneDrawing:
    from lfcal.targets import whole_at

    images, frames = plan.images(z), []
    for k, offset in enumerate(plan.offsets_px[z]):
        pixels = images.moved(np.array(offset))
        pixels = pixels[whole_at(pixels, plan.scan.camera.sensor.shape, plan.scan.cutout)]
        frames.append(np.column_stack([np.full(len(pixels), k), pixels]))
    counts = [len(frame) for frame in frames] or [0]
    points = np.concatenate(frames) if frames else np.zeros((0, 3))
    return PlaneDrawing(points, min(counts), max(counts), plan.shown(z))


def table_rows(found: PlannedTarget) -> tuple[list[tuple[str, ...]], list[tuple[float, ...]]]:
    """Return the planes as rows of text under the columns `TABLE`, and their sort keys."""
    rows: list[tuple[str, ...]] = []
    numbers: list[tuple[float, ...]] = []
    for z, plane in enumerate(found.planes):
        depth, frames = found.plan.scan.depths_um[z], len(found.plan.offsets_px[z])
        least = -(-plane.shown.size // max(1, plane.many))
        points = f"{plane.few}" if plane.few == plane.many else f"{plane.few} … {plane.many}"
        crosstalk = found.plan.crosstalk[z]
        shares = (format_share(plane.coverage), format_share(crosstalk))
        rows.append((format_length(depth), f"{frames}", f"{least}", points, *shares))
        numbers.append((depth, frames, least, plane.many, plane.coverage, crosstalk))
    return rows, numbers


def point_lines(plane: PlaneDrawing, between: str) -> Iterator[str]:
    """Yield the images of a plane as table lines, with ``between`` as the column separator."""
    yield between.join(("frame", "row_px", "column_px")) + "\n"
    for frame, row, column in plane.points:
        yield f"{int(frame) + 1}{between}{row:.6g}{between}{column:.6g}\n"
