"""A target of many points for the positions of a scan, as the task PlanTarget; its plan as rows and drawings. No Qt."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, drain, format_length, format_seconds, format_share, read_text
from lfcal.camera import ScanPlan
from lfcal.records import rows
from lfcal.tasks import PlanScan, PlanTarget
from lfcal_gui.models import PLAN_FILE, PageSettings, shown_of

if TYPE_CHECKING:
    from lfcal.targets import TargetPlan
    from lfcal.tasks import TargetPlanned

PEAK = 0.8
"""Share of the full well that the brightest pixel is planned to reach."""

MOST_DRAWN = 6000
"""Points that are drawn at most: whole frames, the first ones."""

RATES = ("speed", "frame_rate")
"""Fields that forecasts of scan and target have in common: the form of the scan shows them."""

OF_SCAN = (*RATES, "half_cell", "peak")
"""Fields of the form of the scan that are settings of the page, and no values of the plan."""

HELD_OF_TARGET = frozenset({"plan", "out", *RATES})
"""Fields of `lfcal.tasks.PlanTarget` that are not in the form of the target."""

ROWS = {row.name: row for kind in (PlanScan, PlanTarget) for row in rows(kind)}
TABLE = ("plane", "frames", "at least", "points", "phases", "crosstalk")


@dataclass(frozen=True)
class PlanSettings(PageSettings):
    """Values of `lfcal.tasks.PlanTarget` by the names of its fields; without a ``source`` there is a single point.

    ``half_cell`` and ``peak`` are those of `lfcal.tasks.PlanScan`.
    """

    page: ClassVar[str] = "plan"
    source: str = ""
    tolerance: float = 0.1
    crosstalk: float = 0.005
    most_frames: int | None = None
    pose: str = ""
    regions: str = ""
    pose_within: str = ""
    signal: float | None = None
    speed: float = 1000.0
    frame_rate: float | None = None
    half_cell: bool = False
    peak: float | None = PEAK

    @classmethod
    def read(cls, data: object) -> tuple[Self, tuple[str, ...]]:
        """Return the settings in ``data``, also by the names of earlier projects, and why values were refused."""
        if isinstance(data, Mapping):
            earlier = {"tolerance_px": "tolerance"}
            data = {earlier.get(name, name): "" if value == "point" else value for name, value in data.items()}
        return super().read(data)

    @property
    def many(self) -> bool:
        """Whether a target of many points is planned."""
        return bool(self.source)

    def usable(self) -> None:
        """Raise `InputError` where the task would refuse a value."""
        target_task(self if self.many else replace(self, source="array"))

    def changed(self, key: str, value: Any) -> Self:
        """Return the settings with one changed; raise `InputError` where it cannot be."""
        given = value.strip() if isinstance(value, str) else value
        made = replace(self, **{key: ROWS[key].value(given, ROWS[key].label)})
        made.usable()
        return made

    def shown(self) -> dict[str, Any]:
        """Return what forms show."""
        of_scan = shown_of(PlanScan, {"half_cell": self.half_cell, "peak": self.peak})
        return shown_of(PlanTarget, self.to_dict()) | {key: of_scan[key] for key in ("half_cell", "peak")}

    @classmethod
    def of_plan(cls, plan: TargetPlan) -> PlanSettings:
        """Return what was asked for where ``plan`` was made, as far as it shows it."""
        from lfcal.targets import target_words

        return cls(target_words(plan.target), plan.tolerance_px, max(plan.crosstalk), None, plan.target.pose.words)

    def at_rates_of(self, other: PlanSettings) -> PlanSettings:
        """Return the settings with the speed, the frame rate and the brightest pixel of others."""
        return replace(self, speed=other.speed, frame_rate=other.frame_rate, peak=other.peak)


def target_task(settings: PlanSettings, out: str = "target_plan.json") -> PlanTarget:
    """Return the task that plans the target; raises `InputError` where it cannot be."""
    own = {one.name: getattr(settings, one.name) for one in fields(settings) if one.name not in ("half_cell", "peak")}
    return PlanTarget(plan=Path(PLAN_FILE), out=Path(out), **own)


@dataclass(frozen=True, eq=False)
class PlaneDrawing:
    """What is drawn of a plane.

    Attributes
    ----------
    points
        ``(n, 3)`` as (frame, row, column): images whose cutouts are on the sensor (px).
    few, many
        The fewest and the most points of a frame.
    shown
        ``(ny, nx)`` how many frames show each position within the tolerance.
    """

    points: NDArray[np.float64]
    few: int
    many: int
    shown: NDArray[np.intp]

    @property
    def coverage(self) -> float:
        """Share of the positions that some frame shows."""
        return float((self.shown > 0).mean())

    def drawn(self) -> NDArray[np.float64]:
        """Return the points of the first frames, as many as can be drawn, the first frame in any case."""
        if len(self.points) <= MOST_DRAWN:
            return self.points
        last = max(1.0, self.points[MOST_DRAWN, 0])
        drawn: NDArray[np.float64] = self.points[self.points[:, 0] < last]
        return drawn


@dataclass(frozen=True, eq=False)
class PlannedTarget:
    """A plan of a target and what is shown of it.

    Attributes
    ----------
    made
        What the task made.
    planes
        A drawing for each plane.
    coding
        Whether showing several frames together would pay, in words; empty where there are none to show together.
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
        """Return rows (what, by this target, by a single point)."""
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
            ("Frames", f"{ours.frames}", f"{single.frames}"),
            *(
                (name, format_seconds(3600 * getattr(ours, key)), format_seconds(3600 * getattr(single, key)))
                for name, key in parts.items()
                if getattr(ours, key) is not None
            ),
            *self._expected(),
            *self._regions(single.frames),
        ]

    def _expected(self) -> Iterator[tuple[str, str, str]]:
        """Yield what noise leaves of a pattern, and the phases shown, by half and by all frames of the middle plane."""
        errors = self.made.facts["expected_error"]
        found = errors[len(errors) // 2]
        count = len(found["error"])
        if not count:
            return
        half = max(1, count // 2) - 1
        yield "Noise, in all", format_share(found["error"][-1]), format_share(found["single_point"])
        yield "  half-way", format_share(found["error"][half]), ""
        yield "Phases, in all", format_share(found["shown"][-1]), "100 %"
        yield "  half-way", format_share(found["shown"][half]), ""

    def _regions(self, single: int) -> Iterator[tuple[str, str, str]]:
        if "regions" in self.made.facts:
            found = self.made.facts["regions"]["regions"]
            yield f"For {len(found)} regions", "same frames", f"{len(found) * single}"
            yield "  points in each", f"{min(min(one['points']) for one in found)} …", ""


def iter_target(scan: ScanPlan, settings: PlanSettings) -> Work[PlannedTarget]:
    """Plan the target, as a job."""
    made = yield from target_task(settings).iter_planned(scan)
    return (yield from iter_drawn(made))


def iter_drawn(made: TargetPlanned) -> Work[PlannedTarget]:
    """Return what is shown of a plan."""
    planes, count = [], len(made.plan.scan.depths_um)
    clock = Clock("look at what is covered", count)
    for z in range(count):
        yield clock.at(z)
        planes.append(_drawing(made.plan, z))
    return PlannedTarget(made, tuple(planes), _coding(made))


def _coding(made: TargetPlanned) -> str:
    """Return in words whether coded frames (several subsets of points at the same time) reduce the noise."""
    if made.plan.lit is not None:
        return "Frames of a display that shows several subsets of points together, by an S-matrix."
    words = "" if made.verdict is None else f"{made.verdict.frames_words}."
    return words[:1].upper() + words[1:]


def read_plan(path: str, settings: PlanSettings | None = None) -> ScanPlan | PlannedTarget:
    """Return the plan of a scan or of a target in a file, forecast at the rates of ``settings``.

    Raises
    ------
    LfcalError
        If there is none in it.
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
    """Return the planes as rows of text under `TABLE`, and the numbers they are sorted by."""
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
    """Yield the images of a plane as a table, columns parted by what stands ``between``."""
    yield between.join(("frame", "row_px", "column_px")) + "\n"
    for frame, row, column in plane.points:
        yield f"{int(frame) + 1}{between}{row:.6g}{between}{column:.6g}\n"
