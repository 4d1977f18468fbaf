"""Measured curves of error versus cost: stored for each plan or H, and as points of a chart. No Qt."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import InputError, Work, format_seconds
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.settings import stated_order
from lfcal_gui.models.words import typeset

if TYPE_CHECKING:
    from lfcal.accuracy import CostPoint, Curve, Subject
    from lfcal.camera import ScanPlan

KEPT = 64
"""Largest number of stored curves; the oldest are dropped."""

FLOOR = 1e-9
"""Value at which an error or a cost of zero is drawn on the logarithmic axes."""

OTHERS_S = 3.0
"""Duration of a simulation curve without its reference (s), fitted to the presets."""


@dataclass
class MeasuredCurves:
    """Curves measured since the window opened, by subject (plan or H) and part, with their duration (s).

    A measurement in a thread adds to them while the window reads: each change replaces one whole curve.
    """

    curves: dict[tuple[object, str], tuple[Curve, float]] = field(default_factory=dict)

    def of(self, subject: object) -> Mapping[str, Curve]:
        """Return the curves of a subject by part, in the order of measurement."""
        return {part: curve for (key, part), (curve, _) in list(self.curves.items()) if key == subject}

    def took(self, subject: object, part: str) -> str:
        """Return the duration of a measurement as text; empty if nothing was measured."""
        curve, seconds = self.curves.get((subject, part), (None, 0.0))
        return f"measured in {format_seconds(seconds)}" if curve is not None and curve.points else ""

    def put(self, subject: object, curve: Curve, seconds: float) -> None:
        """Store a curve as the newest."""
        self.curves.pop((subject, curve.part), None)
        self.curves[subject, curve.part] = curve, seconds
        for old in list(self.curves)[:-KEPT]:
            del self.curves[old]

    def forget(self, subject: object, parts: Iterable[str]) -> None:
        """Drop curves that will be measured again."""
        for part in parts:
            self.curves.pop((subject, part), None)


def asked_seconds(plan: ScanPlan) -> float:
    """Return the estimated duration of measuring a simulation curve (s), to within a factor of 3."""
    from lfcal.accuracy import reference_seconds

    return OTHERS_S + reference_seconds(plan, plan.shape[0] // 2, 0.005)


def subject_of(project: ProjectState, kind: str) -> object:
    """Return the subject of curves of a ``kind``: ``"plan"`` or ``"psf"``."""
    return (kind, project.plan if kind == "plan" else project.psf)


def iter_measure(
    project: ProjectState, kind: str, seconds: float, parts: Iterable[str], kept: MeasuredCurves
) -> Work[None]:
    """Measure the parts in turn, each for about ``seconds``; each point is added to ``kept`` when measured."""
    from lfcal.accuracy import PARTS, iter_measure_curve

    chosen, key = [PARTS.get(name) for name in parts], subject_of(project, kind)
    with ExitStack() as stack:
        subject = _subject(project, kind, stack)
        for number, part in enumerate(chosen):
            work = iter_measure_curve(part, subject, seconds, number=number, total=len(chosen))
            stack.callback(work.close)
            for record in work:
                kept.put(key, record.curve, record.seconds)  # type: ignore[attr-defined]
                yield record


def _subject(project: ProjectState, kind: str, stack: ExitStack) -> Subject:
    from lfcal.accuracy import Subject
    from lfcal.psf import open_psf

    if kind == "psf":
        # open it again: other pages read other planes of their file
        matrix = open_psf(project.psf, mat_order=stated_order(project, project.psf))
        return Subject.of_matrix(stack.enter_context(matrix), Path(project.psf).name)
    if project.plan is None:
        raise InputError.expected("accuracy", "a scan plan", "none", "make one in Set up")
    return Subject(project.plan.camera.name, project.plan)


# -- showing -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ChartPoint:
    """A measured setting in the chart: decimal logarithms of its cost and of its error (%)."""

    x: float
    y: float
    efficient: bool
    picked: bool
    in_use: bool
    name: str
    words: str


def points_of(
    curve: Curve, picked: CostPoint | None, in_use: CostPoint | None = None, asked: tuple[float, ...] = ()
) -> tuple[ChartPoint, ...]:
    """Return the measured settings of a curve as points, in their order, with the chosen one and the one in use.

    Their errors have enough digits to differ from each other and from the target errors ``asked``.
    """
    from lfcal.accuracy import cost_axis

    _, scale = cost_axis(curve)
    labels = [point.label for point in curve.points]
    return tuple(
        ChartPoint(
            math.log10(max(point.cost / scale, FLOOR)),
            math.log10(100 * max(point.error, FLOOR)),
            point.efficient,
            point is picked,
            point is in_use,
            _name_of(point.label, labels) + (" (in use)" if point is in_use else ""),
            point_words(point, curve.error_text(point.error, *asked)),
        )
        for point in curve.points
    )


def _name_of(label: str, labels: Sequence[str]) -> str:
    """Return the first words of a point's label that distinguish it from the other labels."""
    words = label.split(", ")
    others = [other.split(", ") for other in labels if other != label]
    count = next((n for n in range(2, len(words)) if all(other[:n] != words[:n] for other in others)), len(words))
    return typeset(", ".join(words[:count]).removeprefix("tolerance "))


def axis_labels(curve: Curve) -> tuple[str, str]:
    """Return the labels of cost and error with their units."""
    from lfcal.accuracy import cost_axis

    return cost_axis(curve)[0], f"{curve.error.split(',')[0]} (%)"


def point_words(point: CostPoint, error: str) -> str:
    """Return the description of a measured setting as a few lines of text."""
    from lfcal.accuracy import format_cost

    lines = [typeset(point.label), f"error {error}, costs {format_cost(point.cost, point.unit)}"]
    lines += [f"{name}: {value:.4g}" for name, value in point.others.items()]
    return "\n".join(filter(None, (*lines, point.note)))
