"""How a fit converges: a record of each round of derivatives, with what the model leaves at its end."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

from lfcal.fit.judge import chi_square
from lfcal.fit.problem import Point, Problem
from lfcal.fit.questions import misfit
from lfcal.progress import Progress
from lfcal.units import format_share

__all__ = ["FitProgress", "rounds"]


@dataclass(frozen=True, slots=True)
class FitProgress(Progress):
    """The end of a round of derivatives: its work is done; how many rounds there will be nobody knows.

    Attributes
    ----------
    chi2
        Mean square of the fitted patterns' residuals, weighted by the light. Of a coarse model, which errs by itself,
        the variance has that error; it falls towards 1 from round to round, and may rise where the fit goes on finer.
    left_out
        What the patterns that are never fitted have beside model and noise, as a share of their rms (relative L2); 0
        where it is less than their noise. NaN where none is left out.
    """

    chi2: float = math.nan
    left_out: float = math.nan


def rounds() -> Callable[[Problem, Point, str], FitProgress]:
    """Return what makes the record of a round that ended at a point, in a stage of a fit."""
    start = time.perf_counter()

    def record(problem: Problem, point: Point, stage: str) -> FitProgress:
        aside = problem.measured.left_out
        found = chi_square(point, problem.fitted, 0)
        left = misfit(problem, point, aside) if aside.any() else math.nan
        note = f"χ² {found.lit:.3g}" + (f", left-out patterns {format_share(left)} off" if aside.any() else "")
        return FitProgress(1, 1, stage, time.perf_counter() - start, note, chi2=found.lit, left_out=left)

    return record
