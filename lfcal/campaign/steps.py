"""When an adaptive session ends, what is known after each of its fits, and how it ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from lfcal.acquire import Outcome
from lfcal.base import check_number, format_share
from lfcal.fit import ERRORS, Fineness, Fit, ModelError

__all__ = ["FEWEST", "Adapted", "AdaptiveStep", "Goal"]

FIRST = 12
"""Positions before the first fit."""

FEWEST = 5
"""Fewest positions that are added at a time: each time there is a fit to wait for."""


ENDS = {
    "reached": "the wanted error of H is reached, as far as the fit can tell",
    "used up": "no positions are left: the wanted error of H is not reached",
    "incomplete": "the model does not suffice: more patterns do not lower the error of H",
}
"""What each way to end means."""


@dataclass(frozen=True, slots=True)
class Goal:
    """When to end, and what to fit.

    Attributes
    ----------
    error
        Wanted relative error (L2) of H; what the computation of patterns itself errs by at the least.
    most
        Record no more positions than this; None: all of the plan.
    first
        Positions before the first fit.
    unknowns
        Groups of unknowns, or ``"auto"``, as of `lfcal.fit.fit_camera`.
    candidates
        Positions that are looked at for each choice; 0: all.

    Examples
    --------
    >>> from lfcal.campaign import Goal
    >>> goal = Goal(error=0.01, most=60)  # H is to be known to 1 %, with 60 positions at most
    >>> print(goal.first, "positions before the first fit")
    12 positions before the first fit
    """

    error: float
    most: int | None = None
    first: int = FIRST
    unknowns: str | Sequence[str] = "auto"
    candidates: int = 300

    def __post_init__(self) -> None:
        """Check every value."""
        least = ERRORS[Fineness.finest]
        remedy = f"for example 0.005; the computation of patterns itself errs by {format_share(least)}"
        check_number("wanted error of H", self.error, at_least=least, below=1, remedy=remedy)
        check_number("positions before the first fit", self.first, at_least=FEWEST, integer=True)
        if self.most is not None:
            check_number("most positions", self.most, at_least=self.first, integer=True)


@dataclass(frozen=True, slots=True)
class AdaptiveStep:
    """What is known after one fit.

    Attributes
    ----------
    positions
        Positions recorded so far.
    expected_error
        Relative error (L2) of H that the unknowns' own standard deviations make.
    left_out
        Error from patterns kept aside: a value, or a limit.
    chi2, complete
        Of the fit; whether the model suffices.
    groups
        Groups of unknowns that were fitted.
    outliers
        Patterns that were left out.
    """

    positions: int
    expected_error: float
    left_out: ModelError
    chi2: float
    complete: bool
    groups: tuple[str, ...]
    outliers: int

    def __str__(self) -> str:
        """Return the error against the positions, in a line."""
        said = f"{self.positions} positions: error of H {format_share(self.expected_error)} expected"
        return f"{said}, {self.left_out} at positions kept aside" + ("" if self.complete else "; model incomplete")

    def reaches(self, error: float) -> bool:
        """Return whether the error of H is at most ``error``: expected, and no pattern kept aside contradicts."""
        known = self.left_out.known and self.left_out.value - 2 * self.left_out.sigma > error
        return self.complete and self.expected_error <= error and not known


@dataclass(frozen=True, eq=False)
class Adapted:
    """How an adaptive session ended.

    Attributes
    ----------
    how
        ``"reached"``; ``"used up"``: no positions are left; ``"incomplete"``: the model does not suffice, and more
        patterns do not help; ``"stopped"`` or ``"aborted"``.
    outcome
        Of the recording as a whole.
    steps
        What was known after each fit.
    fit
        The last one; None where there was none.
    """

    how: str
    outcome: Outcome
    steps: tuple[AdaptiveStep, ...]
    fit: Fit | None

    @property
    def words(self) -> str:
        """What the end means, in a line; empty where recording was stopped."""
        return ENDS.get(self.how, "")
