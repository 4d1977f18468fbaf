"""Compiled loops of the wave engine over many lenslets: which of them matter to a source, and the sum of fields."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["SPOT", "LensletLight", "LensletWindow", "select", "square_fields"]

F4 = NDArray[Any]
F8 = NDArray[np.float64]
I8 = NDArray[np.int64]

# fields of a structured array are part of a kernel's signature, so other files may share this type
SPOT = np.dtype(
    [
        *((name, np.int64) for name in ("position", "row", "col", "top", "left")),
        *((name, np.float64) for name in ("x0", "y0", "ox", "oy", "mx", "my", "lx", "ly", "energy_in", "energy_out")),
    ]
)
"""The light of one lenslet for one source position.

position
    Index of the source.
row, col
    Sample of the field table nearest to the lenslet's centre.
top, left
    First row and column of the window in the cutout (pixels); they may lie outside.
x0, y0
    Position of this sample relative to the lenslet's centre (µm).
ox, oy
    Middle of the window relative to the phase's centre, c - (B'/a') (c - X0) (µm).
mx, my
    Middle of the window relative to the source's image X0 (µm).
lx, ly
    Position of the lenslet relative to the source's image, c - X0 (µm).
energy_in, energy_out
    Energy that the lenslet passes, and energy that its window receives; `lfcal.simulate.engines._kernels.respond`
    sets both.
"""


class LensletLight(NamedTuple):
    """The light that reaches the lenslets of one type."""

    energy: F4  # (n, n): light transmitted by a lenslet at each sample of the field table
    floor: float  # energy below which a lenslet is left out
    dx_um: float  # distance of samples
    half: int  # samples from the middle of an aperture to its edge


class LensletWindow(NamedTuple):
    """Where the light of a lenslet arrives on the sensor."""

    px_um: float  # pixel pitch, in the reduced frame
    ratio: float  # B'/a' of the converging sphere; 0 near the native plane
    pull: float  # the window's middle lies at c - pull (c - X0)
    width: int  # its side (pixels)
    rows: int  # height of the cutout (pixels)
    columns: int
    beyond: int  # how far beyond the window light is followed (pixels)


@njit()
def select(
    light: LensletLight, window: LensletWindow, centre: F8, source: F8, pixel: I8, spots: Any
) -> tuple[int, int]:
    """List in ``spots`` the positions whose light passes a lenslet and reaches the cutout; return their number.

    Positions whose light reaches the lenslet only outside the window are listed from the end, with ``energy_in`` for
    uniform light through the lenslet. Their number is the second return value.

    Parameters
    ----------
    light, window
        The lenslet's type.
    centre
        Lenslet centre c (x, y) (µm).
    source, pixel
        Images X0 of the sources ``(n, 2)`` as (x, y) (µm), and the cutouts' middle pixels ``(n, 2)`` as (row, column).
    spots
        Out: `SPOT` array ``(n,)``.
    """
    n = light.energy.shape[0]
    dx, half, px, width = light.dx_um, light.half, window.px_um, window.width
    found = far = 0
    for p in range(source.shape[0]):
        lx, ly = centre[0] - source[p, 0], centre[1] - source[p, 1]
        kx, ky = round(lx / dx), round(ly / dx)
        col, row = n // 2 + kx, n // 2 + ky
        if row - half < 0 or row + half >= n or col - half < 0 or col + half >= n:
            continue
        if light.energy[row, col] < light.floor:
            continue
        # the window begins with a whole pixel, so that all windows of a type have the same nodes
        wx = math.floor((centre[0] - window.pull * lx) / px + 0.5)
        wy = math.floor((centre[1] - window.pull * ly) / px + 0.5)
        left = int(wx) - pixel[p, 1] - width // 2 + window.columns // 2
        top = int(wy) - pixel[p, 0] - width // 2 + window.rows // 2
        aside = max(-left - width, -top - width, left - window.columns, top - window.rows)
        if aside >= window.beyond:
            continue
        if aside >= 0:
            far += 1
            spot = spots[spots.shape[0] - far]
            spot.energy_in = light.energy[row, col]
        else:
            found += 1
            spot = spots[found - 1]
        spot.position, spot.row, spot.col, spot.top, spot.left = p, row, col, top, left
        spot.x0, spot.y0 = kx * dx - lx, ky * dx - ly
        spot.ox, spot.oy = wx * px - (centre[0] - window.ratio * lx), wy * px - (centre[1] - window.ratio * ly)
        spot.mx, spot.my = wx * px - source[p, 0], wy * px - source[p, 1]
        spot.lx, spot.ly = lx, ly
    return found, far


@njit(fastmath=True)
def square_fields(grid_re: F4, grid_im: F4, boxes: I8, weights: F4, per: int, out: F4) -> None:
    """Integrate the squares of the summed fields over the pixels of each position's box; clear grids and boxes.

    A pixel is sum_ij w_i w_j |V_ij|^2 over its ``per`` nodes along each side and those shared with its neighbours.
    Columns are summed first, because neighbouring pixels of a row share these sums.
    """
    taps = weights.size
    line = np.empty(grid_re.shape[2], grid_re.dtype)
    for p in range(out.shape[0]):
        top, bottom = max(0, boxes[p, 0]), min(out.shape[1], boxes[p, 1])
        left, right = max(0, boxes[p, 2]), min(out.shape[2], boxes[p, 3])
        if top < bottom and left < right:
            first, last = left * per, right * per + taps - per
            for t in range(top, bottom):
                line[first:last] = 0
                for i in range(taps):
                    for j in range(first, last):
                        re, im = grid_re[p, t * per + i, j], grid_im[p, t * per + i, j]
                        line[j] += weights[i] * (re * re + im * im)
                for s in range(left, right):
                    total = weights[0] * line[s * per]
                    for j in range(1, taps):
                        total += weights[j] * line[s * per + j]
                    out[p, t, s] = total
            grid_re[p, top * per : bottom * per + taps - per, first:last] = 0
            grid_im[p, top * per : bottom * per + taps - per, first:last] = 0
        boxes[p, 0], boxes[p, 1], boxes[p, 2], boxes[p, 3] = 1 << 30, -(1 << 30), 1 << 30, -(1 << 30)
