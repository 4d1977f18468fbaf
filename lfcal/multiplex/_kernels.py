"""Compiled inner loops of the spatial route: interpolation of channels and local decorrelation in one pass.

A super-pixel of py x px pixels measures py px channels y = A x of the samples x (theorem 1). Channel (a, b) is a
separate frame, sampled once per super-pixel. The channels are interpolated to the positions of the output and
multiplied by the pseudo-inverse of A: ``out[j] = sum_ab inverse[j, a px + b] (channel ab interpolated)``.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import njit

__all__ = ["Channels", "Guided", "Taps", "bilateral_rows", "linear_rows"]

Float = NDArray[Any]
Index = NDArray[np.intp]


class Taps(NamedTuple):
    """Interpolation along both axes with m output positions per super-pixel: weights of neighbouring super-pixels.

    Output position q of super-pixel k is ``sum_t weight[q, a, t] * (channel a of super-pixel k + first[q, a] + t)``.
    """

    first_y: Index  # (my, py): first neighbour, in super-pixels
    weight_y: Float  # (my, py, taps)
    first_x: Index  # (mx, px)
    weight_x: Float  # (mx, px, taps)


class Channels(NamedTuple):
    """Combination of the channels of a super-pixel to samples."""

    side_y: int  # pixels of a super-pixel
    side_x: int
    inverse: Float  # (samples, py px): pseudo-inverse of the modulator's matrix
    used: NDArray[np.bool_]  # (samples, px): whether any channel of a column enters a sample


class Guided(NamedTuple):
    """Frame, and the image whose edges the interpolation preserves."""

    frame: NDArray[Any]  # (rows, columns)
    guide: Float  # the same shape
    sharpness: float  # 1 / (2 sigma^2), sigma in values of the guide


@njit()
def linear_rows(frame: NDArray[Any], taps: Taps, channels: Channels, out: Float, start: int, stop: int) -> None:
    """Write rows ``start … stop`` of all samples ``out`` ``(samples, rows, columns)``.

    The steps are: down the columns, across the channels, along the rows. Because all steps are linear, any order is
    possible. This order accesses each sample of the frame least often.
    """
    py, px = channels.side_y, channels.side_x
    my, taps_x = taps.weight_y.shape[0], taps.weight_x.shape[2]
    cells_x = frame.shape[1] // px
    # the ends of a row are repeated within the reach of the taps, so that no tap needs a test
    margin = max(-taps.first_x.min(), taps.first_x.max() + taps_x - 1, 0)
    g = np.empty((py, cells_x * px), out.dtype)  # one row of each a, interpolated down
    u = np.empty((px, cells_x + 2 * margin), out.dtype)  # one row of each b, decorrelated
    acc = np.empty(cells_x, out.dtype)
    for n in range(start, stop):
        _down(frame, taps, n // my, n % my, g)
        for j in range(channels.inverse.shape[0]):
            _across(channels, j, g, u, margin)
            _along(taps, channels.used[j], u, margin, acc, out[j, n])


@njit()
def _down(frame: NDArray[Any], taps: Taps, cell: int, phase: int, g: Float) -> None:
    """Interpolate output row ``phase`` of the super-pixels in row ``cell`` to ``g`` (py, width)."""
    first_y, weight_y = taps.first_y, taps.weight_y
    py, width = g.shape
    cells_y = frame.shape[0] // py
    for a in range(py):
        g[a] = 0
        for t in range(weight_y.shape[2]):
            w = weight_y[phase, a, t]
            if w != 0:
                row = frame[min(max(cell + first_y[phase, a] + t, 0), cells_y - 1) * py + a]
                for x in range(width):
                    g[a, x] += w * row[x]


@njit()
def _across(channels: Channels, j: int, g: Float, u: Float, margin: int) -> None:
    """Write the part of sample ``j`` from every column b of channels to ``u`` ``(px, margin + cells + margin)``."""
    py, px, inverse, used = channels.side_y, channels.side_x, channels.inverse, channels.used
    cells_x = u.shape[1] - 2 * margin
    for b in range(px):
        if not used[j, b]:
            continue
        line = u[b]
        inner = line[margin : margin + cells_x]
        inner[:] = 0
        for a in range(py):
            w = inverse[j, a * px + b]
            if w != 0:
                channel = g[a]
                for k in range(cells_x):
                    inner[k] += w * channel[k * px + b]
        line[:margin] = line[margin]
        line[margin + cells_x :] = line[margin + cells_x - 1]


@njit()
def _along(taps: Taps, used: NDArray[np.bool_], u: Float, margin: int, acc: Float, target: Float) -> None:
    """Interpolate one row along x to ``target`` ``(cells mx)``; ``acc`` ``(cells,)`` is a work array."""
    first_x, weight_x = taps.first_x, taps.weight_x
    cells_x = acc.size
    mx, px = first_x.shape
    for q in range(mx):
        acc[:] = 0
        for b in range(px):
            if not used[b]:
                continue
            for t in range(weight_x.shape[2]):
                w = weight_x[q, b, t]
                if w != 0:
                    shifted = u[b, margin + first_x[q, b] + t :]
                    for k in range(cells_x):
                        acc[k] += w * shifted[k]
        # summed contiguously, stored mx apart: one strided pass instead of one per tap
        for k in range(cells_x):
            target[k * mx + q] = acc[k]


@njit()
def bilateral_rows(image: Guided, taps: Taps, channels: Channels, out: Float, start: int, stop: int) -> None:
    """Write output rows of the joint bilateral filter (Petschnigg et al. 2004), ``out`` ``(samples, rows, columns)``.

    Each channel is sum w f / sum w, where w is the linear weight times exp(-(guide difference)^2 / (2 sigma^2)).
    """
    # take arrays out of their records before the loops, where each access would count references
    frame, guide, sharpness, inverse = image.frame, image.guide, image.sharpness, channels.inverse
    first_y, weight_y, first_x, weight_x = taps.first_y, taps.weight_y, taps.first_x, taps.weight_x
    py, px = channels.side_y, channels.side_x
    my, mx = weight_y.shape[0], weight_x.shape[0]
    cells_y, cells_x = frame.shape[0] // py, frame.shape[1] // px
    channel = np.empty(py * px, out.dtype)
    for n in range(start, stop):
        cell_y, phase = n // my, n % my
        for m in range(cells_x * mx):
            cell_x, q = m // mx, m % mx
            gy = min(max(int((n + 0.5) * py / my), 0), cells_y * py - 1)
            gx = min(max(int((m + 0.5) * px / mx), 0), cells_x * px - 1)
            here = guide[gy, gx]
            for a in range(py):
                for b in range(px):
                    total, norm = 0.0, 0.0
                    for t in range(weight_y.shape[2]):
                        y = min(max(cell_y + first_y[phase, a] + t, 0), cells_y - 1) * py + a
                        for s in range(weight_x.shape[2]):
                            x = min(max(cell_x + first_x[q, b] + s, 0), cells_x - 1) * px + b
                            w = weight_y[phase, a, t] * weight_x[q, b, s]
                            if w != 0:
                                d = guide[y, x] - here
                                # never zero: at an isolated spot, all neighbours differ, and the result would be 0/0
                                w *= np.exp(-d * d * sharpness) + 1e-6
                                total += w * frame[y, x]
                                norm += w
                    channel[a * px + b] = total / norm
            for j in range(inverse.shape[0]):
                value = 0.0
                for k in range(py * px):
                    value += inverse[j, k] * channel[k]
                out[j, n, m] = value
