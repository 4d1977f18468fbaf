"""Parts of the processing whose accuracy can be chosen: their definition (`Place`), and all of them by name."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass

from lfcal.accuracy.curves import UNITS, Rung
from lfcal.accuracy.subject import Subject
from lfcal.base import Progress, Registry, check_choice

__all__ = ["PLACES", "AccuracyStep", "Measuring", "Place", "Truth", "find_places"]


@dataclass(frozen=True, slots=True)
class Truth:
    """Reference with which results of a curve are compared, and conditions; yielded once, before the first point."""

    label: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class AccuracyStep:
    """Description of the next step, and its approximate duration (s); None: as long as the previous step."""

    label: str
    seconds: float | None = None


Measuring = Generator[Truth | AccuracyStep | Rung | Progress, None, None]
"""A running measurement. It may be closed at any time, and yields records at short intervals."""


@dataclass(frozen=True, slots=True)
class Place:
    """One part of the processing whose accuracy can be chosen; modules of `lfcal.accuracy.places` define ``PLACE``.

    Attributes
    ----------
    name, title
        Name in commands, and display name.
    error, cost
        Meaning of error and cost, with units.
    unit
        Unit of the cost, one of `lfcal.accuracy.curves.UNITS`.
    measure
        Function of the subject and a time limit (s) that yields the reference, steps, points and progress. It raises
        `LfcalError` with the reason if this subject has no such curve.
    rank
        Order in lists.

    Examples
    --------
    >>> from lfcal.accuracy import PLACES, Place
    >>> place: Place = PLACES.get("averaging")
    >>> print(f"{place.error}, for {place.unit}")
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
"""Entry point group for parts of the processing in other distributions."""


def _check(part: Place) -> None:
    if not isinstance(part, Place):
        raise TypeError(f"expected a Place, got {type(part).__name__}")


def find_places() -> Registry[Place]:
    """Return a registry of all parts of the processing whose accuracy can be chosen, in the order of processing."""
    return Registry(
        "place of accuracy",
        "lfcal.accuracy.places",
        "PLACE",
        GROUP,
        order=lambda place: (place.rank, place.name),
        check=_check,
    )


PLACES = find_places()
"""All parts of the processing whose accuracy can be chosen, in the order of processing."""
