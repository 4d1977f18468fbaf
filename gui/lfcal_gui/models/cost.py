"""Measured curves of error versus cost: stored for each plan or H, and as points of a chart. No Qt."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import InputError, Work, format_seconds, format_share
from lfcal_gui.models.project import ProjectState
from lfcal_gui.models.settings import stated_order
from lfcal_gui.models.words import typeset

if TYPE_CHECKING:
    from lfcal.accuracy import Curve, Rung, Subject
    from lfcal.camera import ScanPlan

KEPT = 64
"""Largest number of stored curves; the oldest are dropped."""

FLOOR = 1e-9
"""Value at which an error or a cost of zero is drawn on the logarithmic axes."""

REFERENCE, OTHERS_S = 20.0, 3.0
"""Factor of the estimate for a reference position, and the remaining time (s), fitted to the presets."""


@dataclass
class MeasuredCurves:
    """Curves measured since the window opened, by subject (plan or H) and place, with their duration (s).

    A measurement in a thread adds to them while the window reads: each change replaces one whole curve.
    """

    curves: dict[tuple[object, str], tuple[Curve, float]] = field(default_factory=dict)

    def of(self, subject: object) -> Mapping[str, Curve]:
        """Return the curves of a subject by place, in the order of measurement."""
        return {place: curve for (key, place), (curve, _) in list(self.curves.items()) if key == subject}

    def took(self, subject: object, place: str) -> str:
        """Return the duration of a measurement as text; empty if it was not measured."""
        found = self.curves.get((subject, place))
        return "" if found is None else f"measured in {format_seconds(found[1])}"

    def put(self, subject: object, curve: Curve, seconds: float) -> None:
        """Store a curve as the newest."""
        self.curves.pop((subject, curve.place), None)
        self.curves[subject, curve.place] = curve, seconds
        for old in list(self.curves)[:-KEPT]:
            del self.curves[old]

    def forget(self, subject: object, places: Iterable[str]) -> None:
        """Drop curves that will be measured again."""
        for place in places:
            self.curves.pop((subject, place), None)


def asked_seconds(plan: ScanPlan) -> float:
    """Return the estimated duration of measuring a simulation curve (s), to within a factor of 3."""
    from lfcal.simulate import outlook_of
    from lfcal.simulate.accuracy import few_seconds

    outlook = outlook_of(plan, plan.shape[0] // 2)
    return OTHERS_S + REFERENCE * few_seconds(outlook, "reference", 0.005, 1)


def subject_of(project: ProjectState, kind: str) -> object:
    """Return the subject of curves of a ``kind``: ``"plan"`` or ``"psf"``."""
    return (kind, project.plan if kind == "plan" else project.psf)


def iter_measure(
    project: ProjectState, kind: str, seconds: float, places: Iterable[str], kept: MeasuredCurves
) -> Work[None]:
    """Measure the places in turn, each for about ``seconds``; each point is added to ``kept`` when measured."""
    from lfcal.accuracy import PLACES, iter_measure_curve

    chosen, key = [PLACES.get(name) for name in places], subject_of(project, kind)
    with ExitStack() as stack:
        subject = _subject(project, kind, stack)
        for number, place in enumerate(chosen):
            work = iter_measure_curve(place, subject, seconds, number=number, total=len(chosen))
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
class CostPoint:
    """A measured setting (rung) in the chart: decimal logarithms of its cost and of its error (%)."""

    x: float
    y: float
    efficient: bool
    picked: bool
    name: str
    words: str


def points_of(curve: Curve, picked: Rung | None) -> tuple[CostPoint, ...]:
    """Return the measured settings (rungs) of a curve as points, in their order."""
    from lfcal.accuracy import cost_axis

    _, scale = cost_axis(curve)
    return tuple(
        CostPoint(
            math.log10(max(rung.cost / scale, FLOOR)),
            math.log10(100 * max(rung.error, FLOOR)),
            rung.efficient,
            rung is picked,
            _name_of(rung),
            rung_words(rung),
        )
        for rung in curve.rungs
    )


def _name_of(rung: Rung) -> str:
    """Return the first words of a rung's label, short enough to fit next to its point."""
    words = ", ".join(rung.label.split(", ")[:2])
    return typeset(words.removeprefix("tolerance "))


def axis_labels(curve: Curve) -> tuple[str, str]:
    """Return the labels of cost and error with their units."""
    from lfcal.accuracy import cost_axis

    return cost_axis(curve)[0], f"{curve.error.split(',')[0]} (%)"


def rung_words(rung: Rung) -> str:
    """Return the description of a measured setting (rung) as a few lines of text."""
    from lfcal.accuracy import format_cost

    lines = [typeset(rung.label), f"error {format_share(rung.error)}, costs {format_cost(rung.cost, rung.unit)}"]
    lines += [f"{name}: {value:.4g}" for name, value in rung.others.items()]
    return "\n".join(filter(None, (*lines, rung.note)))
