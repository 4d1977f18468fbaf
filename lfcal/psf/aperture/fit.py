"""Fit an iris to a depth-plane sum; the fit is refused if the sum does not determine the iris."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError
from lfcal.psf.aperture._compare import CURVATURE, ROTATION, STUCK, OutlineFit
from lfcal.psf.aperture._edge import BLUR_ERROR, Edge, measured_edge
from lfcal.psf.aperture._locate import LitPatch, despike, find_patch
from lfcal.psf.aperture._profile import ANGLES
from lfcal.psf.aperture._size import measured_area
from lfcal.psf.aperture._verdict import EdgeVerdict, judged
from lfcal.psf.aperture.shape import Aperture, CountFit, StuckBlade

__all__ = ["fit_aperture", "plane_verdict"]

SMALLEST = 9
"""Smallest cutout side that can show an aperture (pixels)."""

LEAST_RADIUS = 3.0
"""Radius below which a lit patch is the image of a point in focus, without an outline to fit (pixels)."""

MOST_TOUCHING = 0.1
"""Lit fraction of the cutout's border above which no outline is fitted."""

CURVATURE_FLOOR = 0.01
"""Smallest standard error of the curvature, due to the size of pixels."""

WIDEST_BLUR = 0.3
"""Ratio of blur to radius above which blur determines the outline."""


def fit_aperture(depth_sum: ArrayLike, *, footprint_px: float = 0.0) -> Aperture:
    """Fit the shape of the iris to a depth-plane sum; if it cannot be determined, ``refusal`` of the result states why.

    Background and noise are measured at the border of the cutout. Vignetting and the ripple of the lenslet lattice are
    removed, and the radius of the edge is measured as a function of angle. Four kinds of outline are fitted to the
    edge: a circle, regular irises, irises with a displaced blade, and each of these clipped by a second rim. The noise
    for comparing the fits is measured at the edge and within the lit area.

    Parameters
    ----------
    depth_sum
        Sum of all patterns of a depth plane, ``(nt, ns)``, in any unit. NaN is replaced by the median.
    footprint_px
        Width over which a lenslet spreads the light of a defocused point (px), as returned by `footprint_px`; 0:
        unknown. An outline with a radius below this width is that of lenslets and not that of the iris.

    Raises
    ------
    InputError
        If ``depth_sum`` does not have two axes.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import open_psf
    >>> from lfcal.psf.aperture import fit_aperture
    >>> with open_psf("H.h5") as H:
    ...     iris = fit_aperture(H.depth_sum(1))
    >>> print(iris.blades, "blades,", round(iris.diameter_px), "px,", round(iris.rotation_rad, 1), "rad")
    7 blades, 32 px, 0.2 rad
    >>> fit_aperture(np.zeros((31, 31))).reason
    'no lit area is visible above the noise'
    """
    return plane_verdict(depth_sum, footprint_px=footprint_px)[0]


def plane_verdict(depth_sum: ArrayLike, *, footprint_px: float = 0.0) -> tuple[Aperture, EdgeVerdict | None]:
    """Return the aperture and the comparison of its fits; the parameters are those of `fit_aperture`.

    The comparison is None if no outline could be fitted, or if the outline is cut off or in focus.
    """
    image = _clean(depth_sum)
    if min(image.shape) < SMALLEST:
        return _none("too small"), None
    patch = find_patch(image)
    if patch is None:
        return _none("too dim"), None
    if patch.radius < LEAST_RADIUS:
        return _circle(patch, "in focus"), None
    touching = _touching(patch)
    if touching > MOST_TOUCHING:
        return _circle(patch, "cut off"), None
    edge = measured_edge(image, patch)
    if edge is None:
        return _circle(patch, "irregular"), None
    verdict = judged(edge, _snr(edge.level, patch.noise))
    answer = _aperture(verdict, patch)
    if touching:
        return answer.refused("cut off"), None
    if edge.radius < footprint_px:
        return answer.refused("in focus"), None
    return answer, verdict


def _clean(depth_sum: ArrayLike) -> NDArray[np.float64]:
    image = np.array(depth_sum, np.float64)
    if image.ndim != 2 or not image.size:
        raise InputError.expected(
            "sum of a depth plane",
            "an image of rows and columns",
            f"shape {image.shape}",
            "give the sum over all positions of one plane",
        )
    finite = np.isfinite(image)
    if not finite.all():
        # NaN becomes the median, so that it is neither light nor dark
        image[~finite] = np.median(image[finite]) if finite.any() else 0.0
    # scale the values to the order of one, because the fit has no unit
    size = float(np.abs(image).max())
    return despike(image / size if size > 0 else image)


def _none(refusal: str) -> Aperture:
    return Aperture(0, (math.nan, math.nan), 0.0, math.nan, math.nan, refusal=refusal)


def _touching(patch: LitPatch) -> float:
    """Return the fraction of the cutout's border that is lit."""
    mask = patch.mask
    return float(np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]]).mean())


