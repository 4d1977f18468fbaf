"""Early stopping: held-out pixels show when a reconstruction begins to fit noise.

Deconvolution first finds the object and then fits noise, earlier with subsets and acceleration. The prediction of a few
held-out pixels by a volume fitted to the others improves while the object is being found, and then gets worse
(cross-validation: Coakley 1991 for Richardson-Lucy). The last improvements are small while noise still grows. A run
therefore ends when, after two consecutive iterations, the expected further improvement is below the standard deviation
of the score. This is the rule of one standard error (Breiman et al. 1984, section 3.4.3). Methods that suppress noise
by a penalty lose nothing by continuing: they end at the best prediction. Neither the gain of the camera nor its noise
needs to be known.

This rule is suitable for volumes that are viewed. In sums over regions, noise averages out, but parts of the object
that have not been found do not. An estimate of sums needs less regularisation than one of the entire volume
(undersmoothing: Hall 1992, The Annals of Statistics 20, 675-694). A run for measuring therefore takes twice as many
iterations as were needed for the best prediction. Its patience grows with the iterations, so that a random dip does not
end it.

If gain and noise are known, the discrepancy principle (Morozov 1966; for photons Bertero et al. 2010, Inverse Problems
26, 105004) needs no held-out pixels. A volume is good enough when its image agrees with the frame to within the noise.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.solvers.measurement import Measurement
from lfcal.reconstruct.solvers.records import (
    Reconstruction,
    SolverProgress,
    SolverState,
    SolverWork,
    without_state,
)

__all__ = ["GOALS", "MOST_ITERATIONS", "STOPS", "held_out_pixels", "iter_until_best", "iter_until_noise", "misfit"]

MOST_ITERATIONS = 100
"""Default limit for the iterations of a run that stops automatically."""

STOPS = ("left-out", "discrepancy")
"""Criteria that can end a run that stops automatically: held-out pixels, or the sensor's noise."""

GOALS = ("view", "measure")
"""Purposes of a volume: to look at, or to measure sums over its regions."""

LONGER = 2
"""Number of iterations of a run for measuring, relative to that with the best prediction."""

SHARE = 0.04
"""Fraction of the pixels that are held out."""

PATIENCE = 3
"""Patience of the early stopping, in iterations."""

Score = Callable[[SolverState], tuple[float, float]]


def held_out_pixels(shape: tuple[int, int], seed: int = 0) -> NDArray[np.bool_]:
    """Return a random mask of ``shape`` that is True at about one in 25 pixels, those to hold out.

    The mask is always the same for the same shape and ``seed``.
    """
    return np.random.default_rng(seed).random(shape) < SHARE


@dataclass
class _Best:
    """Best estimate so far, according to its prediction of the held-out pixels."""

    settles: bool
    goal: str = GOALS[0]
    state: SolverState | None = None
    scores: list[float] = field(default_factory=list)
    idle: int = 0

    def take(self, state: SolverState, score: float, error: float) -> str:
        """Return the reason to stop at an estimate with this score and its error; empty: continue."""
        if not np.isfinite(score):
            return ""
        if not self.scores or score > max(self.scores):
            # keep only the volume, because the other state may be several times larger
            self.state = SolverState(state.volume, state.iteration, state.seconds)
        self.scores.append(score)
        best = self.state
        assert best is not None  # set at the first finite score
        if self.goal == "measure":
            if state.iteration < max(LONGER * best.iteration, best.iteration + PATIENCE):
                return ""
            self.state = SolverState(state.volume, state.iteration, state.seconds)
            return f"held-out pixels are predicted best after iteration {best.iteration}; sums need more iterations"
        if state.iteration - best.iteration >= PATIENCE:
            return f"the prediction of held-out pixels is best after iteration {best.iteration}"
        # twice, because the first updates of a method may shrink faster than later ones
        self.idle = self.idle + 1 if self.remaining() < error else 0
        if not self.settles and best.iteration == state.iteration and self.idle > 1:
            return f"held-out pixels are not predicted better, beyond their noise, after iteration {best.iteration}"
        return ""

    def remaining(self) -> float:
        """Return the expected further improvement if improvements continue to shrink at this rate."""
        if len(self.scores) < 4:
            return np.inf
        gains = np.diff(self.scores[-4:])
        if not (gains > 0).all():
            return np.inf
        # over two iterations, because gains of extrapolated steps alternate
        ratio = float(np.sqrt(gains[2] / gains[0]))
        return np.inf if ratio >= 1 else float(gains[2]) * ratio / (1 - ratio)


