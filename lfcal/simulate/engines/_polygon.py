"""The iris as a polygon: its outline, its clipping, and its exact Fourier transform."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import j1

from lfcal.base import for_each_chunk, njit
from lfcal.simulate.scene import PupilIris

__all__ = ["area", "clip", "disc_transform", "half_planes", "iris_outline", "regular", "spectrum", "transform"]

Points = NDArray[np.float64]

EDGE_S = 2.5e-8
"""Additional processor time (s) per edge and frequency of `_edge_sums`, instead of `_edge_rows`."""

_SAME_AS_ZERO = 1e-140
"""Frequency below which the square underflows; there, the transform equals the area."""


def area(outline: Points) -> float:
    """Return the signed area of a polygon ``(n, 2)``: positive where x turns towards y."""
    x, y = (outline - outline[:1]).T  # relative to the first vertex, to avoid cancellation far from the origin
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def regular(n: int, rotation_rad: float = 0.0) -> Points:
    """Return the regular n-gon ``(n, 2)`` of area pi about the origin, first vertex at ``rotation_rad``."""
    radius = math.sqrt(2 * math.pi / (n * math.sin(2 * math.pi / n)))
    t = rotation_rad + 2 * math.pi * np.arange(n) / n
    return radius * np.stack([np.cos(t), np.sin(t)], axis=1)


def _curved(blades: int, curvature: float, rotation_rad: float, sagitta: float) -> Points:
    """Return the outline of circular-arc blades of radius apothem / curvature, scaled to area pi."""
    corner = math.pi / blades
    rim = 1.0 / math.cos(corner)  # apothem of the chords is 1 until the scale is set
    chord = 2 * math.sin(corner) * rim
    # ratio of the blade's radius to the apothem of the finished opening, solved for the geometry of the chord
    radius = _blade_radius(chord, curvature)
    half = math.asin(min(1.0, chord / (2 * radius)))
    pieces = max(1, math.ceil(half / math.acos(1 - sagitta / radius)))
    t = half * (2 * np.arange(pieces) / pieces - 1)
    middle = 1.0 - radius * math.cos(half)
    arc = np.stack([middle + radius * np.cos(t), radius * np.sin(t)], axis=1)
    turns = rotation_rad + corner * (2 * np.arange(blades) + 1)
    outline = np.concatenate([arc @ np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in turns])
    scaled: Points = outline * math.sqrt(math.pi / area(outline))
    return scaled


def _blade_radius(chord: float, curvature: float) -> float:
    """Return r with (1 + sagitta(r)) / r = curvature: the opening's apothem, arc included, over the blade's radius."""
    lo, hi = chord / 2, 1e12  # bisection on a logarithmic scale, because a radius spans many orders of magnitude
    for _ in range(200):
        r = math.sqrt(lo * hi)
        apothem = 1.0 + r - math.sqrt(max(0.0, r * r - chord * chord / 4))
        lo, hi = (r, hi) if apothem / r > curvature else (lo, r)
    return math.sqrt(lo * hi)


def iris_outline(iris: PupilIris, sagitta: float = 2e-4) -> Points:
    """Return the pupil ``(n, 2)`` as (x, y) in units of the radius of the disc f/(2N), counter-clockwise in (x, y).

    The iris has the area of that disc, pi; a second stop removes light. Arcs are drawn as chords with a distance of
    at most ``sagitta``, at equal area. The outline is empty if the stop covers everything.
    """
    n = max(16, 8 * math.ceil(math.pi / math.acos(1 - sagitta) / 8))
    if iris.blades == 0 or iris.curvature == 1:
        outline = regular(n, iris.rotation_rad)
    elif iris.curvature == 0:
        outline = regular(iris.blades, iris.rotation_rad)
    else:
        outline = _curved(iris.blades, iris.curvature, iris.rotation_rad, sagitta)
    if iris.stop is not None:
        x, y, radius = iris.stop
        outline = clip(outline, regular(n) * radius + np.array([x, y]))
    return outline


def half_planes(outline: Points) -> tuple[Points, NDArray[np.float64]]:
    """Return unit normals ``(n, 2)`` and offsets ``(n,)`` of a convex polygon: inside is normal . p <= offset."""
    edge = np.roll(outline, -1, 0) - outline
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.hypot(edge[:, 0], edge[:, 1])[:, None]
    return normal, (normal * outline).sum(1)


def clip(subject: Points, window: Points) -> Points:
    """Return the part of a convex polygon inside another (Sutherland-Hodgman); ``(0, 2)`` if they do not overlap."""
    points = [(float(x), float(y)) for x, y in subject]
    for (nx, ny), d in zip(*half_planes(window), strict=True):
        kept: list[tuple[float, float]] = []
        for p, q in itertools.pairwise([*points, *points[:1]]):
            sp, sq = nx * p[0] + ny * p[1] - d, nx * q[0] + ny * q[1] - d
            if sp <= 0:
                kept.append(p)
            if sp * sq < 0:
                t = sp / (sp - sq)
                kept.append((p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])))
        points = kept
    return np.array(points, np.float64).reshape(-1, 2)


def disc_transform(radius: float, f: ArrayLike) -> NDArray[np.float64]:
    """Return the Fourier transform of a disc's indicator at radial frequency f: R J1(2 pi R f) / f."""
    x = 2 * np.pi * radius * np.abs(np.asarray(f, np.float64))
    small = x < 1e-4
    safe = np.where(small, 1.0, x)
    value: NDArray[np.float64] = math.pi * radius**2 * np.where(small, 1 - x * x / 8, 2 * j1(safe) / safe)
    return value


