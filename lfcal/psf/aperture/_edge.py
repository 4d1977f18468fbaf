"""The edge of a depth-plane sum as harmonics over angle, each with its noise and its damping by blur.

The light summed along a ray (`lfcal.psf.aperture._profile`) gives the radius that encloses it, independent of blur.
Along the edge, the outline is convolved with the projection of the blur's kernel. The kernel's transform at k/R
therefore damps harmonic k of the outline at radius R. For an isotropic kernel, this transform equals that of the edge's
slope, which the same image shows. Blur and curved blades, which both round the corners, are thus separated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.aperture._locate import LitPatch, offsets, shading
from lfcal.psf.aperture._obstruction import dark_place, find_obstruction
from lfcal.psf.aperture._profile import ANGLES, RAYS, edge_profile, shrink
from lfcal.psf.aperture._ripple import Ripple, find_ripple
from lfcal.psf.aperture.shape import Obstruction

__all__ = ["HIGHEST", "Edge", "harmonics", "matched_edge", "measured_edge"]

Values = NDArray[np.float64]

HIGHEST = 40
"""Highest harmonic that is compared."""

WIDTH = 2.5
"""Half width of the window about the edge, in blurs; beyond it, 1 % of the edge's height remains."""

LEAST_WIDTH = 0.08
"""Smallest half width of the window, as a fraction of the radius, because the smooth edge rounds off corners."""

QUIET = slice(HIGHEST - 6, 90)
"""Harmonics higher than any iris has; they contain only noise."""

MODEL = 2e-4
"""Part of the radius that no model explains at best, because pixels are squares."""

FOURTH = 1.0
"""Largest shift of the edge due to the fourth moment of kernels that are not discs, in units of blur⁴ / radius³."""

BLUR_ERROR = 0.03
"""Relative error of the blur measured on an edge of finite length."""


@dataclass(frozen=True, slots=True)
class Edge:
    """The edge of a lit patch.

    Attributes
    ----------
    row, column, radius
        Origin of the rays and mean radius (pixels).
    harmonics
        ``(HIGHEST + 1,)`` complex coefficients of the edge's radius over angle (pixels).
    sigma
        Standard errors of their real and imaginary parts, from noise and structure of the lit patch (pixels).
    damping
        Fraction of each harmonic of the outline that remains after blur.
    blur_px
        Standard deviation of the Gaussian blur that gives the edge (pixels).
    level, noise
        Lit level and noise of a pixel.
    flat
        The image normalised to a lit level of 1, without ripple.
    shade
        The smooth lit level used for normalisation, 1 at the centre.
    ripple
        The ripple that was removed.
    smooth, half
        The smoothed edge over `ANGLES`, and the half width of the window about it (pixels).
    vignetting
        Relative decrease of the light from the centre to the mean radius; negative if the light increases outwards.
    obstruction
        A dark object inside, which was filled.
    """

    row: float
    column: float
    radius: float
    harmonics: NDArray[np.complex128]
    sigma: Values
    damping: Values
    blur_px: float
    level: float
    noise: float
    flat: Values
    shade: Values
    ripple: Ripple
    smooth: Values
    half: float
    vignetting: float
    obstruction: Obstruction | None


def harmonics(radius: Values) -> NDArray[np.complex128]:
    """Return the coefficients 0 to `HIGHEST` of radii over angle ``(..., angles)``."""
    spectrum: NDArray[np.complex128] = np.fft.rfft(radius)[..., : HIGHEST + 1] / radius.shape[-1]
    return spectrum