def _circle(patch: LitPatch, refusal: str) -> Aperture:
    area = math.pi * patch.radius**2
    return Aperture(
        0, (patch.row, patch.column), 0.0, patch.radius, area, 1.0, snr=_snr(patch.level, patch.noise), refusal=refusal
    )


def _snr(level: float, noise: float) -> float:
    return level / noise if noise > 0 else math.inf


def _aperture(verdict: EdgeVerdict, patch: LitPatch) -> Aperture:
    """Return the aperture of a verdict, with the objects inside it."""
    fit, edge = verdict.fit, verdict.edge
    kind, refusal = verdict.kind, verdict.refusal
    if edge.blur_px > WIDEST_BLUR * edge.radius:
        kind, refusal = "", "unclear"
    blocked = edge.obstruction if refusal in ("", "unclear") else None
    if blocked is not None and kind in ("round", "polygon", "rounded polygon"):
        kind = "annular" if blocked.is_central((edge.row, edge.column), edge.radius) else "obstructed"
    arcs = fit.arcs
    e = math.hypot(arcs.stretch, arcs.shear)
    fitted = math.pi * float(np.mean(arcs.radius(ANGLES) ** 2))
    area, sigma = measured_area(patch, edge, fitted)
    step = 2 * math.pi / max(1, fit.blades)
    # the first vertex lies within one blade of angle 0; blades are counted from it
    skipped = math.floor(arcs.rotation_rad / step) if fit.blades else 0
    return Aperture(
        blades=fit.blades,
        centre=(edge.row + fit.row, edge.column + fit.column),
        rotation_rad=arcs.rotation_rad - skipped * step if fit.blades else 0.0,
        # the edge determines the shape, the light the size
        apothem_px=arcs.apothem * math.sqrt(area / fitted),
        area_px2=area,
        area_sigma_px2=sigma,
        curvature=arcs.curvature if fit.blades else 1.0,
        blur_px=edge.blur_px,
        ellipticity=2 * e / (1 + e),
        ellipse_axis_rad=0.5 * math.atan2(-arcs.shear, -arcs.stretch),
        vignetting=edge.vignetting,
        snr=_snr(edge.level, patch.noise),
        confidence=math.nan if refusal else verdict.confidence,
        confident=not refusal,
        refusal=refusal,
        kind=kind,
        curvature_sigma=curvature_error(fit, edge, verdict.unit),
        stuck=_stuck(fit, verdict.unit, skipped) if arcs.stuck >= 0 else None,
        rim=arcs.rim,
        obstruction=blocked,
        ripple=edge.ripple.amplitude,
        ripple_pitch_px=edge.ripple.pitch_px,
        counts=tuple(_count(found, verdict) for found in verdict.regular),
    )


def _count(found: OutlineFit, verdict: EdgeVerdict) -> CountFit:
    step = 2 * math.pi / found.blades
    variance = max(float(found.covariance[ROTATION, ROTATION]), 0.0) * verdict.unit
    return CountFit(
        found.blades,
        (found.chi2 - verdict.circle.chi2) / verdict.unit,
        found.arcs.rotation_rad % step,
        # a rotation is uncertain by one blade at most
        min(math.sqrt(variance), step) if variance > 0 else step,
        found.arcs.curvature,
        curvature_error(found, verdict.edge, verdict.unit),
    )


def curvature_error(fit: OutlineFit, edge: Edge, unit: float) -> float:
    """Return the standard error of the blades' curvature, from the noise and the blur of the edge; NaN without blades.

    ``unit`` is the factor by which variances of the fit are multiplied, its chi-square per degree of freedom.
    """
    if not fit.blades:
        return math.nan
    noise = float(fit.covariance[CURVATURE, CURVATURE]) * unit
    # the blades' harmonic is (1 - curvature) times its damping, whose logarithm is proportional to the blur squared
    damping = max(abs(float(edge.damping[fit.blades])), 1e-3)
    blur = (1 - fit.arcs.curvature) * 2 * BLUR_ERROR * abs(math.log(damping))
    return math.sqrt(noise + blur**2 + CURVATURE_FLOOR**2)


def _stuck(fit: OutlineFit, unit: float, skipped: int) -> StuckBlade:
    arcs = fit.arcs
    direction = arcs.rotation_rad + (arcs.stuck + 0.5) * 2 * math.pi / arcs.blades
    variance = float(fit.covariance[STUCK, STUCK])
    # a blade covered by its neighbours may be anywhere beyond them
    error = arcs.apothem * math.sqrt(variance * unit) if variance > 0 else math.inf
    blade = (arcs.stuck + skipped) % arcs.blades
    # beyond this point, the blade's middle leaves the outline of the others: neighbours cover it
    others = replace(arcs, stuck_share=1.0, stretch=0.0, shear=0.0).radius(np.array([direction]))[0] / arcs.apothem - 1
    if arcs.stuck_share > others - 2 * error / arcs.apothem:
        error = math.inf
    return StuckBlade(blade, direction % (2 * math.pi), arcs.apothem * arcs.stuck_share, error)
