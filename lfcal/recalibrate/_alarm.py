"""Statistical test of measured drifts: T², its threshold for a rate of false alarms, and several tests together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri, fdtrc, fdtri

__all__ = ["LEAST_QUIET", "AlarmTest", "MeasuredDrift", "mean_drift", "rejected"]

F8 = NDArray[np.float64]

LEAST_QUIET = 6
"""Smallest number of quiet frames that determine a threshold."""


EXACT: F8 = np.zeros(3)
"""Default of the error of a linear step: none."""


class MeasuredDrift(NamedTuple):
    """Measured drifts ``(k,)``, their covariance ``(k, k)`` from noise, and two errors ``(k,)``.

    ``floors`` is the error of the model. ``linear`` is the error of a linear step to the drift. Without a drift it is
    zero, so tests do not include it.
    """

    values: F8
    noise: F8
    floors: F8
    linear: F8 = EXACT

    @property
    def covariance(self) -> F8:
        """Covariance ``(k, k)`` with the error of the model."""
        found: F8 = self.noise + np.diag(self.floors**2)
        return found

    @property
    def sigmas(self) -> F8:
        """Standard deviations ``(k,)`` with the error of the model."""
        found: F8 = np.sqrt(np.diag(self.covariance))
        return found


def mean_drift(drifts: Sequence[MeasuredDrift]) -> MeasuredDrift:
    """Return the weighted mean of drifts; the error of the model is common to all, so that no mean reduces it."""
    weights = [np.linalg.inv(one.noise) for one in drifts]
    noise = np.linalg.inv(np.sum(weights, axis=0))
    values = noise @ np.sum([w @ one.values for w, one in zip(weights, drifts, strict=True)], axis=0)
    return MeasuredDrift(values, noise, drifts[0].floors, np.mean([one.linear for one in drifts], axis=0))


class AlarmTest:
    """Test whether drifts differ from those of quiet frames, or from zero.

    With quiet frames, this is Hotelling's test of drifts relative to the mean drift of the quiet frames, in units of
    their stated standard deviations, which depend on the brightness of each frame. The covariance of these values is
    estimated from the quiet frames. A common factor in the stated standard deviations therefore has no effect. Without
    quiet frames, the stated covariance is assumed to be correct.

    Parameters
    ----------
    quiet
        Drifts of at least `LEAST_QUIET` quiet frames; empty: none.
    rate
        Probability of an alarm without a drift.

    Attributes
    ----------
    start
        Mean drift ``(k,)`` of the quiet frames, relative to which drifts are tested; zero without them.
    """

    def __init__(self, quiet: Sequence[MeasuredDrift], rate: float) -> None:
        self.count, self.rate = len(quiet), rate
        self.start: F8 = np.zeros(3)
        self._start_variance: F8 = np.zeros(3)
        if quiet:
            mean = mean_drift(quiet)
            self.start = mean.values
            self._start_variance = np.diag(mean.noise) + mean.floors**2 / self.count
            self.spread: F8 = np.cov(np.stack([self._score(one) for one in quiet]).T)

    def threshold(self, k: int = 3) -> float:
        """Return the threshold of T² for ``k`` values.

        With n quiet frames, it follows from an F distribution with k and n - k degrees of freedom, and otherwise from a
        chi² distribution.
        """
        n = self.count
        return float(k * (n - 1) / (n - k) * fdtri(k, n - k, 1 - self.rate)) if n else float(chdtri(k, self.rate))

    def tested(self, drifts: Sequence[MeasuredDrift], *, floored: bool = False) -> tuple[float, float]:
        """Return T² of the mean of drifts, and the probability of a larger one without a drift.

        The scatter of quiet frames contains the part of the model's error that depends on the object. ``floored``
        states that the mean is over many frames, so that averaging must not reduce this error. Without quiet frames, it
        is never reduced.
        """
        k, n, m = len(drifts[0].values), self.count, len(drifts)
        if not n:
            mean = mean_drift(drifts)
            square = float(mean.values @ np.linalg.solve(mean.covariance, mean.values))
            return square, float(chdtrc(k, square))
        away = np.mean([self._score(one) for one in drifts], axis=0)
        error = np.mean([np.sqrt(self._start_variance) / one.sigmas for one in drifts], axis=0)
        covariance = self.spread / m + self.spread * np.outer(error, error)
        if floored:
            covariance = covariance + (1 - 1 / m) * np.diag(
                np.mean([one.floors / one.sigmas for one in drifts], axis=0) ** 2
            )
        square = float(away @ np.linalg.solve(covariance, away))
        return square, float(fdtrc(k, n - k, square * (n - k) / (k * (n - 1))))

    def errors(self, drift: MeasuredDrift) -> F8:
        """Return the standard deviations, relative to ``start``: all errors, at least the scatter of quiet frames."""
        wide = np.maximum(1, np.sqrt(np.diag(self.spread))) if self.count else 1.0
        sigmas = np.sqrt(drift.sigmas**2 + self._start_variance)
        found: F8 = np.hypot(sigmas * wide, drift.linear)
        return found

    def _score(self, drift: MeasuredDrift) -> F8:
        """Return a drift ``(k,)`` relative to ``start``, in units of its standard deviations."""
        found: F8 = (drift.values - self.start) / drift.sigmas
        return found


def rejected(chances: Sequence[float], rate: float) -> list[int]:
    """Return the indices of tests that are significant together (Simes 1986; Benjamini and Hochberg 1995).

    Parameters
    ----------
    chances
        Probability of each result without a drift.
    rate
        Probability that any index is returned without a drift.
    """
    order = np.argsort(chances)
    good = [n for n, k in enumerate(order) if chances[int(k)] <= rate * (n + 1) / len(order)]
    return sorted(int(k) for k in order[: good[-1] + 1]) if good else []
