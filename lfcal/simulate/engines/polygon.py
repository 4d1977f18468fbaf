"""The iris as a polygon: its outline, its clipping, and its exact Fourier transform."""

from __future__ import annotations

import itertools
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import j1

from lfcal.compiled import njit
from lfcal.simulate.engines.quadrature import gauss_legendre
from lfcal.simulate.scene import Iris
from lfcal.threads import for_each_chunk

__all__ = ["area", "clip", "disc_transform", "half_planes", "iris_outline", "regular", "spectrum", "transform"]

Points = NDArray[np.float64]
_STABLE_BELOW = 1.0  # |f| D under which the edge form loses digits
_NODES = 16  # along each side of a triangle: exact to rounding while |f| D < 1


def area(outline: Points) -> float:
    """Return the signed area of a polygon ``(n, 2)``: positive where x turns towards y."""
    x, y = outline.T
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
    # the blade's radius over the apothem of the finished opening: solved for the chord's own geometry
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
    lo, hi = chord / 2, 1e12  # a radius spans many orders of magnitude: bisected on its logarithm
    for _ in range(200):
        r = math.sqrt(lo * hi)
        apothem = 1.0 + r - math.sqrt(max(0.0, r * r - chord * chord / 4))
        lo, hi = (r, hi) if apothem / r > curvature else (lo, r)
    return math.sqrt(lo * hi)


def iris_outline(iris: Iris, sagitta: float = 2e-4) -> Points:
    """Return the pupil ``(n, 2)`` as (x, y) in units of the radius of the disc f/(2N), counter-clockwise in (x, y).

    The iris has that disc's area, pi; a second stop takes light away. Arcs are drawn as chords no farther
    than ``sagitta`` from them, at equal area. The outline is empty where the stop covers everything.
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
    """Return the part of a convex polygon inside another (Sutherland-Hodgman); ``(0, 2)`` where they are apart."""
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

    Away from f = 0 by the divergence theorem over the edges; near it, where that form cancels, by
    Gauss-Legendre over the triangles of a fan. Error 2e-16 of the area at any frequency.
    """
    x, y = np.broadcast_arrays(np.asarray(fx, np.float64), np.asarray(fy, np.float64))
    near = np.hypot(x, y) * _diameter(outline) < _STABLE_BELOW
    result = np.empty(x.shape, np.complex128)
    result[~near] = _by_edges(outline, x[~near], y[~near])
    result[near] = _by_triangles(outline, x[near], y[near])
    return result


def spectrum(
    outline: Points, fx: NDArray[np.float64], fy: NDArray[np.float64], workers: int | None = 1
) -> NDArray[np.complex128]:
    """Return `transform` on the grid ``fy`` x ``fx``: shape ``(len(fy), len(fx))``."""
    re, im = np.empty((fy.size, fx.size)), np.empty((fy.size, fx.size))
    closed = np.ascontiguousarray(np.concatenate([outline, outline[:1]]))
    for_each_chunk(lambda a, b: _edge_rows(closed, fx, fy[a:b], re[a:b], im[a:b]), fy.size, workers)
    result = np.empty(re.shape, np.complex128)  # of a large grid no sum is made beside it
    result.real, result.imag = re, im
    radius = _STABLE_BELOW / _diameter(outline)
    rows, columns = np.nonzero(np.abs(fy) < radius)[0], np.nonzero(np.abs(fx) < radius)[0]
    if rows.size and columns.size:
        result[np.ix_(rows, columns)] = transform(outline, fx[columns][None, :], fy[rows][:, None])
    return result


def _diameter(outline: Points) -> float:
    return float(np.hypot(*np.ptp(outline, 0)))


def _by_edges(outline: Points, fx: NDArray[np.float64], fy: NDArray[np.float64]) -> NDArray[np.complex128]:
    total = np.zeros(fx.shape, np.complex128)
    for p, q in zip(outline, np.roll(outline, -1, 0), strict=True):
        e, m = q - p, (p + q) / 2
        total += (
            (fx * e[1] - fy * e[0]) * np.sinc(fx * e[0] + fy * e[1]) * np.exp(-2j * np.pi * (fx * m[0] + fy * m[1]))
        )
    value: NDArray[np.complex128] = 1j * total / (2 * np.pi * (fx**2 + fy**2))
    return value


