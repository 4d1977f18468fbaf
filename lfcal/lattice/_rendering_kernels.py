"""Compiled inner loop of rendering: every lenslet adds what it sees to the places that it sees."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["RefocusPlane", "render_rows"]

Float = NDArray[Any]


class RefocusPlane(NamedTuple):
    """A plane of the scene, and where the samples of its image lie on the sensor."""

    slope: float  # (S - c) over the place below the lenslet; not 0
    radius: float  # of the micro-images (pixels)
    corner_y: float  # place of sample (0, 0) (pixels)
    corner_x: float
    step_y: float  # distance of samples (pixels)
    step_x: float


@njit()
def render_rows(
    frame: Float, white: Float, lenslets: NDArray[np.float64], plane: RefocusPlane, sums: Float, rows: tuple[int, int]
) -> None:
    """Add rows ``rows[0] … rows[1]`` of a plane's image to ``sums`` ``(4, rows, columns)``.

    ``lenslets`` ``(n, 3)`` are row, column and weight s. The place S is seen by lenslet c at p = c + (S - c)/slope,
    where there is light L(p) of a white frame's W(p) (bilinear): the sums are of s W, s L, s L^2 / W and (s W)^2.
    """
    reach = abs(plane.slope) * plane.radius
    columns, (high, wide) = sums.shape[2], frame.shape
    for m in range(len(lenslets)):
        cy, cx, s = lenslets[m, 0], lenslets[m, 1], lenslets[m, 2]
        top = max(int(np.ceil((cy - reach - plane.corner_y) / plane.step_y)), rows[0])
        bottom = min(int(np.floor((cy + reach - plane.corner_y) / plane.step_y)) + 1, rows[1])
        left = max(int(np.ceil((cx - reach - plane.corner_x) / plane.step_x)), 0)
        right = min(int(np.floor((cx + reach - plane.corner_x) / plane.step_x)) + 1, columns)
        for i in range(top, bottom):
            v = (plane.corner_y + i * plane.step_y - cy) / plane.slope
            for j in range(left, right):
                u = (plane.corner_x + j * plane.step_x - cx) / plane.slope
                if v * v + u * u > plane.radius * plane.radius:
                    continue
                y, x = int(np.floor(cy + v)), int(np.floor(cx + u))
                if y < 0 or x < 0 or y + 1 >= high or x + 1 >= wide:
                    continue
                b, a = cy + v - y, cx + u - x
                w00, w01, w10, w11 = (1 - b) * (1 - a), (1 - b) * a, b * (1 - a), b * a
                light = w00 * frame[y, x] + w01 * frame[y, x + 1] + w10 * frame[y + 1, x] + w11 * frame[y + 1, x + 1]
                lit = w00 * white[y, x] + w01 * white[y, x + 1] + w10 * white[y + 1, x] + w11 * white[y + 1, x + 1]
                if lit > 0:
                    sums[0, i, j] += s * lit
                    sums[1, i, j] += s * light
                    sums[2, i, j] += s * light * light / lit
                    sums[3, i, j] += s * lit * s * lit
