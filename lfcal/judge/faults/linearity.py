"""Values that are not proportional to the light: a power law, or compression of bright values."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.judge._modelled import correlation
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FaultPicture, FoundFault
from lfcal.judge.faults._series import SURE

__all__ = ["FAULTS", "NotLinear"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

CURVED = 0.02
"""Difference of an exponent from 1 above which it is reported."""

STRONG = 0.1
"""Smallest difference from 1 of an exponent found by trying; smaller ones are measured by a derivative."""

EXPONENTS = np.geomspace(0.3, 3.0, 41)
"""Exponents that are tried."""

LIKE, GAINED = 0.99, 4.0
"""Correlation with the camera below which exponents are tried, and the required factor of improvement."""

TURNS = 2
"""Number of iterations with linearised values, because derivatives assume a linear response."""

MOST_SAG = 0.24
"""Largest bend of values that saturate gradually; at a quarter, the curve is flat at the brightest value."""


@dataclass(frozen=True)
class _Law:
    """A law between values and light, whose ``bend`` is 0 if they are proportional.

    ``peak`` is the brightest value, in counts.
    """

    peak: float
    bend: float = 0.0

    def bent(self, light: F4) -> F4:
        raise NotImplementedError

    def straight(self, values: F4) -> F4:
        raise NotImplementedError

    def column(self, light: F4) -> F4:
        """Return the derivative of values with respect to the bend, at 0."""
        raise NotImplementedError

    def further(self, more: float) -> _Law:
        """Return the law with the remaining bend, measured on linearised values, added to it."""
        raise NotImplementedError

    def words(self, sigma: float) -> str:
        raise NotImplementedError


class _Power(_Law):
    """Values proportional to the light to the power of 1 + bend."""

    def bent(self, light: F4) -> F4:
        return _to_power(light, 1 + self.bend, self.peak)

    def straight(self, values: F4) -> F4:
        return _to_power(values, 1 / max(1 + self.bend, 0.1), self.peak)

    def column(self, light: F4) -> F4:
        peak = float(light.max())
        lit = light > 1e-4 * peak
        found: F4 = np.where(lit, light * np.log(np.maximum(light, 1e-30) / peak), 0.0).astype(np.float32)
        return found

    def further(self, more: float) -> _Power:
        return _Power(self.peak, (1 + self.bend) * (1 + more) - 1)

    def words(self, sigma: float) -> str:
        return f"values are proportional to the light to the power of {1 + self.bend:.4f} ± {sigma:.4f}"


class _Sag(_Law):
    """Values that lack a fraction of the light that grows with the light, and equals the bend at ``peak`` counts."""

    def bent(self, light: F4) -> F4:
        found: F4 = (light * (1 - np.float32(self.bend / self.peak) * np.abs(light))).astype(np.float32)
        return found

    def straight(self, values: F4) -> F4:
        share = np.float32(self.bend / self.peak)
        root = np.sqrt(np.maximum(1 - 4 * share * np.abs(values), 0))
        found: F4 = (2 * values / (1 + root)).astype(np.float32)
        return found

    def column(self, light: F4) -> F4:
        found: F4 = (-light * np.abs(light) / np.float32(self.peak)).astype(np.float32)
        return found

    def further(self, more: float) -> _Sag:
        return _Sag(self.peak, float(np.clip(self.bend + more, -MOST_SAG, MOST_SAG)))

    def words(self, sigma: float) -> str:
        percent = 100 * float(self.straight(np.array(self.peak, np.float32))) / self.peak
        which = "lack" if self.bend > 0 else "exceed"
        return f"the brightest values {which} {abs(self.bend) * percent:.1f} ± {sigma * percent:.1f} % of the light"


class NotLinear(Fault):
    """Values that are not proportional to the light."""

    name = "not_linear"
    # before lines and pixels: with nonlinear values the model is wrong everywhere, and any line may stand out
    strong_rank = 8
    rank = 9
    title = "values not proportional to the light"
    subject = "sensor"
    advice = (
        "Switch off the gamma and contrast adjustments of the camera and record again, or linearise the frames and "
        "assemble H again."
    )
    settles: ClassVar[tuple[str, ...]] = ("background", "leak")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault, with the nonlinear law that fits best, if the values are not proportional to the light."""
        peak = float(np.abs(evidence.data).max()) or 1.0
        bend, sigma = _reported(evidence, _Power(peak))
        likely = _likeliest(evidence, peak)
        if likely is None and abs(bend) < max(CURVED, SURE * sigma):
            return
        start, reported = (_Power(peak, bend), abs(bend) / sigma) if likely is None else likely
        tried = [_settled(evidence, start)]
        if likely is None:
            tried.append(_settled(evidence, _Sag(peak).further(_reported(evidence, _Sag(peak))[0])))
        law, sigma, now = min(tried, key=lambda one: one[2].misfit)
        light = np.maximum(now.light, 0)
        change = np.abs(law.bent(light) - light).sum(dtype=np.float64)
        yield FoundFault(
            self,
            law.words(sigma),
            reported,
            float(change / max(float(light.sum(dtype=np.float64)), 1e-300)),
            picture=_tone(evidence, light, peak),
            repair=lambda index, patterns: law.straight(patterns),
            put_in=lambda patch: law.bent(patch.light),
        )


