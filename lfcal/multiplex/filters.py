"""Reconstruction filters: weights for interpolation between the samples of a measurement channel."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_choice

__all__ = [
    "COLOUR_FILTERS",
    "EDGE_PRESERVING",
    "LINEAR_FILTERS",
    "SPATIAL_FILTERS",
    "dirichlet_table",
    "kernel",
    "tap_table",
]

Array = NDArray[np.float64]

LINEAR_FILTERS = ("nearest", "linear", "cubic", "lanczos", "sinc")
EDGE_PRESERVING = "bilateral"
SPATIAL_FILTERS = (*LINEAR_FILTERS, EDGE_PRESERVING)
"""Filters for every modulator."""
COLOUR_FILTERS = ("lmmse", "directional")
"""Filters that use the correlation of colours in images: only for colour filter arrays."""

_TAPS = {"nearest": 1, "linear": 2, "cubic": 4, "lanczos": 6}


def kernel(name: str, x: Array) -> Array:
    """Return the values of the interpolation kernel ``name`` at distances ``x`` (in samples of a channel).

    The kernels are ``"nearest"``, ``"linear"``, ``"cubic"`` (Keys' kernel with a = -1/2) and ``"lanczos"`` (three lobes
    on each side).
    """
    check_choice("filter", name, tuple(_TAPS))
    d = np.abs(np.asarray(x, float))
    if name == "nearest":
        return np.asarray(d <= 0.5, float)
    if name == "linear":
        return np.asarray(np.maximum(0.0, 1.0 - d))
    if name == "cubic":
        near = (1.5 * d - 2.5) * d * d + 1
        far = ((-0.5 * d + 2.5) * d - 4) * d + 2
        return np.where(d <= 1, near, np.where(d < 2, far, 0.0))
    return np.where(d < 3, np.sinc(d) * np.sinc(d / 3), 0.0)


def tap_table(name: str, side: int, positions: Array, samples: int) -> tuple[NDArray[np.intp], Array]:
    """Return the first taps and the weights with which a filter interpolates along one axis.

    Output sample n is (n + 1/2) side/samples - 1/2 pixels from the first pixel of the super-pixel. With one sample per
    pixel, samples are therefore at the pixels' centres; a single sample is in the middle of the super-pixel.

    Parameters
    ----------
    name
        One of the filters with few taps: ``"nearest"``, ``"linear"``, ``"cubic"`` or ``"lanczos"``.
    side
        Number of pixels of the super-pixel along the axis.
    positions
        Positions ``(side,)`` along the axis at which the pixels of a super-pixel sample the light, relative to its
        first pixel (pixels).
    samples
        Output samples per super-pixel.

    Returns
    -------
    tuple
        Two arrays for each output sample of a super-pixel and each pixel along the axis. The first,
        ``(samples, side)``, contains the super-pixel of the first tap, relative to that of the output sample. The
        second, ``(samples, side, taps)``, contains the weights of the taps, which add up to one.
    """
    check_choice("filter", name, tuple(_TAPS))
    taps = _TAPS[name]
    wanted = (np.arange(samples) + 0.5) * side / samples - 0.5
    place = (wanted[:, None] - positions[None, :]) / side
    # at the position of a sample, only that sample counts: drop weights of others due to rounding
    place = np.where(np.abs(place - np.rint(place)) < 1e-12, np.rint(place), place)
    first = np.floor(place + 0.5 if taps == 1 else place).astype(np.intp) - (taps - 1) // 2
    weights = (
        kernel(name, place[..., None] - first[..., None] - np.arange(taps)) if taps > 1 else np.ones((*place.shape, 1))
    )
    weights[np.abs(weights) < 1e-14] = 0.0
    # truncated kernels do not add up to one, and uniform light would show ripples
    return first, weights / weights.sum(-1, keepdims=True)


def dirichlet_table(count: int, side: int, positions: Array, samples: int) -> Array:
    """Return the weights of the periodic sinc that interpolates the ``count`` samples of each channel along one axis.

    Their shape is ``(side, count * samples, count)``: channel, output sample, sample of the channel. At the distance t
    (in samples of the channel), the filter is sin(pi t)/(count tan(pi t/count)) for even counts. The highest positive
    and negative frequencies then have half the weight of the others. For odd counts, it is
    sin(pi t)/(count sin(pi t/count)). ``side``, ``positions`` and ``samples`` are as in `tap_table`.
    """
    wanted = (np.arange(count * samples) + 0.5) * side / samples - 0.5
    t = (wanted[None, :, None] - positions[:, None, None]) / side - np.arange(count)
    frequencies = np.arange(-(count // 2), count // 2 + 1)
    weight = np.ones(len(frequencies))
    if count % 2 == 0 and count > 1:
        weight[[0, -1]] = 0.5  # both ends are the same frequency
    table = np.zeros(t.shape)
    for k, w in zip(frequencies[count // 2 :], weight[count // 2 :], strict=True):
        table += (1.0 if k == 0 else 2.0) * w * np.cos(2 * math.pi * k * t / count)
    return table / count
