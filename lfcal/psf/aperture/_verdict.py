"""Decide which shape an edge shows, by likelihood ratios between circle, iris, stuck blade and second rim."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from lfcal.psf.aperture._compare import OutlineFit, circle, irises, rims, stuck_blades
from lfcal.psf.aperture._edge import HIGHEST, Edge, harmonics, matched_edge
from lfcal.psf.aperture._profile import ANGLES
from lfcal.psf.aperture.shape import blade_radius

__all__ = ["CERTAIN", "FALSE_ALARM", "TRIALS", "EdgeVerdict", "judged"]

FALSE_ALARM = 1e-4
"""Accepted probability that noise is mistaken for a shape."""

TRIALS = 200
"""Number of shapes (counts, rotations, curvatures, blades) that noise could be mistaken for."""

CERTAIN = 2 * math.log(TRIALS / FALSE_ALARM)
"""Smallest difference in chi-square between a shape and any other: twice the logarithm of the likelihood ratio."""

WHICH = 2 * math.log(5 / 1e-3)
"""Smallest difference for a stuck blade: to neighbouring blades, opposite blades, and another count."""

DOUBT = CERTAIN / 3
"""Improvement of chi-square below which the simpler of two shapes is kept."""

FAINTEST = (11, 0.6)
"""Blades and curvature of the roundest iris that must be distinguishable before an outline is called round."""

MOST_ELLIPTIC = 0.08
"""Largest ellipticity of an iris seen straight on; two displaced rims have more, and resemble few curved blades."""

MISFIT = (0.009, 0.010)
"""Largest misfit of the outline: a fraction of the radius, and a term over the pixel SNR."""

STRUCTURED = 4.0
"""Largest chi-square per degree of freedom of a shape that explains the edge."""

NOISY = 10.0
"""Pixel SNR below which noise limits the edge, and a second measurement with less noise helps."""

STRAIGHT = 2.0
"""Number of standard errors of the curvature within which blades count as straight."""


@dataclass(frozen=True, slots=True)
class EdgeVerdict:
    """Result of comparing shapes with an edge.

    Attributes
    ----------
    kind
        Key of `lfcal.psf.aperture.shape.KINDS`.
    fit
        The outline.
    margin
        Chi-square of the second-best shape minus that of this one, in units of ``unit``.
    unit
        Chi-square per degree of freedom of the best of all shapes, at least 1. Structure that no shape explains might
        be mistaken for a shape, so it reduces all differences.
    refusal
        Key of `lfcal.psf.aperture.shape.REFUSALS`, or empty.
    edge
        The edge in the last fit of the outline.
    regular
        The best regular iris of each blade count, best first.
    circle
        The best circle.
    """

    kind: str
    fit: OutlineFit
    margin: float
    unit: float
    refusal: str
    edge: Edge
    regular: tuple[OutlineFit, ...]
    circle: OutlineFit

    @property
    def confidence(self) -> float:
        """Probability of the shape, from 0 to 1, if all others together are as probable as the second-best one."""
        return 1 / (1 + TRIALS * math.exp(-min(max(0.0, self.margin), 100.0) / 2))


@dataclass(frozen=True, slots=True)
class _Fits:
    """All shapes fitted to an edge, with the best of each kind first."""

    edge: Edge
    round: OutlineFit
    regular: list[OutlineFit]
    stuck: list[OutlineFit]
    rims: list[OutlineFit]

    @property
    def gain(self) -> float:
        """Difference of chi-square between the circle and the best iris."""
        return self.round.chi2 - self.regular[0].chi2

    @property
    def best(self) -> OutlineFit:
        return min((self.round, *self.regular[:1], *self.stuck[:1], *self.rims[:1]), key=lambda fit: fit.chi2)

    @property
    def unit(self) -> float:
        best = self.best
        return max(1.0, best.chi2 / (2 * HIGHEST + 1 - best.parameters.size))


def judged(edge: Edge, snr: float) -> EdgeVerdict:
    """Return the shape that an edge shows, and how significant it is.

    Parameters
    ----------
    edge
        The edge.
    snr
        Ratio of the lit level to the noise of a pixel.
    """
    fits = _fitted(edge)
    close = min(fits.gain, fits.regular[1].chi2 - fits.regular[0].chi2) < 3 * CERTAIN * fits.unit
    if close and snr < NOISY:
        fits = max(_matched(edge, fits), key=lambda found: found.gain)
    fits = _with_faults(fits)
    if fits.best.arcs.stuck >= 0 or fits.best.arcs.rim is not None:
        # a displaced blade lies outside the matched window about a regular iris
        about = _about(fits.best)
        again = matched_edge(edge, about)
        fits = _with_faults(_fitted(again), always=True)
    return _refused(fits, _chosen(fits), snr)


def _fitted(edge: Edge) -> _Fits:
    round_one = circle(edge)
    return _Fits(edge, round_one, irises(edge, round_one), [], [])


def _about(fit: OutlineFit) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return fit.arcs.radius(ANGLES, -fit.row, -fit.column)


def _matched(edge: Edge, fits: _Fits) -> list[_Fits]:
    """Return the fits to the edge, measured with less noise about the best iris, and, separately, about the circle."""
    ends = []
    for start in (fits.regular[0], fits.round):
        about = start
        # three times, because each result moves the window of the next
        for _ in range(3):
            found = _fitted(matched_edge(edge, _about(about)))
            about = found.regular[0]
        ends.append(found)
    return ends


def _with_faults(fits: _Fits, *, always: bool = False) -> _Fits:
    """Return the fits, with fits of irregular shapes added if regular shapes leave a significant residual.

    With ``always``, fits of irregular shapes are always added.
    """
    if not always and min(fits.round.chi2, fits.regular[0].chi2) < CERTAIN:
        return fits
    cut = rims(fits.edge, fits.regular, fits.round)
    return _Fits(fits.edge, fits.round, fits.regular, stuck_blades(fits.edge, fits.regular, cut), cut)


def _chosen(fits: _Fits) -> tuple[str, OutlineFit, float]:
    """Return kind, fit and margin of the simplest shape that no more complex shape beats."""
    unit = fits.unit
    iris, next_iris = fits.regular[0], fits.regular[1]
    simple = iris if fits.gain > DOUBT * unit else fits.round
    if simple.chi2 - fits.best.chi2 > DOUBT * unit:
        return _faulty(fits, min(fits.round.chi2, iris.chi2))
    if simple is fits.round:
        # an iris fits slightly better than a circle by chance, because it has two more parameters
        return "round", simple, min(CERTAIN + DOUBT, _faintest(fits.edge) / 2) - fits.gain / unit
    kind = "polygon" if _straight(iris) else "rounded polygon"
    return kind, iris, min(fits.gain, next_iris.chi2 - iris.chi2) / unit


def _faulty(fits: _Fits, sound: float) -> tuple[str, OutlineFit, float]:
    """Return kind, fit and margin of the best irregular shape; ``sound`` is the best regular chi-square."""
    stuck, unit = fits.stuck[0], fits.unit
    # a cut circle has as many parameters as an iris with a stuck blade, a cut iris has two more
    cuts = [(fit.chi2 + (DOUBT * unit if fit.blades else 0.0), fit) for fit in fits.rims]
    least, cut = min(cuts, key=lambda entry: entry[0])
    if stuck.chi2 < least:
        among = fits.stuck[1].chi2 - stuck.chi2 if len(fits.stuck) > 1 else math.inf
        plain = min((fit.chi2 for fit in fits.rims if not fit.blades), default=math.inf) - stuck.chi2
        return "stuck blade", stuck, min(sound - stuck.chi2, min(among, plain) * CERTAIN / WHICH) / unit
    return "cat's eye", cut, (min(sound, stuck.chi2) - cut.chi2) / unit


def _straight(iris: OutlineFit) -> bool:
    return iris.arcs.curvature < 0.05 or iris.arcs.curvature < STRAIGHT * math.sqrt(iris.covariance[6, 6])


def _faintest(edge: Edge) -> float:
    """Return the chi-square by which the `FAINTEST` iris of this edge's size and errors would beat a circle."""
    outline = harmonics(edge.radius * blade_radius(ANGLES, FAINTEST[0], 0.0, 1.0, FAINTEST[1])) * edge.damping
    share = np.abs(outline[3:]) / edge.sigma[3:]
    return float((share**2).sum())


def _refused(fits: _Fits, chosen: tuple[str, OutlineFit, float], snr: float) -> EdgeVerdict:
    """Return the verdict, with the reason if it is not reliable."""
    kind, fit, margin = chosen
    outline = _about(fit)
    damped = np.fft.irfft(np.fft.rfft(outline)[: HIGHEST + 1] * fits.edge.damping, ANGLES.size)
    misfit = float(np.std(fits.edge.smooth - damped)) / fits.edge.radius
    e = math.hypot(fit.arcs.stretch, fit.arcs.shear)
    refusal = ""
    own = fit.chi2 / (2 * HIGHEST + 1 - fit.parameters.size)
    if 2 * e / (1 + e) > MOST_ELLIPTIC or misfit > MISFIT[0] + MISFIT[1] / max(snr, 0.5) or own > STRUCTURED:
        refusal = "irregular"
    elif margin < CERTAIN:
        refusal = "unclear"
    if refusal == "unclear" and snr < NOISY:
        # no shape is reported; the best regular iris is kept
        fit = fits.regular[0]
    return EdgeVerdict(
        "" if refusal else kind, fit, margin, fits.unit, refusal, fits.edge, tuple(fits.regular), fits.round
    )
