"""How a fit converges: a record of each round of derivatives, with what the model leaves at its end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from lfcal.base import Progress, format_share
from lfcal.fit.judge import chi_square
from lfcal.fit.problem import Point, Problem
from lfcal.fit.questions import unexplained

__all__ = ["FitProgress", "rounds"]


SURE = 2.0
"""Standard deviations of the noise's squares above which something shows."""


@dataclass(frozen=True, slots=True)
class FitProgress(Progress):
    """The start, or the end of a round of derivatives: its work is done; how many rounds there will be nobody knows.

    Attributes
    ----------
    chi2
        Mean square of the fitted patterns' residuals, weighted by the light. Of a coarse model, which errs by itself,
        the variance has that error; it falls towards 1 from round to round, and may rise where the fit goes on finer.
    left_out, hidden
        What the patterns that are never fitted have beside model and noise, as a share of their rms (relative L2), NaN
        where none is left out; whether it is less than that, which is then what their noise hides (two of its
        standard deviations).
    """

    chi2: float = math.nan
    left_out: float = math.nan
    hidden: bool = False


def rounds() -> Callable[[Problem, Point, str], FitProgress]:
    """Return what makes the record of a round that ended at a point, in a stage of a fit."""
    start = time.perf_counter()

    def record(problem: Problem, point: Point, stage: str) -> FitProgress:
        aside = problem.measured.left_out
        chi2 = chi_square(point, problem.fitted, 0).lit
        left, hidden, note = math.nan, False, f"χ² {chi2:.3g}"
        if aside.any():
            share, sigma = unexplained(problem, point, aside)
            hidden = share < SURE * sigma
            left = math.sqrt(max(share, SURE * sigma))
            note += f", left-out patterns {'less than ' if hidden else ''}{format_share(left)} off"
        seconds = time.perf_counter() - start
        return FitProgress(1, 1, stage, seconds, note, chi2=chi2, left_out=left, hidden=hidden)

    return record