def measured_edge(image: Values, patch: LitPatch) -> Edge | None:
    """Return the edge of a patch; None if the patch has no lit level, or the image shows none of its edge."""
    row, column, radius = patch.row, patch.column, patch.radius
    for _ in range(3):
        shade, level, vignetting = shading(image, patch, row, column, radius)
        if not level > 0:
            return None
        flat = (image - patch.background) / shade
        profile = edge_profile(flat, row, column, radius)
        # a centre off by (dx, dy) adds dx cos + dy sin to the edge radius: twice the first coefficient, the imaginary
        # part negated
        first = np.fft.rfft(profile)[1] / RAYS
        column += 2 * float(first.real)
        row -= 2 * float(first.imag)
        radius = float(np.sqrt(np.mean(profile**2)))
        rows, columns = image.shape
        if not (0 <= row < rows and 0 <= column < columns and radius < math.hypot(rows, columns)):
            return None
    slope = _Slope.of(flat, row, column, shrink(profile))
    outline = shrink(profile)
    blocked = find_obstruction(flat, row, column, outline, slope.blur_px, max(patch.noise, 0.0) / level)
    if blocked is not None:
        # otherwise its harmonics would be mistaken for ripple
        flat = np.where(dark_place(flat, row, column, outline, slope.blur_px), 1.0, flat)
    ripple = find_ripple(flat, row, column, radius - WIDTH * slope.blur_px - 1)
    flat = ripple.removed(flat, row, column, radius + 3 * slope.blur_px + 2)
    for least in (2 * LEAST_WIDTH, LEAST_WIDTH, LEAST_WIDTH):
        # narrower windows about the smooth edge contain less noise
        half = min(max(least * radius, WIDTH * slope.blur_px), 0.9 * radius)
        middle = shrink(profile)
        profile = edge_profile(flat, row, column, 1.0, middle - half, middle + half)
    smooth = shrink(profile)
    slope = _Slope.of(flat, row, column, smooth)
    step = 2 * half / max(16, math.ceil(4 * half))
    away = np.arange(-half / 2, half / 2 + step / 2, step)
    rings = _Rings(away, np.full(away.size, step), WIDTH * slope.blur_px + half / 2)
    sigma = _errors(flat, (row, column), profile, radius, slope.blur_px, rings)
    damping = slope.transform(np.arange(HIGHEST + 1) / radius)
    return Edge(
        row,
        column,
        radius,
        harmonics(profile),
        sigma,
        damping,
        slope.blur_px,
        level,
        patch.noise,
        flat,
        shade / level,
        ripple,
        smooth,
        half,
        vignetting,
        blocked,
    )


def matched_edge(edge: Edge, outline: Values) -> Edge:
    """Return the edge measured again: the least-squares shift of the blurred ``outline`` (over `ANGLES`) on each ray.

    This has little more than half the noise power of the sum of all light along a ray. It is valid if the outline is
    correct to within about one blur.
    """
    from scipy import ndimage, special

    slope = _Slope.of(edge.flat, edge.row, edge.column, outline)
    blur = slope.blur_px
    away = np.arange(-WIDTH * blur, WIDTH * blur + 0.25, 0.5)
    weight = np.exp(-0.5 * (away / blur) ** 2)
    fall = weight / (math.sqrt(2 * math.pi) * blur)
    weight /= float(weight @ fall)
    line = outline + away[:, None]
    places = [edge.row + line * np.sin(ANGLES), edge.column + line * np.cos(ANGLES)]
    light = ndimage.map_coordinates(edge.flat, places, order=1, mode="nearest")
    profile = outline + weight @ (light - special.ndtr(-away / blur)[:, None])
    inner = away <= 0
    rings = _Rings(away[inner], weight[inner], WIDTH * blur)
    sigma = _errors(edge.flat, (edge.row, edge.column), profile, edge.radius, blur, rings)
    damping = slope.transform(np.arange(HIGHEST + 1) / edge.radius)
    return replace(edge, harmonics=harmonics(profile), sigma=sigma, damping=damping, blur_px=blur)