def transform(outline: Points, fx: ArrayLike, fy: ArrayLike) -> NDArray[np.complex128]:
    """Return the Fourier transform of a polygon's indicator, integral of exp(-2 pi i f.x), at points (fx, fy).

    It is computed by the divergence theorem over the edges, as in `_edge_rows`. The error is 2e-16 of the area.
    """
    x, y = np.broadcast_arrays(np.asarray(fx, np.float64), np.asarray(fy, np.float64))
    centre = outline.mean(0)
    total = np.zeros(x.shape, np.complex128)
    for p, q in zip(outline - centre, np.roll(outline, -1, 0) - centre, strict=True):
        (ex, ey), (mx, my) = q - p, (p + q) / 2
        a, b = np.pi * (x * ex + y * ey), np.pi * (x * mx + y * my)
        turned = -2 * np.sin(b) * (np.sin(b) + 1j * np.cos(b))  # exp(-2 i b) - 1 without cancellation
        total += (x * ey - y * ex) * (_sinc_less_one(a) * (1 + turned) + turned)
    f2 = x**2 + y**2
    zero = f2 < _SAME_AS_ZERO**2
    value = 1j * total / (2 * np.pi * np.where(zero, 1.0, f2))
    found: NDArray[np.complex128] = np.where(zero, area(outline), value)
    found *= np.exp(-2j * np.pi * (x * centre[0] + y * centre[1]))
    return found


def spectrum(
    outline: Points, fx: NDArray[np.float64], fy: NDArray[np.float64], workers: int | None = 1
) -> NDArray[np.complex128]:
    """Return `transform` on the grid ``fy`` x ``fx``: shape ``(len(fy), len(fx))``.

    Rows with opposite frequencies are complex conjugates: for the grid of a discrete Fourier transform, only half the
    rows are computed.
    """
    centre = outline.mean(0)
    closed = np.concatenate([outline, outline[:1]]) - centre
    result = np.empty((fy.size, fx.size), np.complex128)

    def fill(rows: slice, columns: NDArray[np.intp] | slice) -> None:
        f, g = fx[columns], fy[rows]
        if _edge_rows.spared(EDGE_S * len(outline) * f.size * g.size):
            result[rows, columns] = _edge_sums(closed, f, g[:, None])
            return
        re, im = np.zeros((2, g.size, f.size))
        for_each_chunk(
            lambda a, b: _edge_rows(closed, f, g[a:b], re[a:b], im[a:b], np.empty((4, f.size))), g.size, workers
        )
        result.real[rows, columns], result.imag[rows, columns] = re, im  # avoids a temporary sum for a large grid

    opposite = -np.arange(fx.size)  # index of -f, counted from the first sample, or from the end
    alone = np.flatnonzero(fx[opposite] != -fx)
    half = fy.size // 2 + 1
    if fy is fx and alone.size <= 1 and fy.size > 2:
        fill(slice(half), slice(None))
        above = result[fy.size - half : 0 : -1]
        np.conj(above[:, 0], out=result[half:, 0])
        np.conj(above[:, :0:-1], out=result[half:, 1:])
        fill(slice(half, None), alone)
    else:
        fill(slice(None), slice(None))
    rows, columns = (np.nonzero(np.abs(f) < _SAME_AS_ZERO)[0] for f in (fy, fx))
    result[np.ix_(rows, columns)] = area(outline)
    if (np.abs(centre) > 1e-15 * _diameter(outline)).any():
        result *= np.exp(-2j * np.pi * centre[0] * fx)
        result *= np.exp(-2j * np.pi * centre[1] * fy)[:, None]
    return result


