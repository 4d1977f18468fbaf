"""Least squares of a blurred iris on the pixels around its edge."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.compiled import njit
from lfcal.psf.aperture.locate import LitPatch, offsets
from lfcal.psf.aperture.profile import RAYS
from lfcal.psf.aperture.select import Candidate

__all__ = ["EdgePixels", "IrisFit", "Model", "accumulate", "matched_profile", "refine"]

X, Y, APOTHEM, ROTATION, CURVATURE, BLUR, LEVEL, TILT_X, TILT_Y, DOME, STRETCH, SHEAR = range(12)
"""Parameters: centre column and row; iris; lit level with its tilt and dome; stretch along axes and diagonals."""

ROBUST = 2.5
"""Residuals beyond so many deviations count by size, not by square (soft L1)."""

FAR = 5.0
"""Blurs from the edge beyond which a pixel knows nothing of it."""

ZONE = (-0.25, 0.15)
"""The pixels that are fitted: from inside to outside the edge of the profile (radii)."""

MOST_PIXELS = 40_000

ENOUGH = 0.01
"""An iteration that lowers the chi-square by less is the last."""


@dataclass(frozen=True, slots=True)
class IrisFit:
    """A fitted iris: ``parameters`` in the order of the module's names, robust ``chi2`` and its ``pixels``."""

    blades: int
    parameters: NDArray[np.float64]
    chi2: float
    pixels: int

    @property
    def reduced(self) -> float:
        """Chi-square per degree of freedom."""
        return self.chi2 / max(1, self.pixels - 12)


class Model(NamedTuple):
    """What is fitted to which pixels, about the patch's centre."""

    x: NDArray[np.float64]  # (pixels,) column from the centre
    y: NDArray[np.float64]  # (pixels,) row from the centre
    value: NDArray[np.float64]  # (pixels,) above the background
    sigma: float  # noise of a value
    blades: int
    span: float  # pixels per unit of the shading's coordinates


class _Arc(NamedTuple):
    """The blade nearest to a pixel; letters as in `accumulate`."""

    d: float  # distance of its edge, positive inside (pixels)
    px: float  # the pixel in the frame of the unstretched iris (pixels)
    py: float
    r: float  # its distance from the centre
    c: float  # cosine and sine of its angle from the middle of the blade
    s: float
    top: float  # 2 - k - 2 m q cos - k q²
    inner: float  # S


@njit()
def _nearest_arc(p: NDArray[np.float64], blades: int, dx: float, dy: float) -> _Arc:
    """Return the blade nearest to a pixel (dx, dy) from the centre."""
    a, k, step = p[APOTHEM], p[CURVATURE], 2 * math.pi / blades
    m = 1.0 - k
    # a symmetric stretch of determinant about 1: without it an ellipse would pass for curved blades
    px = dx * (1 + p[STRETCH]) + dy * p[SHEAR]
    py = dx * p[SHEAR] + dy * (1 - p[STRETCH])
    r = max(math.hypot(px, py), 1e-9)  # the direction is divided by it
    turn = (math.atan2(py, px) - p[ROTATION]) % step - step / 2
    c, s = math.cos(turn), math.sin(turn)
    q = r / a
    inner = math.sqrt(m * m + 2 * k * m * q * c + k * k * q * q)
    top = 2 - k - 2 * m * q * c - k * q * q
    return _Arc(a * top / (1 + inner), px, py, r, c, s, top, inner)


@njit()
def _edge_slopes(row: NDArray[np.float64], p: NDArray[np.float64], arc: _Arc, dx: float, dy: float, g: float) -> None:
    """Fill the model's derivatives by the parameters that move or blur the edge; ``g`` is that by d."""
    a, k = p[APOTHEM], p[CURVATURE]
    m, q, c = 1.0 - k, arc.r / a, arc.c
    px, py, inner = arc.px, arc.py, arc.inner
    # outward normal of the arc at the pixel: (k P/a + m w) / S, w towards the middle of the blade
    nx = (k * px / a + m * (px * c + py * arc.s) / arc.r) / inner
    ny = (k * py / a + m * (py * c - px * arc.s) / arc.r) / inner
    ds = (-m + (1 - 2 * k) * q * c + k * q * q) / inner  # dS/dk
    row[X] = g * (nx * (1 + p[STRETCH]) + ny * p[SHEAR])
    row[Y] = g * (nx * p[SHEAR] + ny * (1 - p[STRETCH]))
    row[APOTHEM] = g * (arc.d + nx * px + ny * py) / a
    row[ROTATION] = g * (ny * px - nx * py)
    row[CURVATURE] = g * a * ((-1 + 2 * q * c - q * q) / (1 + inner) - arc.top * ds / (1 + inner) ** 2)
    row[BLUR] = -g * arc.d / p[BLUR]
    row[STRETCH] = -g * (nx * dx - ny * dy)
    row[SHEAR] = -g * (nx * dy + ny * dx)


