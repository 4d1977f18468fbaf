"""The Accuracy page: settings, measurements that keep what they have, what the chart shows and says. No Qt."""

from __future__ import annotations

import math
from collections.abc import Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from lfcal.accuracy import PLACES, Curve, Rung, Subject, cost_axis, format_cost, iter_measure_curve
from lfcal.base import InputError, Work, format_share
from lfcal_gui.models import Field, PageSettings, ProjectState, stated_order, typeset

__all__ = [
    "FIELDS",
    "AccuracySettings",
    "ChartPoint",
    "MeasuredCurves",
    "axis_labels",
    "iter_measure",
    "key_of",
    "points_of",
    "rung_words",
    "subjects",
    "words_of",
]

SUBJECTS = (("plan", "Scan plan"), ("psf", "H"))
FLOOR = 1e-9
"""Errors and costs of nothing at all are shown here: a logarithm has no zero."""

FIELDS = (
    Field(
        "subject", "Measure", kind="choice", choices=SUBJECTS, tip="A simulation of the plan's camera, or H's values"
    ),
    Field("seconds", "Time for a place", "s", "About how long each place may take"),
    Field("error", "What would cost", "%", "The error whose cost is asked for", scale=0.01),
)


@dataclass(frozen=True)
class AccuracySettings(PageSettings):
    """What the user chose.

    Attributes
    ----------
    place
        One of `PLACES`.
    subject
        ``"plan"`` or ``"psf"``.
    seconds
        About how long a place may take (s).
    error
        Error whose cost is asked for (a share).
    """

    page: ClassVar[str] = "accuracy"

    place: str = "simulation"
    subject: str = "plan"
    seconds: float = 10.0
    error: float = 0.01

    def __post_init__(self) -> None:
        """Check every value; a place of a distribution that is not installed is kept."""
        if self.subject not in dict(SUBJECTS):
            raise InputError.expected("subject", " or ".join(dict(SUBJECTS)), self.subject, "choose one of these")
        if not 0 < self.seconds <= 86_400:
            raise InputError.expected("time for a place (s)", "above 0 and up to a day", self.seconds, "correct it")
        if not 0 < self.error <= 10:
            raise InputError.expected("error", "above 0 and up to 1000 %", self.error, "correct it")


@dataclass
class MeasuredCurves:
    """The curves of a measurement that is at work in a thread, the newest of each place.

    The window reads it at any time: each change puts one finished curve into the place of another.
    """

    curves: dict[str, Curve] = field(default_factory=dict)


def subjects(project: ProjectState) -> tuple[str, ...]:
    """Return what of the project can be measured."""
    found = (("plan", project.plan is not None), ("psf", bool(project.psf) and Path(project.psf).exists()))
    return tuple(name for name, there in found if there)


def key_of(project: ProjectState, settings: AccuracySettings) -> object:
    """Return what curves belong to: they are forgotten when it changes."""
    return ("plan", project.plan) if settings.subject == "plan" else ("psf", project.psf)


def iter_measure(
    project: ProjectState, settings: AccuracySettings, places: Iterable[str], kept: MeasuredCurves
) -> Work[None]:
    """Measure place after place; whatever is measured is in ``kept`` at once."""
    chosen = [PLACES.get(name) for name in places]
    with ExitStack() as stack:
        subject = _subject(project, settings, stack)
        for number, place in enumerate(chosen):
            work = iter_measure_curve(place, subject, settings.seconds, number=number, total=len(chosen))
            stack.callback(work.close)
            kept.curves[place.name] = yield from _keeping(work, kept)


def _keeping(work: Work[Curve], kept: MeasuredCurves) -> Work[Curve]:
    while True:
        try:
            record = next(work)
        except StopIteration as end:
            curve: Curve = end.value
            return curve
        curve = record.curve  # type: ignore[attr-defined]
        kept.curves[curve.place] = curve
        yield record


def _subject(project: ProjectState, settings: AccuracySettings, stack: ExitStack) -> Subject:
    from lfcal.psf import open_psf

    if settings.subject == "psf":
        # opened anew: other pages read other planes of theirs
        matrix = open_psf(project.psf, mat_order=stated_order(project, project.psf))
        return Subject.of_matrix(stack.enter_context(matrix), Path(project.psf).name)
    if project.plan is None:
        raise InputError.expected("accuracy", "a scan plan", "none", "make one on the Plan page")
    return Subject(project.plan.camera.name, project.plan)


# -- showing -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ChartPoint:
    """A rung in the chart: decimal logarithms of its cost, as the axis has it, and of its error in per cent."""

    x: float
    y: float
    efficient: bool
    picked: bool
    words: str


def points_of(curve: Curve, error: float) -> tuple[ChartPoint, ...]:
    """Return the rungs as points, in their order; the cheapest within ``error`` is picked."""
    picked, (_, scale) = curve.cheapest(error), cost_axis(curve)
    return tuple(
        ChartPoint(
            math.log10(max(rung.cost / scale, FLOOR)),
            math.log10(100 * max(rung.error, FLOOR)),
            rung.efficient,
            rung is picked,
            rung_words(rung),
        )
        for rung in curve.rungs
    )


def axis_labels(curve: Curve) -> tuple[str, str]:
    """Return the labels of cost and error with their units."""
    return cost_axis(curve)[0], f"{curve.error.split(',')[0]} (%)"


def rung_words(rung: Rung) -> str:
    """Return one rung in a few lines."""
    lines = [typeset(rung.label), f"error {format_share(rung.error)}, costs {format_cost(rung.cost, rung.unit)}"]
    lines += [f"{name}: {value:.4g}" for name, value in rung.others.items()]
    return "\n".join(filter(None, (*lines, rung.note)))


def words_of(curve: Curve | None, error: float, *, running: bool) -> tuple[str, str]:
    """Return what the error would cost, and how it was measured, as lines."""
    if curve is None:
        return ("measuring …" if running else "Not measured yet: press Measure."), ""
    if not curve.rungs:
        return ("measuring the truth …" if running else f"Not measured: {curve.stopped or 'stopped'}"), ""
    state = "measuring …" if running else curve.stopped
    how = [f"Measured by: {curve.truth}.", *curve.notes, state]
    return typeset(curve.answer(error)), "\n".join(typeset(line) for line in how if line)
