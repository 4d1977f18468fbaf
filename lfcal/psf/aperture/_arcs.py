"""Outlines made of arcs: an iris, an iris with a stuck blade, and either of them cut by a second rim."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["Arcs", "arcs_radius"]

Values = NDArray[np.float64]

CALL_S, RAY_S = 6e-5, 4e-8
"""Additional processor time (s) of `_arcs_radius` instead of `arcs_radius`, per call, and per arc and ray."""


@njit(_nrt=False)
def arcs_radius(
    arcs: Values, stretched: tuple[float, float], origin: tuple[float, float], angles: Values, out: Values, work: Values
) -> None:
    """Fill ``out`` (n,) with the radius at which rays from an origin leave the area inside all of the given arcs.

    An arc of curvature k whose middle is at distance h from the centre in direction t bounds a disc of radius 1/k, or
    a half plane if k = 0. From an origin at (x, y) in the arc's frame, a ray (c, s) leaves it where ``k r² + 2 r (c (1
    + k X) + k s y) + k (X² + y²) + 2 X = 0`` with X = x - h. This also holds for straight blades.

    Parameters
    ----------
    arcs
        ``(n, 3)``: direction t (rad), distance h (pixels), curvature k (1/pixels) of each.
    stretched
        Stretch and shear: the symmetric stretch ``[[1 + stretch, shear], [shear, 1 - stretch]]`` transforms the outline
        to the frame of the arcs.
    origin
        Origin of the rays (row, column) relative to the centre of the outline (pixels).
    angles
        Directions of the rays, from +column towards +row (rad).
    out, work
        Radii ``(n,)`` (pixels), and scratch memory ``(3, n)``.
    """
    n, (stretch, shear), (row, column) = angles.size, stretched, origin
    ex, ey, length = work[0], work[1], work[2]
    x0 = column * (1 + stretch) + row * shear
    y0 = column * shear + row * (1 - stretch)
    for i in range(n):  # expressions of whole arrays would take longer to compile
        ca, sa = math.cos(angles[i]), math.sin(angles[i])
        x, y = ca * (1 + stretch) + sa * shear, ca * shear + sa * (1 - stretch)
        length[i] = math.sqrt(x * x + y * y)
        ex[i], ey[i], out[i] = x / length[i], y / length[i], 1e9
    for j in range(arcs.shape[0]):
        u, v, k = math.cos(arcs[j, 0]), math.sin(arcs[j, 0]), arcs[j, 2]
        x, y = x0 * u + y0 * v - arcs[j, 1], y0 * u - x0 * v
        along, across = 1 + k * x, k * y
        constant = k * (x * x + y * y) + 2 * x
        # without a branch, the compiler vectorises the loop
        for i in range(n):
            b = (ex[i] * u + ey[i] * v) * along + (ey[i] * u - ex[i] * v) * across
            root = b * b - k * constant
            below = b + math.sqrt(max(root, 0.0))
            leaves = root > 0 and below > 1e-9
            radius = -constant / (below if leaves else 1.0)
            out[i] = min(out[i], radius) if leaves else out[i]
    for i in range(n):
        out[i] /= length[i]


def _arcs_radius(arcs: Values, stretched: tuple[float, float], origin: tuple[float, float], angles: Values) -> Values:
    """Compute the values of `arcs_radius` with numpy and the same equations."""
    (stretch, shear), (row, column) = stretched, origin
    ca, sa = np.cos(angles), np.sin(angles)
    ex, ey = ca * (1 + stretch) + sa * shear, ca * shear + sa * (1 - stretch)
    length = np.sqrt(ex * ex + ey * ey)
    ex, ey = ex / length, ey / length
    x0, y0 = column * (1 + stretch) + row * shear, column * shear + row * (1 - stretch)
    u, v, h, k = np.cos(arcs[:, :1]), np.sin(arcs[:, :1]), arcs[:, 1:2], arcs[:, 2:]
    x, y = x0 * u + y0 * v - h, y0 * u - x0 * v
    b = (ex * u + ey * v) * (1 + k * x) + (ey * u - ex * v) * (k * y)
    constant = k * (x * x + y * y) + 2 * x
    root = b * b - k * constant
    below = b + np.sqrt(np.maximum(root, 0.0))
    leaves = (root > 0) & (below > 1e-9)
    radii: Values = np.where(leaves, -constant / np.where(leaves, below, 1.0), 1e9).min(0, initial=1e9) / length
    return radii


@dataclass(frozen=True, slots=True)
class Arcs:
    """Parameters of an outline.

    Attributes
    ----------
    apothem, curvature
        Distance of each blade's middle from the centre (pixels), and apothem over blade radius.
    blades, rotation_rad
        Number of blades, 0 for a circle, and direction of the first vertex (rad).
    stuck, stuck_share
        Displaced blade, numbered from the first vertex (-1: none), and its outward displacement as a fraction of the
        apothem.
    rim
        A second rim: direction of its nearest point (rad), distance of that point divided by the apothem, and curvature
        of the rim times the apothem; None without one.
    stretch, shear
        Stretch of the outline, see `arcs_radius`.
    """

    apothem: float
    curvature: float = 1.0
    blades: int = 0
    rotation_rad: float = 0.0
    stuck: int = -1
    stuck_share: float = 0.0
    rim: tuple[float, float, float] | None = None
    stretch: float = 0.0
    shear: float = 0.0

    def table(self) -> Values:
        """Return the arcs in the form that `arcs_radius` needs."""
        a, n = self.apothem, self.blades
        if n:
            arcs = np.empty((n, 3))
            arcs[:, 0] = self.rotation_rad + (np.arange(n) + 0.5) * (2 * math.pi / n)
            arcs[:, 1] = a
            arcs[:, 2] = self.curvature / a
            if self.stuck >= 0:
                arcs[self.stuck, 1] *= 1 + self.stuck_share
        else:
            arcs = np.array([[0.0, a, 1 / a]])
        if self.rim is not None:
            arcs = np.vstack([arcs, [self.rim[0], a * self.rim[1], self.rim[2] / a]])
        return arcs

    def radius(self, angles: Values, row: float = 0.0, column: float = 0.0) -> Values:
        """Return the outline's radius seen from a point, which is given relative to the outline's centre (pixels)."""
        arcs, stretched, origin = self.table(), (float(self.stretch), float(self.shear)), (float(row), float(column))
        if arcs_radius.spared(CALL_S + RAY_S * len(arcs) * angles.size):
            return _arcs_radius(arcs, stretched, origin, angles)
        out = np.empty(angles.size)
        arcs_radius(arcs, stretched, origin, angles, out, np.empty((3, angles.size)))
        return out
