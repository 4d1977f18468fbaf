"""Measurement of position and sharpness of the source's image, and of its displacement between two frames."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError

__all__ = ["Spot", "find_spot", "image_shift"]

SAMPLE = 1 << 18
DETECT_SIGMA = 5.0
KEEP = 0.05


@dataclass(frozen=True, slots=True)
class Spot:
    """Light of the source in a frame.

    Attributes
    ----------
    row, column
        Centroid of the light above the background (px), from the centre of the first pixel of the frame.
    energy
        Sum of the light above the background (counts).
    peak
        Highest pixel value of the light, minus the background (counts).
    sharpness
        Sum of the squared differences between neighbouring pixels, divided by the sum of the squared values above the
        background; in [0, 4]. It is independent of brightness, and larger for a sharper image.
    snr
        Ratio of the peak to the noise of the background.
    radius
        RMS distance of the light from its centroid, weighted by the light (px).
    """

    row: float
    column: float
    energy: float
    peak: float
    sharpness: float
    snr: float
    radius: float


def find_spot(frame: NDArray[Any]) -> Spot:
    """Measure position, brightness and size of the light of the source in ``frame`` ``(rows, columns)``.

    The background is the median of the frame, and its noise is the scaled median absolute deviation, but at least 0.3
    counts. Only pixels that exceed the background by five times the noise, and by a twentieth of the peak, count as
    light. A bright pixel without a bright neighbour is excluded, because it may be a hot pixel.

    Raises
    ------
    InputError
        If there are fewer than four bright pixels with a bright neighbour.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.acquire.setup import Spot, find_spot
    >>> y, x = np.mgrid[:80, :100]
    >>> frame = 100 + 900 * np.exp(-((y - 30.4) ** 2 + (x - 61.5) ** 2) / 8)
    >>> spot: Spot = find_spot(frame)
    >>> print(f"row {spot.row:.1f}, column {spot.column:.1f}")
    row 30.4, column 61.5
    """
    # a subset is enough for the median of millions of pixels
    step = max(1, math.isqrt(frame.size // SAMPLE))
    sample = frame[::step, ::step].astype(np.float64)
    level = float(np.median(sample))
    # 0.3 counts: noise of rounding to integers
    noise = max(1.4826 * float(np.median(np.abs(sample - level))), 0.3)
    bright = frame > level + DETECT_SIGMA * noise
    together = np.zeros_like(bright)
    # a bright pixel counts only with a bright neighbour
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:-1], np.s_[1:])):
        together[a] |= bright[b]
        together[:, a] |= bright[:, b]
    bright &= together
    rows, columns = np.nonzero(bright)
    if len(rows) < 4:
        raise InputError.expected(
            "source",
            f"light above {level + DETECT_SIGMA * noise:.4g} counts",
            "no significant light",
            "check lamp, exposure and position",
        )
    top, left = int(rows.min()), int(columns.min())
    box = np.s_[top : rows.max() + 1, left : columns.max() + 1]
    light = np.where(bright[box], frame[box] - level, 0.0)
    peak = float(light.max())
    # noise outside the light would pull the centroid to the middle of the box
    light[light < KEEP * peak] = 0.0
    energy = float(light.sum())
    change = float((np.diff(light, axis=0) ** 2).sum() + (np.diff(light, axis=1) ** 2).sum())
    row, row_variance = _moments(light.sum(axis=1) / energy)
    column, column_variance = _moments(light.sum(axis=0) / energy)
    sharpness = min(4.0, change / float((light**2).sum()))
    radius = math.sqrt(row_variance + column_variance)
    return Spot(top + row, left + column, energy, peak, sharpness, peak / noise, radius)


def _moments(share: NDArray[np.float64]) -> tuple[float, float]:
    """Return mean and variance (pixels) of a position along an axis whose pixels have these fractions of the light."""
    place = np.arange(len(share))
    mean = float(share @ place)
    return mean, float(share @ (place - mean) ** 2)


def image_shift(before: NDArray[Any], after: NDArray[Any]) -> tuple[float, float, float]:
    """Return the displacement of the light between two frames of the same region (px), and their correlation.

    The result is (rows, columns, correlation): the centroid in ``after`` minus that in ``before``, and the normalised
    correlation of the unshifted frames. The correlation is 1 for frames that differ only in brightness.

    Raises
    ------
    InputError
        If either frame shows no light, as in `find_spot`.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.acquire.setup import image_shift
    >>> y, x = np.mgrid[:64, :64]
    >>> before = 1000 * np.exp(-((y - 30) ** 2 + (x - 35) ** 2) / 8)
    >>> rows, columns, _ = image_shift(before, np.roll(before, (3, -2), (0, 1)))
    >>> print(f"{rows:.1f} down, {-columns:.1f} to the left")
    3.0 down, 2.0 to the left
    """
    first, second = find_spot(before), find_spot(after)
    a = before - np.median(before).astype(np.float64)
    b = after - np.median(after).astype(np.float64)
    correlation = float((a * b).sum() / math.sqrt(float((a**2).sum()) * float((b**2).sum())))
    return second.row - first.row, second.column - first.column, correlation
