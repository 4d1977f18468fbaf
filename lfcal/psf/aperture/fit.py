"""The fit of an iris to a depth-plane sum, which refuses where it cannot know."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.errors import InputError
from lfcal.psf.aperture import refine as model
from lfcal.psf.aperture.locate import LitPatch, despike, find_patch, flatten
from lfcal.psf.aperture.profile import ANGLES, RAYS, edge_profile, shrink
from lfcal.psf.aperture.refine import EdgePixels, IrisFit, matched_profile, refine
from lfcal.psf.aperture.select import Candidate, candidates, strongest_harmonic
from lfcal.psf.aperture.shape import Aperture, blade_radius, polygon_area

__all__ = ["fit_aperture"]

SMALLEST = 9
"""Smallest cutout side that can show an aperture (pixels)."""

CIRCLE_MARGIN = 10.0
"""An iris must beat the circle's information criterion by this: the test that ripple and dirt cannot fool."""

CLEAR_MARGIN = 20.0
"""Beyond this in both, one fit to the pixels is enough."""

COUNT_CHI2 = 14.0
"""The pixels' chi-square must separate the two best counts by this, in units of the reduced one."""

CIRCLE_CHI2 = 40.0
"""And the best count from the circle by this, where noise and not ripple limits the fit."""

ROUND = 0.92
"""Curvature from which on an iris is a circle with the ripple of a lattice on it."""

MOST_ELLIPTIC = 0.08
"""Ellipticity of an iris seen squarely; two shifted rims make more, and mimic few curved blades."""

FAINTEST = (11, 0.6)
"""Blades and curvature of the roundest iris that must be visible before a round outline is called a circle."""

MOST_TOUCHING = 0.1
"""Share of the cutout's border that is lit beyond which no outline is tried."""

NOISE_LIMITED = 1.3
"""Reduced chi-square up to which noise limits the fit."""

MISFIT = (0.009, 0.010)
"""Largest misfit of the outline: so much of the radius, plus so much over the pixel SNR."""


def fit_aperture(depth_sum: ArrayLike) -> Aperture:
    """Return the iris that a depth-plane sum shows, or an `Aperture` whose ``refusal`` says why there is none.

    Background and noise come from the cutout's border. Vignetting is taken out, the edge radius is measured
    over angle, blade counts are compared on it, and the best is fitted to the pixels, with blur, tilt,
    vignetting and ellipticity.

    Parameters
    ----------
    depth_sum
        Sum of all patterns of a depth plane ``(nt, ns)``; not-a-number counts as background.

    Raises
    ------
    InputError
        If it is not a 2-D image of at least 9 x 9 pixels.
    """
    image = _clean(depth_sum)
    patch = find_patch(image)
    if patch is None:
        return _none()
    touching = _touching(patch)
    if touching > MOST_TOUCHING:
        return _circle(patch, "cut off")
    answer = _fit_inside(image, patch)
    return replace(answer, confident=False, refusal="cut off") if touching else answer


def _fit_inside(image: NDArray[np.float64], patch: LitPatch) -> Aperture:
    """Return the aperture of a patch that lies within the cutout."""
    patch, edge = _profile(image, patch)
    if not patch.level > 0:
        return _circle(patch, "cat-eye")
    ranking = candidates(edge)
    irises = [c for c in ranking if c.blades]
    margin = next(c for c in ranking if not c.blades).bic - irises[0].bic, irises[1].bic - irises[0].bic
    agreed = irises[0].blades == strongest_harmonic(edge)
    pixels = EdgePixels.around(image, patch, shrink(edge))
    # profile and strongest harmonic agree with a wide margin: comparing all counts on the pixels would not change it
    if agreed and min(margin) > CLEAR_MARGIN:
        best = refine(pixels, patch, irises[0])
        return _judge(best, patch, edge, _Evidence(margin[0], margin[1], math.inf, math.inf))
    round_fit = refine(pixels, patch, Candidate(0.0, 0))
    second = candidates(matched_profile(pixels, patch, round_fit))
    fits = _best_of_each(refine(pixels, patch, c) for c in _likely(irises, [c for c in second if c.blades]))
    # ripple of the lattice lifts chi-square above the noise's: gaps count in units of it
    unit = max(1.0, fits[0].reduced)
    gaps = (round_fit.chi2 - fits[0].chi2) / unit, (fits[1].chi2 - fits[0].chi2) / unit
    return _judge(fits[0], patch, edge, _Evidence(margin[0], margin[1] if agreed else 0.0, *gaps))


