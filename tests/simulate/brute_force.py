"""Light behind a lenslet array by summing Fresnel's integral as it stands, in nothing but numpy.

A thin main lens with a polygonal pupil a distance b before the array sends light to an image a distance a behind it.
With u a point of the pupil in radii of the disc f/(2 Nw), X on the array, X0 where the chief ray meets it, and
1/a' = 1/a + 1/b, the field on the array is

    U(X) = exp(i pi X^2/(lambda b)) integral exp(i pi a' u^2/(4 Nw^2 lambda) - i pi u.(X - X0)/(Nw lambda)) du,

and on the sensor, a distance B behind lenslets of focal length f at c,

    V(s) = 1/(lambda B) integral U(X) exp(i pi X^2/(lambda B) - i pi (X - c)^2/(lambda f) - 2 pi i s.X/(lambda B)) dX.

Every integral is one over rows, and along each row; all by Gauss-Legendre nodes but the pupil's rows, which are Fresnel
integrals. Lengths are those of the camera: nothing is reduced to a telecentric one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np
from scipy.special import fresnel

__all__ = ["Fineness", "brute_force"]


@dataclass(frozen=True)
class Fineness:
    """How finely the integrals are summed.

    Attributes
    ----------
    nodes
        Gauss-Legendre nodes of the pupil and of a lenslet to half a turn of the phase, beside `SPARE`; pi/4 are the
        fewest that hold it.
    pixel
        Nodes a pixel's side.
    reach_um
        Distance from the source up to which lenslets are summed.
    """

    nodes: float = 1.0
    pixel: int = 16
    reach_um: float = 400.0

    def count(self, turns):
        """Return the nodes for a phase of that many turns."""
        return 8 * math.ceil((2 * self.nodes * turns + SPARE) / 8)


SPARE = 12
rule = lru_cache(maxsize=None)(np.polynomial.legendre.leggauss)


def legendre(n, low, high):
    """Return nodes and weights on [low, high]; ends may be arrays (..., 1)."""
    t, w = rule(n)
    half = (high - low) / 2
    return low + half * (t + 1), half * w


def polygon_rows(corners, count):
    """Return y, weight, left and right end of rows across a convex polygon, ``count`` of what a strip's phase spans.

    Between two corners the ends of the rows are straight, and may run far in a low strip: strips are summed one by one.
    """
    levels = np.unique(np.round(corners[:, 1], 12))
    closed = np.concatenate([corners, corners[:1]])
    rows = []
    for low, high in pairwise(levels):
        middle = (low + high) / 2
        sides = [(p, q) for p, q in pairwise(closed) if (p[1] - middle) * (q[1] - middle) < 0]
        slopes = [(q[0] - p[0]) / (q[1] - p[1]) for p, q in sides]
        y, w = legendre(count((high - low) * (1 + max(np.abs(slopes)))), low, high)
        ends = [p[0] + slope * (y - p[1]) for (p, _), slope in zip(sides, slopes, strict=True)]
        left, right = sorted(ends, key=np.sum)
        rows.append(np.stack([y, w, left, right]))
    return np.concatenate(rows, axis=1)


def disc_rows(radius, n):
    """Return the rows of a disc; in the angle of y = R sin t the ends of the rows are smooth."""
    t, w = legendre(n, -math.pi / 2, math.pi / 2)
    half = radius * np.cos(t)
    return np.stack([radius * np.sin(t), w * half, -half, half])


def pupil_corners(iris):
    """Return the corners of a pupil of straight blades, area pi."""
    n = iris.blades
    turn = iris.rotation_rad + 2 * math.pi * np.arange(n) / n
    radius = math.sqrt(2 * math.pi / (n * math.sin(2 * math.pi / n)))
    return radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)


def cell_corners(lattice):
    """Return the corners of a rectangular cell about its lenslet."""
    w, h, t = lattice.pitch_um / 2, (lattice.row_pitch_um or lattice.pitch_um) / 2, lattice.rotation_rad
    corners = np.array([(-w, -h), (w, -h), (w, h), (-w, h)])
    return corners @ np.array([[math.cos(t), math.sin(t)], [-math.sin(t), math.cos(t)]])


def lenslets(lattice, about, reach):
    """Return centres (n, 2) and types of the lenslets within ``reach``: row by row, shifted if hexagonal.

    Of three types each row has all in turn, and the next row begins one further.
    """
    hexagonal, p = lattice.kind == "hexagonal", lattice.pitch_um
    step = lattice.row_pitch_um or (p * math.sqrt(3) / 2 if hexagonal else p)
    c, s = math.cos(lattice.rotation_rad), math.sin(lattice.rotation_rad)
    many = 4 + math.ceil(2 * (reach + math.hypot(*about)) / min(p, step))
    found = []
    for r in range(-many, many + 1):
        for q in range(-many, many + 1):
            x, y = q * p + (r * p / 2 if hexagonal else 0.0), r * step
            place = np.array([c * x - s * y, s * x + c * y]) + np.array(lattice.offset_um)
            if math.hypot(*(place - about)) <= reach:
                found.append((*place, (q - r) % len(lattice.types)))
    table = np.array(found)
    return table[:, :2], table[:, 2].astype(int)


def chord(alpha, beta, left, right):
    """Return the integral of exp(i alpha u^2 + i beta u) from left to right, alpha > 0 or exactly 0."""
    if alpha == 0:
        half, middle = (right - left) / 2, (right + left) / 2
        return 2 * half * np.sinc(beta * half / np.pi) * np.exp(1j * beta * middle)
    if alpha < 0:
        return np.conj(chord(-alpha, -beta, left, right))
    root = math.sqrt(2 * alpha / math.pi)
    shift = beta / (2 * alpha)
    (s1, c1), (s0, c0) = fresnel(root * (right + shift)), fresnel(root * (left + shift))
    return (c1 - c0 + 1j * (s1 - s0)) / root * np.exp(-1j * alpha * shift**2)


def main_field(scene, x, y, fine, waves=None):
    """Return the pupil's integral at (x, y) from the chief ray, ``(len(y), len(x))``; unit energy in all.

    With an aberration ``waves(u, v)`` the pupil's rows are sums over Gauss-Legendre nodes, too.
    """
    inverse = (1 / scene.image_um if scene.image_um else math.inf) + 1 / scene.pupil_um
    bend = math.pi / (4 * scene.f_number**2 * scene.wavelength_um) / inverse
    rate = -math.pi / (scene.f_number * scene.wavelength_um)
    steepest = abs(rate) * max(np.abs(x).max(), np.abs(y).max()) + 3 * abs(bend)
    v, w, left, right = polygon_rows(pupil_corners(scene.iris), lambda span: fine.count(steepest * span / (2 * np.pi)))
    if waves is None:
        along = chord(bend, rate * x[None, :], left[:, None], right[:, None])
    else:
        count = fine.count(steepest * float((right - left).max()) / (2 * np.pi))
        u, wu = legendre(count, left[:, None], right[:, None])
        passed = wu * np.exp(1j * (bend * u**2 + 2 * np.pi * waves(u, v[:, None])))
        along = np.einsum("ru,rux->rx", passed, np.exp(1j * rate * u[..., None] * x))
    down = np.exp(1j * (bend * v**2 + rate * np.outer(y, v))) * w
    return down @ along / (2 * scene.wavelength_um * scene.f_number * math.sqrt(math.pi))


def interpolation(nodes, at):
    """Return the matrix from values at Chebyshev ``nodes`` in [-1, 1] to values ``at`` (barycentric)."""
    n = nodes.size
    weights = (-1.0) ** np.arange(n) * np.sin((2 * np.arange(n) + 1) * np.pi / (2 * n))
    terms = weights / (at[..., None] - nodes)
    return terms / terms.sum(-1, keepdims=True)


def aperture_nodes(scene, fine, farthest_um):
    """Return y, its weights, x (rows, nodes) and its weights, of a lenslet seen from up to ``farthest_um`` away."""
    lattice, lam = scene.lattice, scene.wavelength_um
    corners = cell_corners(lattice) if scene.aperture == "cell" else np.full((1, 2), lattice.clear_um / 2)
    radius = float(np.hypot(*corners.T).max())
    bend = max(abs(1 / lattice.gap_um - 1 / kind.focal_length_um) for kind in lattice.types) + 1 / scene.pupil_um
    turns = (farthest_um / lattice.gap_um + radius * bend + 0.6 / scene.f_number) / lam  # per µm
    if scene.aperture == "cell":
        rows = polygon_rows(corners, lambda span: fine.count(turns * span))
    else:
        rows = disc_rows(radius / math.sqrt(2), fine.count(2 * turns * lattice.clear_um))
    y, wy, left, right = rows
    x, wx = legendre(fine.count(turns * float((right - left).max())), left[:, None], right[:, None])
    return y, wy, x, wx


def brute_force(scene, source_yx, pixel_yx, fine=None, pupil_waves=None):
    """Return the cutout ``scene.cutout`` about a pixel of a source whose chief ray is at ``source_yx`` (µm).

    ``pupil_waves(u, v)`` is the main lens's aberration at a point of the pupil, u along x, in its radii.
    """
    fine = fine or Fineness()
    lam, gap, px = scene.wavelength_um, scene.lattice.gap_um, scene.pixel_um
    middle = np.array([pixel_yx[1], pixel_yx[0]]) * px
    about = np.array([source_yx[1], source_yx[0]]) / (1 + gap / scene.pupil_um)
    t, w = legendre(fine.pixel, -scene.pixel_fill / 2, scene.pixel_fill / 2)
    down, across = (((np.arange(n) - n // 2)[:, None] + t).ravel() * px for n in scene.cutout)
    farthest = fine.reach_um + max(scene.cutout) / 2 * px + float(np.abs(about - middle).max())
    y, wy, x, wx = aperture_nodes(scene, fine, farthest)
    # the pupil's integral on a lenslet has no phase steeper than the cone's edge; interpolation takes pi nodes a turn
    span = 1.0001 * max(np.abs(x).max(), np.abs(y).max())
    count = fine.count(2 * 1.2 * span / (scene.wavelength_um * scene.f_number))
    chebyshev = np.cos((2 * np.arange(count) + 1) * np.pi / (2 * count))
    to_rows, along_rows = interpolation(chebyshev, y / span), interpolation(chebyshev, x / span)
    centres, kinds = lenslets(scene.lattice, about, fine.reach_um)
    fields = np.empty((*x.shape, len(centres)), complex)
    for k, (c, kind) in enumerate(zip(centres, kinds, strict=True)):
        values = main_field(scene, *(place + span * chebyshev for place in c - about), fine, pupil_waves)
        on_rows = np.einsum("rkn,rn->rk", along_rows, to_rows @ values)
        to_pupil, to_pixel = (np.square(c[0] - o[0] + x) + np.square(c[1] - o[1] + y)[:, None] for o in (0 * c, middle))
        bend = (np.square(x) + np.square(y)[:, None]) / scene.lattice.types[kind].focal_length_um
        phase = to_pupil / scene.pupil_um + to_pixel / gap - bend
        # W040 (r/R)^4 of a lenslet whose rim is at R
        waves = scene.lenslet_waves + (scene.type_waves[kind] if scene.type_waves else 0.0)
        rim = (scene.lattice.clear_um or scene.lattice.pitch_um) / 2
        aberration = 2 * waves * ((np.square(x) + np.square(y)[:, None]) / rim**2) ** 2
        fields[..., k] = on_rows * wx * wy[:, None] * np.exp(1j * np.pi * (phase / lam + aberration))
    turn = -2j * np.pi / (lam * gap)
    shift_x, shift_y = (
        np.exp(turn * np.outer(s, c)) for s, c in zip((across, down), (centres - middle).T, strict=True)
    )
    light = np.zeros((down.size, across.size), complex)
    for j in range(y.size):
        row = (np.exp(turn * np.outer(across, x[j])) @ fields[j]) * shift_x
        light += (shift_y * np.exp(turn * down * y[j])[:, None]) @ row.T
    squares = np.abs(light) ** 2 / (lam * gap) ** 2 * px * px
    nt, ns = scene.cutout
    return np.einsum("tisj,i,j->ts", squares.reshape(nt, fine.pixel, ns, fine.pixel), w, w)