@njit()
def accumulate(
    model: Model, p: NDArray[np.float64], normal: NDArray[np.float64], gradient: NDArray[np.float64]
) -> float:
    """Add up the normal equations of all pixels at parameters ``p`` (12,); return the robust chi-square.

    The model is ``level * 0.5 * (1 + erf(d / (blur * sqrt 2)))`` with d the exact distance from the nearest
    blade's arc: ``d = a (2 - k - 2 m q cos - k q²) / (1 + S)``, S² = m² + 2 k m q cos + k² q², m = 1 - k,
    q = r / a, which holds for straight blades (k = 0) too. All derivatives are closed forms. ``normal`` (12, 12) and
    ``gradient`` (12,) are overwritten with sum w J J^T and sum w J residual, w the weight of the soft L1 loss.
    """
    x, y, value, sigma, span = model.x, model.y, model.value, model.sigma, model.span
    normal[:] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    row = np.empty(12)
    for i in range(x.size):
        dx, dy = x[i] - p[X], y[i] - p[Y]
        arc = _nearest_arc(p, model.blades, dx, dy)
        u = arc.d / p[BLUR]
        gx, gy = x[i] / span, y[i] / span
        shade = 1 + p[TILT_X] * gx + p[TILT_Y] * gy + p[DOME] * (gx * gx + gy * gy)
        lit = p[LEVEL] * shade
        edge = 1.0 if u > 0 else 0.0
        if abs(u) < FAR:
            edge = 0.5 * (1 + math.erf(u * 0.7071067811865476))
            # lit times the slope of the edge: the Gaussian of the blur, 1/sqrt(2 pi) high
            _edge_slopes(row, p, arc, dx, dy, lit * math.exp(-0.5 * u * u) * 0.3989422804014327 / p[BLUR])
        elif edge == 0.0:  # far outside: dark for any parameters
            row[:] = 0.0
        else:  # far inside: only level and shading matter
            row[:LEVEL] = 0.0
            row[STRETCH:] = 0.0
        row[LEVEL] = edge * shade
        row[TILT_X] = p[LEVEL] * edge * gx
        row[TILT_Y] = p[LEVEL] * edge * gy
        row[DOME] = p[LEVEL] * edge * (gx * gx + gy * gy)
        residual = (value[i] - lit * edge) / sigma
        # loss 2 R² (sqrt(1 + (residual/R)²) - 1), the normal equations of iteratively re-weighted least squares
        root = math.sqrt(1 + (residual / ROBUST) ** 2)
        cost += 2 * residual * residual / (root + 1)  # 2 R² (root - 1) without its cancellation
        weight = 1 / (root * sigma * sigma)
        for j in range(12):
            wj = weight * row[j]
            gradient[j] += wj * residual * sigma
            for n in range(j + 1):
                normal[j, n] += wj * row[n]
    for j in range(12):
        for n in range(j):
            normal[n, j] = normal[j, n]
    return cost


