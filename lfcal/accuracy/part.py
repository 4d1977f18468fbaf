"""Parts of the processing whose accuracy can be chosen: their definition (`AccuracyPart`), and all of them by name."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

from lfcal.accuracy.curves import UNITS, CostPoint
from lfcal.accuracy.subject import Subject
from lfcal.base import Progress, Registry, check_choice

__all__ = ["PARTS", "AccuracyPart", "AccuracyStep", "Measuring", "Truth", "find_parts"]


@dataclass(frozen=True, slots=True)
class Truth:
    """Reference with which the results of a curve are compared; yielded once, before the first point.

    Attributes
    ----------
    label
        Description of the reference.
    notes
        Conditions of the measurement, one line each.
    """

    label: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AccuracyStep:
    """Announcement of the next step of a measurement.

    Attributes
    ----------
    label
        Description of the step.
    seconds
        Expected duration (s). None: as long as the previous point took.
    """

    label: str
    seconds: float | None = None


Measuring = Generator[Truth | AccuracyStep | CostPoint | Progress, None, None]
"""A running measurement. It may be closed at any time, and yields records at short intervals."""


@dataclass(frozen=True, slots=True)
class AccuracyPart:
    """One part of the processing whose accuracy can be chosen; modules of `lfcal.accuracy.parts` define ``PART``.

    Attributes
    ----------
    name, title
        Name used in commands, and display name.
    error, cost
        Meanings of the error and the cost, with units.
    unit
        Unit of the cost, one of `lfcal.accuracy.curves.UNITS`.
    measure
        Function that takes the subject and a time limit (s), and yields `Truth`, `AccuracyStep`, `CostPoint` and
        `Progress` records. It raises `LfcalError` with the reason if this subject has no such curve.
    rank
        Sort key in lists; smaller numbers come first.

    Examples
    --------
    >>> from lfcal.accuracy import PARTS, AccuracyPart
    >>> part: AccuracyPart = PARTS.get("averaging")
    >>> print(f"{part.error}, for {part.unit}")
    relative L1 error of H due to noise, without noise reduction, for seconds
    """

    name: str
    title: str
    error: str
    cost: str
    unit: str
    measure: Callable[[Subject, float], Measuring]
    rank: int = 100

    def __post_init__(self) -> None:
        """Check the unit."""
        check_choice(f"unit of {self.name}", self.unit, UNITS)


GROUP = "lfcal.accuracy"
"""Entry point group for parts of the processing in other packages."""


def _check(part: AccuracyPart) -> None:
    if not isinstance(part, AccuracyPart):
        raise TypeError(f"expected an AccuracyPart, got {type(part).__name__}")


def find_parts() -> Registry[AccuracyPart]:
    """Return a registry of all parts of the processing whose accuracy can be chosen, in the order of processing."""
    return Registry(
        "part of the processing",
        "lfcal.accuracy.parts",
        "PART",
        GROUP,
        order=lambda part: (part.rank, part.name),
        check=_check,
    )


PARTS = find_parts()
"""All parts of the processing whose accuracy can be chosen, in the order of processing."""