def iter_until_best(
    work: SolverWork, notes: tuple[str, ...], score: Score | None = None, *, settles: bool = False, goal: str = GOALS[0]
) -> SolverWork:
    """Run ``work`` until the prediction of held-out pixels stops improving.

    The result contains the estimate with the best prediction, or a later one for the goal ``"measure"``. If ``work``
    ends earlier, its own result is returned.

    Parameters
    ----------
    work
        Running solver whose image has held-out pixels.
    notes
        Notes on the measurement, for the result.
    score
        Function that returns the score of a state's prediction of held-out pixels, and the error of the score. None:
        use the solver's records, which refer to the estimate at the start of each iteration.
    settles
        Whether further iterations do not amplify noise. The run then ends only when the prediction has become worse,
        not when it improves by less than its noise.
    goal
        One of `GOALS`, as in `SolverChoice`.
    """
    best, before = _Best(settles, goal), None
    history: list[SolverProgress] = []
    try:
        while True:
            record = next(work)
            history.append(without_state(record))
            yield record
            if score is None:
                estimate, found = before, (record.held_out, record.held_out_error)
            else:
                estimate, found = record.state, score(_state_of(record))
            before = record.state
            why = "" if estimate is None else best.take(estimate, *found)
            if why and best.state is not None:
                return Reconstruction(best.state.volume, tuple(history), best.state, notes, why)
    except StopIteration as end:
        result: Reconstruction = end.value
        return result
    finally:
        work.close()


def misfit(model: NDArray[Any], data: Measurement, read_noise: float, gain: float) -> float:
    """Return chi-square per pixel, the weighted mean of ``(f - m)^2 / (gain (max(m, b) - r^2) + r^2)``.

    It is 1 if only noise remains.

    Parameters
    ----------
    model
        Model m of the image ``(Y, X)``: the projection of a volume plus the background of ``data``.
    data
        Measurement with the frame f and the background b, both including the square of the read noise.
    read_noise
        Rms read noise r (counts).
    gain
        Counts per photoelectron.
    """
    m, f = model.astype(np.float64), data.image.astype(np.float64)
    trust = np.asarray(data.ones(), np.float64)
    # at least the background, because linear solvers may predict less
    light = np.maximum(m, data.background) - read_noise**2
    variance = gain * np.maximum(light, 0) + read_noise**2
    # where no light is expected, assume at least one photoelectron in the whole frame
    variance = np.maximum(variance, gain * max(float(f.mean()), 0.0) / f.size)
    square = np.divide(trust * (f - m) ** 2, variance, out=np.zeros_like(m), where=variance > 0)
    whole = float(trust.sum())
    return float(square.sum()) / whole if whole > 0 else 0.0


def iter_until_noise(
    work: SolverWork, notes: tuple[str, ...], misfit_of: Callable[[NDArray[Any]], float]
) -> SolverWork:
    """Run ``work`` until the residual of the volume is no larger than the noise, and return the result.

    If ``work`` ends earlier, a note of the result states the residual relative to the noise.

    Parameters
    ----------
    work
        Running solver.
    notes
        Notes on the measurement, for the result.
    misfit_of
        Function that returns the `misfit` of a volume ``(nz, Y, X)``; the run ends when it is at most 1.
    """
    history: list[SolverProgress] = []
    left = np.inf
    try:
        while True:
            record = next(work)
            history.append(without_state(record))
            yield record
            state = _state_of(record)
            left = misfit_of(state.volume)
            if left <= 1:
                why = f"the residual reached the noise level after iteration {state.iteration}"
                return Reconstruction(state.volume, tuple(history), state, notes, why)
    except StopIteration as end:
        result: Reconstruction = end.value
        short = f"the residual is {left**0.5:.3g} times the noise; check the gain and the read noise, or H"
        return replace(result, notes=(*result.notes, short))
    finally:
        work.close()


def _state_of(record: SolverProgress) -> SolverState:
    assert record.state is not None  # records of a running solver have a state
    return record.state