@dataclass(frozen=True, slots=True)
class EdgePixels:
    """The pixels around an edge, about the patch's centre.

    Attributes
    ----------
    x, y
        Column and row from the centre (pixels).
    value
        Value above the background.
    sigma
        Noise of a value.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    value: NDArray[np.float64]
    sigma: float

    @staticmethod
    def around(image: NDArray[np.float64], patch: LitPatch, edge: NDArray[np.float64]) -> EdgePixels:
        """Return the pixels within `ZONE` of the smooth ``edge``, given over `ANGLES` (pixels)."""
        x, y = offsets(image.shape, patch.row, patch.column)
        ray = np.rint(np.arctan2(y, x) * (RAYS / (2 * math.pi))).astype(int) % RAYS
        outside = (np.hypot(x, y) - edge[ray]) / patch.radius
        zone = (outside > ZONE[0]) & (outside < ZONE[1])
        every = max(1, int(zone.sum()) // MOST_PIXELS)
        sigma = max(patch.noise, 1e-3 * patch.level)
        return EdgePixels(x[zone][::every], y[zone][::every], image[zone][::every] - patch.background, sigma)


def refine(pixels: EdgePixels, patch: LitPatch, candidate: Candidate, *, steps: int = 30) -> IrisFit:
    """Fit a blurred iris, or with ``candidate.blades`` 0 a blurred circle, to the pixels around the edge.

    Levenberg-Marquardt with soft-L1 weights; parameters are kept within bounds.

    Parameters
    ----------
    pixels
        See `EdgePixels.around`.
    patch
        Where it is lit, and how brightly in the middle.
    candidate
        Start.
    steps
        Most iterations.
    """
    p, low, high = _start(patch, candidate)
    blades = candidate.blades or 4  # a circle has no blades; the arcs of any number make it
    normal, gradient = np.empty((12, 12)), np.empty(12)
    trial_normal, trial_gradient = np.empty((12, 12)), np.empty(12)
    model = Model(pixels.x, pixels.y, pixels.value, pixels.sigma, blades, patch.radius)
    cost = accumulate(model, p, normal, gradient)
    damping = 1e-3
    for _ in range(steps):
        diagonal = np.diag(normal) + 1e-12 * np.trace(normal)
        step = np.linalg.solve(normal + damping * np.diag(diagonal), gradient)
        trial = np.clip(p + step, low, high)
        new = accumulate(model, trial, trial_normal, trial_gradient)
        if new < cost:
            done = cost - new < ENOUGH
            p, cost = trial, new
            normal, trial_normal = trial_normal, normal
            gradient, trial_gradient = trial_gradient, gradient
            damping = max(1e-7, damping / 5)
            if done:
                break
        else:
            damping *= 8
            if damping > 1e6:
                break
    p = p.copy()
    p[X] += patch.column
    p[Y] += patch.row
    return IrisFit(candidate.blades, p, cost, pixels.x.size)


def matched_profile(pixels: EdgePixels, patch: LitPatch, circle: IrisFit) -> NDArray[np.float64]:
    """Return the edge radius over `ANGLES` from what a fitted circle leaves over (pixels).

    Along each ray the residuals are weighted with the slope of the blurred edge, which is the least-squares
    shift of that piece of edge: less noise than summing all light of a ray, where blades are all but round.
    """
    from scipy import special

    p = circle.parameters
    dx, dy = pixels.x - (p[X] - patch.column), pixels.y - (p[Y] - patch.row)
    x = dx * (1 + p[STRETCH]) + dy * p[SHEAR]
    y = dx * p[SHEAR] + dy * (1 - p[STRETCH])
    u = (p[APOTHEM] - np.hypot(x, y)) / p[BLUR]
    gx, gy = pixels.x / patch.radius, pixels.y / patch.radius
    lit = p[LEVEL] * (1 + p[TILT_X] * gx + p[TILT_Y] * gy + p[DOME] * (gx * gx + gy * gy))
    slope = lit * np.exp(-0.5 * u * u) * (0.3989422804014327 / p[BLUR])
    left = pixels.value - lit * special.ndtr(u)
    ray = np.rint(np.arctan2(y, x) * (RAYS / (2 * math.pi))).astype(int) % RAYS
    shift = np.bincount(ray, left * slope, RAYS) / max(float((slope * slope).sum()) / RAYS, 1e-300)
    edge: NDArray[np.float64] = np.maximum(p[APOTHEM] + shift, 0.3 * patch.radius)
    return edge


def _start(
    patch: LitPatch, candidate: Candidate
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Return the start and the lowest and highest parameters."""
    radius, level = patch.radius, patch.level
    if candidate.blades:
        apothem, turn, half = candidate.apothem_px, candidate.rotation_rad, math.pi / candidate.blades
        curvature = (min(max(candidate.curvature, 0.03), 0.9), 0.0, 0.97)
    else:
        apothem, turn, half, curvature = radius, 0.0, 0.0, (1.0, 1.0, 1.0)
    p = np.array([0, 0, apothem, turn, curvature[0], 0.02 * radius + 0.5, level, 0, 0, 0, 0, 0])
    low = np.array(
        [
            -0.2 * radius,
            -0.2 * radius,
            0.6 * radius,
            turn - half,
            curvature[1],
            0.3,
            0.3 * level,
            -0.6,
            -0.6,
            -0.6,
            -0.12,
            -0.12,
        ]
    )
    high = np.array(
        [
            0.2 * radius,
            0.2 * radius,
            1.3 * radius,
            turn + half,
            curvature[2],
            0.3 * radius + 1.0,
            3 * level,
            0.6,
            0.6,
            0.6,
            0.12,
            0.12,
        ]
    )
    return p, low, high