@dataclass(frozen=True, slots=True)
class _Evidence:
    """By how much the answer beats the circle and the next count: by the profile, and by the pixels."""

    circle_bic: float
    count_bic: float
    circle_chi2: float
    count_chi2: float


def _likely(first: list[Candidate], second: list[Candidate]) -> list[Candidate]:
    """Return the leading irises of both rankings, and half and twice the first one's count."""
    # half and twice a count share its harmonics, and are its usual mistakes
    related = [c for c in first[3:] if c.blades in (first[0].blades / 2, 2 * first[0].blades)]
    likely = first[:3] + related
    for c in second[:3]:
        step = 2 * math.pi / c.blades
        turns = [(c.rotation_rad - k.rotation_rad + step / 2) % step - step / 2 for k in likely if k.blades == c.blades]
        # the same count at another rotation is another minimum of the fit
        if all(abs(turn) > step / 8 for turn in turns):
            likely.append(c)
    return likely


def _best_of_each(fits: Iterable[IrisFit]) -> list[IrisFit]:
    """Return the best fit of each blade count, best first."""
    best: dict[int, IrisFit] = {}
    for fit in sorted(fits, key=lambda fit: fit.chi2):
        best.setdefault(fit.blades, fit)
    return list(best.values())


def _clean(depth_sum: ArrayLike) -> NDArray[np.float64]:
    image = np.array(depth_sum, np.float64)
    if image.ndim != 2 or min(image.shape) < SMALLEST:
        raise InputError.expected(
            "depth-plane sum",
            f"an image of at least {SMALLEST} x {SMALLEST} pixels",
            f"shape {image.shape}",
            "give the sum over all positions of one plane",
        )
    finite = np.isfinite(image)
    if not finite.all():
        # not-a-number takes the median, which neither lights nor darkens anything
        image[~finite] = np.median(image[finite]) if finite.any() else 0.0
    # the fit knows no unit: bring the values to the order of one
    size = float(np.abs(image).max())
    return despike(image / size if size > 0 else image)


def _touching(patch: LitPatch) -> float:
    """Return the share of the cutout's border that is lit."""
    mask = patch.mask
    return float(np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).mean())


def _none() -> Aperture:
    return Aperture(0, (math.nan, math.nan), 0.0, math.nan, math.nan, refusal="too dim")


def _circle(patch: LitPatch, refusal: str) -> Aperture:
    area = math.pi * patch.radius**2
    return Aperture(
        0, (patch.row, patch.column), 0.0, patch.radius, area, 1.0, snr=_snr(patch.level, patch.noise), refusal=refusal
    )


def _snr(level: float, noise: float) -> float:
    return level / noise if noise > 0 else math.inf


def _profile(image: NDArray[np.float64], patch: LitPatch) -> tuple[LitPatch, NDArray[np.float64]]:
    """Return the patch recentred by the profile's first harmonic, and the edge radius over angle."""
    row, column, radius = patch.row, patch.column, patch.radius
    for _ in range(3):
        flat, level = flatten(image, patch.background, row, column, radius)
        edge = edge_profile(flat, row, column, radius)
        # a centre off by (dx, dy) adds dx cos + dy sin to the edge radius: twice the first coefficient, the imaginary
        # part negated
        first = np.fft.rfft(edge)[1] / RAYS
        column += 2 * float(first.real)
        row -= 2 * float(first.imag)
        radius = float(np.sqrt(np.mean(edge**2)))
    for half in (0.16, 0.10, 0.08):  # narrower windows about the smooth edge let in less noise
        middle = shrink(edge) / radius
        edge = edge_profile(flat, row, column, radius, middle - half, middle + half)
    return replace(patch, row=row, column=column, radius=radius, level=level), edge


