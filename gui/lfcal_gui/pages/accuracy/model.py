"""The Accuracy page: settings, what can be measured, and words. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from lfcal.accuracy import Curve
from lfcal.base import InputError
from lfcal_gui.models import Field, PageSettings, ProjectState, typeset

SUBJECTS = (("plan", "Scan plan"), ("psf", "H"))

FIELDS = (
    Field(
        "subject", "Measure", kind="choice", choices=SUBJECTS, tip="A simulation of the plan's camera, or H's values"
    ),
    Field("seconds", "Time for a place", "s", "Approximate time to measure each place"),
    Field("error", "What would cost", "%", "Error for which the cost is estimated", scale=0.01),
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


def subjects(project: ProjectState) -> tuple[str, ...]:
    """Return what of the project can be measured."""
    found = (("plan", project.plan is not None), ("psf", bool(project.psf) and Path(project.psf).exists()))
    return tuple(name for name, there in found if there)


def words_of(curve: Curve | None, error: float, *, running: bool) -> tuple[str, str]:
    """Return what the error would cost, and how it was measured, as lines."""
    if curve is None:
        return ("measuring …" if running else "Not measured yet: press Measure."), ""
    if not curve.rungs:
        return ("measuring the truth …" if running else f"Not measured: {curve.stopped or 'stopped'}"), ""
    state = "measuring …" if running else curve.stopped
    how = [f"Measured by: {curve.truth}.", *curve.notes, state]
    return typeset(curve.answer(error)), "\n".join(typeset(line) for line in how if line)
