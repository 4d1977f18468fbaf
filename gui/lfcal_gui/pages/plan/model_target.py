"""A target of many points beside the scan of one: what is asked for, and its plan as rows and drawings. No Qt."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, check_number, drain, format_length, format_seconds, format_share, read_text
from lfcal.camera import ScanPlan
from lfcal_gui.models import Field, PageSettings

if TYPE_CHECKING:
    from lfcal.targets import ErrorForecast, Pose, Target, TargetPlan, Wishes

__all__ = [
    "TABLE",
    "TARGET_FIELDS",
    "PlaneDrawing",
    "PlannedTarget",
    "TargetSettings",
    "iter_drawn",
    "iter_target",
    "point_lines",
    "read_plan",
    "table_rows",
]

POINT = "point"
MOST_DRAWN = 6000
"""Points that are drawn at most: whole frames, the first ones."""

TARGET_FIELDS = (
    Field(
        "source",
        "Source",
        "",
        "point: the scan of a single point. array: pinholes whose pitch is proposed. array:12x12@1.2mm: rows × columns "
        "at a pitch; then hex, hole=20um or absent=0:0+0:1 may follow, after commas",
        kind="text",
    ),
    Field("tolerance_px", "Tolerance of a phase", "px", "How far off a phase may be to count as covered, up to 0.5"),
    Field(
        "crosstalk", "Crosstalk allowed", "%", "Most light of neighbouring holes in a cutout, over its own", scale=0.01
    ),
    Field(
        "most_frames",
        "Frames a plane, at most",
        "",
        "For a session that must end: the coverage that these reach is shown",
        kind="int",
        optional=True,
        empty="no limit",
    ),
    Field(
        "pose",
        "Pose",
        "",
        "How the target lies: rotation=1,tilt_right=2,tilt_down=0 (degrees), right=0.3mm,down=0,away=0. Measured "
        "from one frame it tells where the holes really are",
        kind="text",
        empty="straight",
    ),
    Field(
        "regions",
        "Regions of the field",
        "",
        "How many regions H is wanted of, rows x columns: 3x3. All of them are in the same frames",
        kind="text",
        empty="one",
    ),
)

TABLE = ("plane", "frames", "at least", "points a frame", "phases covered", "crosstalk")


@dataclass(frozen=True)
class TargetSettings(PageSettings):
    """The source in the words of ``lfcal plan target``, and what its plan must keep (as `lfcal.targets.Wishes`)."""

    page: ClassVar[str] = "plan"
    source: str = POINT
    tolerance_px: float = 0.1
    crosstalk: float = 0.005
    most_frames: int | None = None
    pose: str = ""
    regions: str = ""

    @property
    def many(self) -> bool:
        """Whether a target is to be planned."""
        return self.source != POINT

    def usable(self) -> None:
        """Raise `InputError` where the words are of no target, or a number is out of bounds."""
        if self.most_frames is not None:
            check_number("frames a plane, at most", self.most_frames, at_least=1, integer=True)
        check_number("crosstalk allowed (%)", 100 * self.crosstalk, at_least=1e-4, below=100)
        if self != type(self)():
            self.wishes()
        self.lies()
        self.field()
        if self.many and self.proposed_hole() is None:
            from lfcal.targets import parse_target

            parse_target(self.source)

    def changed(self, key: str, value: Any) -> Self:
        """Return the settings with one changed; raise `InputError` where it cannot be."""
        if isinstance(value, str):
            value = value.strip()
        made = replace(self, **{key: value})
        made.usable()
        return made

    def wishes(self) -> Wishes:
        """Return what the plan must keep."""
        from lfcal.targets import Wishes  # here and below: a page is shown before simulators are loaded

        return Wishes(self.tolerance_px, self.crosstalk, self.most_frames)

    def lies(self) -> Pose:
        """Return how the target lies."""
        from lfcal.targets import Pose

        return Pose.parse(self.pose)

    def field(self) -> tuple[int, int] | None:
        """Return the regions of the field (rows, columns); None: one."""
        from lfcal.camera import parse_regions

        return parse_regions(self.regions) if self.regions else None

    @classmethod
    def of_plan(cls, plan: TargetPlan) -> TargetSettings:
        """Return what was asked for where ``plan`` was made, as far as it tells."""
        from lfcal.targets import target_words

        return cls(target_words(plan.target), plan.tolerance_px, max(plan.crosstalk), None, plan.target.pose.words)

    def proposed_hole(self) -> float | None:
        """Return the holes' diameter (µm) where the pitch is to be proposed, else None."""
        from lfcal.targets import proposed_hole

        return proposed_hole(self.source)


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
    plan, planes
        The plan, and a drawing for each of its planes.
    errors
        Of each plane, what noise is expected to leave of a pattern.
    regions
        How many regions of the field the same frames serve, and the fewest points that one of them has in a plane.
    coding
        Whether showing several frames at once would pay, in a line; empty where nothing is to be shown at once.
    """

    plan: TargetPlan
    planes: tuple[PlaneDrawing, ...]
    errors: tuple[ErrorForecast, ...] = ()
    regions: tuple[int, int] = (1, 0)
    coding: str = ""

    @property
    def coding_briefly(self) -> str:
        """Whether it pays, without at what light and why: in the smallest window there is no room for more."""
        verdict, *reasons = re.split(r" at (?=\d)", self.coding, maxsplit=1)
        return f"{verdict}." if reasons else verdict

    def summary(self) -> list[tuple[str, str, str]]:
        """Return rows (what, by this target, by a single point)."""
        ours, single = self.plan.forecast(), self.plan.single()
        return [
            ("Frames", f"{ours.frames}", f"{single.frames}"),
            ("Time, no readout", format_seconds(ours.hours * 3600), format_seconds(single.hours * 3600)),
            ("  exposing", format_seconds(ours.exposure_hours * 3600), format_seconds(single.exposure_hours * 3600)),
            ("  settling", format_seconds(ours.settle_hours * 3600), format_seconds(single.settle_hours * 3600)),
            ("  moving", format_seconds(ours.move_hours * 3600), format_seconds(single.move_hours * 3600)),
            *self._expected(),
            *self._regions(single.frames),
        ]

    def _expected(self) -> Iterator[tuple[str, str, str]]:
        """Yield what noise leaves of a pattern, and the phases shown, by half and by all frames of the middle plane."""
        if not self.errors:
            return
        found = self.errors[len(self.errors) // 2]
        count = len(found.error)
        if not count:
            return
        half = max(1, count // 2) - 1
        yield "Noise, in all", format_share(found.error[-1]), format_share(found.single)
        yield "  half-way", format_share(found.error[half]), ""
        yield "Phases, in all", format_share(found.shown[-1]), "100 %"
        yield "  half-way", format_share(found.shown[half]), ""

    def _regions(self, single: int) -> Iterator[tuple[str, str, str]]:
        count, fewest = self.regions
        if count > 1:
            yield f"For {count} regions", "same frames", f"{count * single}"
            yield "  points in each", f"{fewest} …", ""


def iter_target(scan: ScanPlan, settings: TargetSettings) -> Work[PlannedTarget]:
    """Plan the target, as a job."""
    from lfcal.targets import iter_plan_target

    clock = Clock("choose the target", 1)
    yield clock.at(0, settings.source)
    if (field := settings.field()) is not None:
        from lfcal.camera import RegionPlan

        RegionPlan.spread(scan, field)  # refused before the frames are looked for
    target = replace(_target(scan, settings), pose=settings.lies())
    plan = yield from iter_plan_target(scan, target, settings.wishes())
    return (yield from iter_drawn(plan, field))


def iter_drawn(plan: TargetPlan, regions: tuple[int, int] | None = None) -> Work[PlannedTarget]:
    """Return what is shown of a plan; ``regions`` are those of the field (rows, columns)."""
    from lfcal.targets import error_forecast

    planes, errors, count = [], [], len(plan.scan.depths_um)
    clock = Clock("look at what is covered", count)
    for z in range(count):
        yield clock.at(z)
        planes.append(_drawing(plan, z))
        errors.append(error_forecast(plan, z))
    return PlannedTarget(plan, tuple(planes), tuple(errors), _served(plan, regions), _coding(plan))


def _coding(plan: TargetPlan) -> str:
    """Return whether showing several frames at once would pay, at the exposure of a session."""
    from lfcal.tasks import coding_verdict, coding_words  # here: a page is shown before simulators are loaded

    if plan.lit is not None:
        return "Frames of a display that shows several subsets of points at once, by an S-matrix."
    verdict = coding_verdict(plan)
    return "" if verdict is None else f"{_capital(coding_words(verdict))}."


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]


def _served(plan: TargetPlan, regions: tuple[int, int] | None) -> tuple[int, int]:
    """Return how many regions the frames serve, and the fewest points of one in a plane."""
    if regions is None:
        return 1, 0
    from lfcal.camera import RegionPlan
    from lfcal.targets import region_points

    field = RegionPlan.spread(plan.scan, regions)
    fewest = min(int(region_points(plan, field, z).sum(0).min()) for z in range(len(plan.scan.depths_um)))
    return len(field), fewest


def read_plan(path: str) -> ScanPlan | PlannedTarget:
    """Return the plan of a scan or of a target in a file; raises `LfcalError` where it is none."""
    text = read_text(Path(path))
    if '"lfcal-target-plan"' not in text[:200]:
        return ScanPlan.from_json(text)
    from lfcal.targets import TargetPlan

    return drain(iter_drawn(TargetPlan.from_json(text)))


def _target(scan: ScanPlan, settings: TargetSettings) -> Target:
    from lfcal.targets import parse_target, propose_target

    hole = settings.proposed_hole()
    return parse_target(settings.source) if hole is None else propose_target(scan, settings.wishes(), hole_um=hole)


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