def _judge(fit: IrisFit, patch: LitPatch, edge: NDArray[np.float64], evidence: _Evidence) -> Aperture:
    """Return the aperture of the best fit with its confidence, or with the reason to refuse."""
    answer = _aperture(fit, patch)
    misfit = float(np.std(shrink(edge) - _edge_about(answer, patch))) / patch.radius
    bladed = evidence.circle_bic > CIRCLE_MARGIN
    # where ripple limits the fit, chi-square is no measure of chance and only the information criterion counts
    bladed |= evidence.circle_chi2 > CIRCLE_CHI2 and fit.reduced < NOISE_LIMITED
    counted = evidence.count_chi2 > COUNT_CHI2
    refusal = ""
    if answer.ellipticity > MOST_ELLIPTIC or misfit > MISFIT[0] + MISFIT[1] / max(answer.snr, 0.5):
        refusal = "cat-eye"
    elif answer.curvature > ROUND:
        refusal = "circle"
    elif not bladed and (fit.reduced >= NOISE_LIMITED or _faintest(answer) > 2.5 * CIRCLE_CHI2):
        refusal = "circle"
    elif not (bladed and counted):
        refusal = "unclear"
    margin = min(max(evidence.circle_bic, evidence.circle_chi2 / 4), max(evidence.count_bic, evidence.count_chi2 / 2))
    confidence = 1 - math.exp(-max(0.0, margin) / 10)
    if refusal == "circle":
        round_one = _circle(patch, refusal)
        return replace(round_one, blur_px=answer.blur_px, vignetting=answer.vignetting, snr=answer.snr)
    return replace(answer, confidence=confidence, confident=not refusal, refusal=refusal)


def _faintest(answer: Aperture) -> float:
    """Return the chi-square by which the `FAINTEST` iris of this size, blur and noise would beat a circle.

    A shift s of an edge of height A and Gaussian blur b adds ``s² A² / (2 sqrt(pi) b)`` per pixel of its length.
    """
    ripple = answer.apothem_px * float(np.std(blade_radius(ANGLES, FAINTEST[0], 0.0, 1.0, FAINTEST[1])))
    length = 2 * math.pi * answer.apothem_px
    return length * (ripple * answer.snr) ** 2 / (2 * math.sqrt(math.pi) * max(answer.blur_px, 0.3))


def _aperture(fit: IrisFit, patch: LitPatch) -> Aperture:
    p = fit.parameters
    stretch, shear = float(p[model.STRETCH]), float(p[model.SHEAR])
    e = math.hypot(stretch, shear)
    apothem, curvature = float(p[model.APOTHEM]), float(p[model.CURVATURE])
    step = 2 * math.pi / fit.blades
    return Aperture(
        blades=fit.blades,
        centre=(float(p[model.Y]), float(p[model.X])),
        rotation_rad=float(p[model.ROTATION]) % step,
        apothem_px=apothem,
        area_px2=polygon_area(fit.blades, apothem, curvature) / (1 - e * e),
        curvature=curvature,
        blur_px=float(p[model.BLUR]),
        ellipticity=2 * e / (1 + e),
        ellipse_axis_rad=0.5 * math.atan2(-shear, -stretch),
        vignetting=-float(p[model.DOME]) * (apothem / patch.radius) ** 2,
        snr=_snr(float(p[model.LEVEL]), patch.noise),
    )


def _edge_about(aperture: Aperture, patch: LitPatch) -> NDArray[np.float64]:
    """Return the outline as radius over `ANGLES` about the patch's centre."""
    away = aperture.outline(RAYS) - (patch.row, patch.column)
    theta = np.arctan2(away[:, 0], away[:, 1]) % (2 * math.pi)
    order = np.argsort(theta)
    edge: NDArray[np.float64] = np.interp(ANGLES, theta[order], np.hypot(*away.T)[order], period=2 * math.pi)
    return edge