def _edge_sums(closed: Points, fx: NDArray[np.float64], fy: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Compute the values of `_edge_rows`, for ``fx`` (n,) and ``fy`` (m, 1), with numpy and the same equations."""
    total = np.zeros((len(fy), fx.size), np.complex128)
    for p, q in itertools.pairwise(np.pi * closed):
        (ex, ey), (mx, my) = q - p, q + p
        a = ex * fx + ey * fy
        near = np.abs(a) < 0.1
        flat = np.sin(ex * fx) * np.cos(ey * fy) + np.cos(ex * fx) * np.sin(ey * fy)
        flat = flat / np.where(near, 1.0, a) - 1
        flat[near] = _sinc_less_one(a[near])
        along, down = np.expm1(-1j * mx * fx), np.expm1(-1j * my * fy)
        turned = along + down + along * down
        total += (ey * fx - ex * fy) * (turned * (1 + flat) + flat)
    k2 = 2 * np.pi**2 * (fx * fx + fy * fy)
    return 1j * total / np.where(k2 > 0, k2, np.inf)


def _diameter(outline: Points) -> float:
    return float(np.hypot(*np.ptp(outline, 0)))


def _sinc_less_one(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return sin(a)/a - 1, by a Taylor series where the difference would cancel."""
    a2 = a * a
    near = -a2 / 6 * (1 - a2 / 20 * (1 - a2 / 42 * (1 - a2 / 72)))
    value: NDArray[np.float64] = np.where(a2 > 0.01, np.sin(a) / np.where(a2 > 0.01, a, 1.0) - 1, near)
    return value


@njit(fastmath={"contract", "nnan", "ninf", "nsz"}, _nrt=False)
def _edge_rows(
    closed: Points,
    fx: NDArray[np.float64],
    fy: NDArray[np.float64],
    re: NDArray[np.float64],
    im: NDArray[np.float64],
    along: NDArray[np.float64],
) -> None:
    """Add the transform's real and imaginary part ``(len(fy), len(fx))`` by the edges of ``closed`` (n + 1, 2).

    With edge vectors e, their middles m and sinc x = sin(pi x)/(pi x) the divergence theorem gives

        F(f) = i / (2 pi |f|^2) sum_edges (f_x e_y - f_y e_x) (sinc(f.e) exp(-2 pi i f.m) - 1),

    where the 1, which cancels in the sum because edges form a closed polygon, keeps the terms as small as the result
    as f goes to 0. Sines and phases of f.e = f_x e_x + f_y e_y come from those along the axes by the addition theorem.
    None is computed per point. The frequency f = 0 gets 0. ``along`` ``(4, len(fx))`` is scratch memory.
    """
    sx, cx, px, qx = along[0], along[1], along[2], along[3]
    for k in range(closed.shape[0] - 1):
        ex, ey = np.pi * (closed[k + 1, 0] - closed[k, 0]), np.pi * (closed[k + 1, 1] - closed[k, 1])
        mx, my = np.pi * (closed[k + 1, 0] + closed[k, 0]), np.pi * (closed[k + 1, 1] + closed[k, 1])
        # cosines minus 1, which would cancel near f = 0
        for c in range(fx.size):  # expressions of whole arrays would take longer to compile
            sx[c], cx[c] = np.sin(ex * fx[c]), np.cos(ex * fx[c])
            px[c], qx[c] = -2 * np.sin(mx * fx[c] / 2) ** 2, np.sin(mx * fx[c])
        for r in range(fy.size):
            f = fy[r]
            sy, cy, py, qy = np.sin(ey * f), np.cos(ey * f), -2 * np.sin(my * f / 2) ** 2, np.sin(my * f)
            row_re, row_im = re[r], im[r]
            for c in range(fx.size):
                a = ex * fx[c] + ey * f
                a2 = a * a
                # sin(a)/a - 1 by Taylor for |a| < 0.1, where the addition theorem cancels; both are computed, so
                # that the choice is a mask and the loop runs in vectors
                near = -a2 / 6 * (1 - a2 / 20 * (1 - a2 / 42 * (1 - a2 / 72)))
                far = (sx[c] * cy + cx[c] * sy) / (a if a2 > 0.01 else 1.0) - 1
                flat = far if a2 > 0.01 else near
                turned = px[c] + py + px[c] * py - qx[c] * qy
                across = qx[c] * (1 + py) + (1 + px[c]) * qy
                side = ey * fx[c] - ex * f
                # times i exp(-i (m.f)) / 2 pi^2; the edge came with a factor pi
                row_re[c] += side * across * (1 + flat)
                row_im[c] += side * (turned * (1 + flat) + flat)
    for r in range(fy.size):
        for c in range(fx.size):
            k2 = 2 * np.pi**2 * (fx[c] * fx[c] + fy[r] * fy[r])
            re[r, c] = re[r, c] / k2 if k2 > 0 else 0.0
            im[r, c] = im[r, c] / k2 if k2 > 0 else 0.0