def _settled(evidence: Evidence, law: _Law) -> tuple[_Law, float, Evidence]:
    """Return a fitted law, the standard deviation of its bend, and the evidence of the linearised values."""
    for _ in range(TURNS):
        now = evidence.with_data(law.straight(evidence.data), evidence.valid)
        more, sigma = _reported(now, law)
        law = law.further(more)
    return law, sigma, evidence.with_data(law.straight(evidence.data), evidence.valid)


def _reported(evidence: Evidence, law: _Law) -> tuple[float, float]:
    """Return the remaining bend of the values by a law, and its standard deviation."""
    values, sigmas = evidence.beyond(law.column(np.maximum(evidence.light, 0)))
    return _mean(values, sigmas) if np.isfinite(sigmas).any() else (0.0, np.inf)


def _likeliest(evidence: Evidence, peak: float) -> tuple[_Law, float] | None:
    """Return the power law whose removal makes patterns most similar to the camera, and its estimated significance.

    The result is None if they match unchanged, or if the removal hardly improves the match. A small bend is measured by
    its derivative instead.
    """
    model = _without_mean(evidence.model, evidence.valid)
    alike = correlation(model, _without_mean(evidence.data, evidence.valid))
    if float(np.median(alike)) > LIKE:
        return None
    straight = (_Power(peak, float(exponent) - 1).straight(evidence.data) for exponent in EXPONENTS)
    tried = [correlation(model, _without_mean(one, evidence.valid)) for one in straight]
    best = int(np.argmax([np.median(one) for one in tried]))
    gained = (1 - alike) / np.maximum(1 - tried[best], 1e-9)
    if abs(EXPONENTS[best] - 1) < STRONG or float(np.median(gained)) < GAINED:
        return None
    return _Power(peak, float(EXPONENTS[best]) - 1), float(np.median(gained) * np.sqrt(len(gained)))


def _without_mean(patterns: F4, valid: NDArray[np.bool_]) -> F4:
    """Return patterns ``(n, nt, ns)`` minus the mean of their valid samples, because a background is not a bend."""
    mean = np.where(valid, patterns, 0).sum((1, 2)) / np.maximum(valid.sum((1, 2)), 1)
    found: F4 = np.where(valid, patterns - mean[:, None, None], 0).astype(np.float32)
    return found


def _to_power(light: F4, exponent: float, peak: float) -> F4:
    found: F4 = (np.sign(light) * peak * (np.abs(light) / peak) ** np.float32(exponent)).astype(np.float32)
    return found


def _mean(values: F8, sigmas: F8) -> tuple[float, float]:
    """Return the weighted mean and its standard deviation; the latter from the scatter if this gives a larger one."""
    good = np.isfinite(sigmas)
    weight = 1 / np.square(sigmas[good])
    mean = float((weight * values[good]).sum() / weight.sum())
    scatter = float(np.sqrt((weight**2 * np.square(values[good] - mean)).sum()) / weight.sum())
    return mean, max(scatter, float(1 / np.sqrt(weight.sum())))


def _tone(evidence: Evidence, light: F4, peak: float) -> FaultPicture:
    edges = np.linspace(0.0, 1.0, 25) * peak
    which = np.digitize(light[evidence.valid], edges)
    seen = evidence.data[evidence.valid]
    means = np.array([seen[which == k].mean() if (which == k).any() else np.nan for k in range(1, len(edges))])
    return FaultPicture(means, "counts", "mean value relative to the expected light", ("light (counts)",), edges[:-1])


FAULTS = (NotLinear(),)