def _by_triangles(outline: Points, fx: NDArray[np.float64], fy: NDArray[np.float64]) -> NDArray[np.complex128]:
    t, w = gauss_legendre(_NODES, 0.0, 1.0)
    u, v = np.meshgrid(t, t, indexing="ij")
    weight = np.outer(w * t, w)
    centre = outline.mean(0)
    # a square mapped onto a triangle at the centre (Duffy): its area element grows with u
    total = np.full(fx.shape, area(outline), np.complex128)  # the integral of 1; what follows is exp - 1
    for p, q in zip(outline - centre, np.roll(outline, -1, 0) - centre, strict=True):
        x, y = (centre[i] + u * (p[i] * (1 - v) + q[i] * v) for i in (0, 1))
        # exp(-2 i h) - 1 = -2 sin h (sin h + i cos h): no cancellation at small h
        half = np.pi * (np.multiply.outer(fx, x) + np.multiply.outer(fy, y))
        rest = -2 * np.sin(half) * (np.sin(half) + 1j * np.cos(half))
        total += (p[0] * q[1] - p[1] * q[0]) * (rest * weight).sum((-2, -1))
    return total


@njit(fastmath={"contract", "nnan", "ninf", "nsz"})
def _edge_rows(
    closed: Points,
    fx: NDArray[np.float64],
    fy: NDArray[np.float64],
    re: NDArray[np.float64],
    im: NDArray[np.float64],
) -> None:
    """Fill the transform's real and imaginary part ``(len(fy), len(fx))`` by the edges of ``closed`` (n + 1, 2).

    With edge vectors e, their middles m and sinc x = sin(pi x)/(pi x) the divergence theorem gives

        F(f) = i / (2 pi |f|^2) sum_edges (f_x e_y - f_y e_x) sinc(f.e) exp(-2 pi i f.m).

    Sines and phases of f.e = f_x e_x + f_y e_y are made by the addition theorem of those along the axes: none is
    taken per point. f = 0 gets 0; the frequencies about it are computed otherwise (see `spectrum`).
    """
    re[:], im[:] = 0, 0
    for k in range(closed.shape[0] - 1):
        ex, ey = np.pi * (closed[k + 1, 0] - closed[k, 0]), np.pi * (closed[k + 1, 1] - closed[k, 1])
        mx, my = np.pi * (closed[k + 1, 0] + closed[k, 0]), np.pi * (closed[k + 1, 1] + closed[k, 1])
        sx, cx, px, qx = np.sin(ex * fx), np.cos(ex * fx), np.cos(mx * fx), np.sin(mx * fx)
        for r in range(fy.size):
            f = fy[r]
            sy, cy, py, qy = np.sin(ey * f), np.cos(ey * f), np.cos(my * f), np.sin(my * f)
            row_re, row_im = re[r], im[r]
            for c in range(fx.size):
                a = ex * fx[c] + ey * f
                a2 = a * a
                # sin(a)/a by Taylor for |a| < 0.1, where the addition theorem cancels; both are computed, so that
                # the choice is a mask and the loop runs in vectors
                near = 1 - a2 / 6 * (1 - a2 / 20 * (1 - a2 / 42 * (1 - a2 / 72)))
                far = (sx[c] * cy + cx[c] * sy) / (a if a2 > 0.01 else 1.0)
                side = (ey * fx[c] - ex * f) * (far if a2 > 0.01 else near)
                # times i exp(-i (m.f)) / 2 pi^2; the edge came with a factor pi
                row_re[c] += side * (qx[c] * py + px[c] * qy)
                row_im[c] += side * (px[c] * py - qx[c] * qy)
    for r in range(fy.size):
        for c in range(fx.size):
            k2 = 2 * np.pi**2 * (fx[c] * fx[c] + fy[r] * fy[r])
            re[r, c] = re[r, c] / k2 if k2 > 0 else 0.0
            im[r, c] = im[r, c] / k2 if k2 > 0 else 0.0