@dataclass(frozen=True, slots=True)
class _Slope:
    """The fall of light across the edge, averaged over the whole edge: distance outwards, slope, and blur (pixels)."""

    distance: Values
    slope: Values
    blur_px: float

    @staticmethod
    def of(flat: Values, row: float, column: float, smooth: Values) -> _Slope:
        """Return the slope about a smooth outline that is given over `ANGLES`."""
        from scipy import ndimage, optimize, special

        x, y = offsets(flat.shape, row, column)
        ray = np.arctan2(y, x) % (2 * math.pi)
        outside = np.hypot(x, y) - np.interp(ray, ANGLES, smooth, period=2 * math.pi)
        reach, step = 0.7 * float(smooth.mean()), 0.5
        edges = np.arange(-reach, reach + step, step)
        count = np.histogram(outside, edges)[0]
        light = np.histogram(outside, edges, weights=flat)[0]
        some = count > 0
        distance, count, level = (edges[:-1] + step / 2)[some], count[some], light[some] / count[some]
        weight = np.sqrt(count)

        def left(p: Values) -> Values:
            lit: Values = (p[0] * special.ndtr((p[1] - distance) / p[2]) - level) * weight
            return lit

        start = [1.0, 0.0, 0.03 * reach + 1.0]
        found = optimize.least_squares(left, start, bounds=([0.3, -reach, 0.3], [3.0, reach, reach])).x
        blur = float(found[2])
        near = np.abs(distance - found[1]) < 3.2 * blur + 1.5
        # the slope between neighbouring bins is dominated by noise: smooth it over half a pixel
        falling = -np.gradient(ndimage.gaussian_filter1d(level, 1.0), distance)[near]
        return _Slope(distance[near], falling, blur)

    def transform(self, rate: Values) -> Values:
        """Return the transform of the slope at angular frequencies (rad/pixel), 1 at 0."""
        weight = self.slope / float(self.slope.sum())
        away = self.distance - float(weight @ self.distance)
        spectrum: Values = np.cos(rate[:, None] * away) @ weight
        return spectrum


@dataclass(frozen=True, slots=True)
class _Rings:
    """The lit half of the sum along a ray: distances, their weights, and distance of the first ring from the edge."""

    away: Values
    weight: Values
    first: float


def _errors(
    flat: Values, centre: tuple[float, float], profile: Values, radius: float, blur: float, rings: _Rings
) -> Values:
    """Return the standard errors of real and imaginary part of each harmonic of the edge (pixels).

    White noise appears in the harmonics beyond those of any iris. Structure of the lit patch is mainly ripple that is
    not a plane wave. It appears on rings inside the edge, where the same sums along rays should vanish. The power along
    a ring of radius r belongs to the angular frequency k/r, and to the edge's harmonic of that frequency.
    """
    from scipy import ndimage

    rate = np.arange(HIGHEST + 1) / radius
    power = np.abs(np.fft.rfft(profile) / RAYS) ** 2
    # the power of complex Gaussian noise is exponentially distributed: its median is ln 2 times its mean
    white = float(np.median(power[QUIET])) / math.log(2)
    at, found = [], []
    for r in np.arange(radius - rings.first - 0.5, 0.35 * radius, -float(np.ptp(rings.away)) - 0.5):
        line = r + rings.away[:, None]
        places = [centre[0] + line * np.sin(ANGLES), centre[1] + line * np.cos(ANGLES)]
        light = ndimage.map_coordinates(flat, places, order=1, mode="nearest")
        shift = rings.weight @ ((light - 1) * line / r)
        ring = np.abs(np.fft.rfft(shift) / RAYS) ** 2
        k = np.arange(2, 120)
        at.append(k / r)
        # a longer ring averages over more of the structure
        found.append(ring[k] * r / radius)
    variance = np.full(rate.size, white)
    if at:
        near = np.exp(-0.5 * ((rate[:, None] - np.concatenate(at)) * radius) ** 2)
        inner = near @ np.concatenate(found) / np.maximum(near.sum(1), 1e-9)
        # half the white noise comes from the dark side of the edge
        variance = white / 2 + np.maximum(white / 2, inner)
    model = max(MODEL * radius, FOURTH * blur**4 / radius**3)
    return np.sqrt(variance / 2 + model**2)
