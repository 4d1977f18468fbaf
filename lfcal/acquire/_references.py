"""Analyse reference frames: separate the effects of the stage, of the lamp and of the sensor."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.spots import find_spot
from lfcal.base import InputError

__all__ = ["HotPixels", "References", "light_where"]

CLEAR = 20.0
"""Ratio of peak to noise above which the position of the light is known much better than 0.1 pixel."""
FEW = 5
"""Smallest number of frames that distinguish scatter from drift."""
HOT_SIGMAS, HOT_SHARE = 20.0, 0.02
"""Thresholds of a hot pixel above its dark surroundings: standard deviations of the noise, and fraction of the
range."""
ALONE, FEW_HOT = 4.0, 16
"""Smallest ratio of the rise of a hot pixel to that of its neighbours; largest number of pixels that become hot
between two frames."""
MANY = 1000
"""Largest number of hot pixels in a dark frame; if there are more, none is excluded."""


class References:
    """Statistics of repeated frames of one position, in the order of recording.

    Parameters
    ----------
    full
        Largest sample value of the sensor.

    Attributes
    ----------
    seen
        For each frame: time of recording (s), light above the background (counts), row and column of the light (pixels
        of the frame; NaN if it is too faint), and background (counts).
    hot
        Number of pixels that became hot after the first frame.
    """

    def __init__(self, full: float) -> None:
        self._full = full
        self._latest: NDArray[np.float64] | None = None
        self._is_hot = np.zeros((0, 0), np.bool_)
        self.seen: list[tuple[float, float, float, float, float]] = []
        self.hot = 0

    def add(self, seconds: float, frame: NDArray[Any], border: NDArray[np.bool_]) -> None:
        """Add a frame ``(rows, columns)``; the mask ``border`` selects the pixels that show the background."""
        data = frame.astype(np.float64)
        level, noise = float(np.median(data[border])), float(data[border].std())
        data -= level
        if self._latest is None or self._latest.shape != data.shape:
            self._latest, self._is_hot = data, np.zeros(data.shape, np.bool_)
        self._is_hot |= _became_hot(self._latest, data, max(HOT_SIGMAS * noise, HOT_SHARE * self._full))
        self.hot = int(self._is_hot.sum())
        data[self._is_hot] = 0.0
        self._latest = data
        try:
            spot = find_spot(data)
            place = (spot.row, spot.column) if spot.snr > CLEAR else (math.nan, math.nan)
        except InputError:
            place = math.nan, math.nan
        self.seen.append((seconds, float(data.sum()), *place, level))

    def moved(self) -> tuple[float, float]:
        """Return the largest distance of the light from its first position, and its scatter per axis (pixels).

        The scatter is computed from second differences, which a steady drift or a single jump hardly changes.
        """
        places = np.array([row[2:4] for row in self.seen]).reshape(-1, 2)
        places = places[np.isfinite(places).all(axis=1)]
        if len(places) < 2:
            return 0.0, 0.0
        scatter = 0.0
        if len(places) >= FEW:
            scatter = 1.4826 * float(np.median(np.abs(np.diff(places, n=2, axis=0)))) / math.sqrt(6)
        return float(np.hypot(*(places - places[0]).T).max()), scatter


def light_where(energy: NDArray[np.float64], y: int, x: int, moves_px: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the light of position ``(y, x)`` after its source is displaced by ``moves_px`` ``(n, 2)`` (rows, columns).

    ``energy`` ``(ny, nx)`` is the light at the positions of a plane; a source displaced by a pixel is at the next
    position. The result ``(n,)`` is NaN where that position was not recorded.
    """
    from scipy.ndimage import map_coordinates  # slow to import

    places = np.array([[y], [x]]) + moves_px.T
    there: NDArray[np.float64] = map_coordinates(energy, places, order=1, mode="nearest")
    return there


def _became_hot(before: NDArray[np.float64], data: NDArray[np.float64], limit: float) -> NDArray[np.bool_]:
    """Return a mask of the single pixels whose value rose by more than ``limit`` between two frames of one position.

    Light of a source that moves appears at one pixel and vanishes at its neighbour; a lamp changes everywhere.
    """
    total = float(before.sum())
    change = data - (float(data.sum()) / total if total > 0 else 1.0) * before
    padded = np.pad(np.abs(change), 1)
    rows, columns = change.shape
    others = [(dy, dx) for dy in range(3) for dx in range(3) if (dy, dx) != (1, 1)]
    near = np.maximum.reduce([padded[dy : dy + rows, dx : dx + columns] for dy, dx in others])
    found: NDArray[np.bool_] = (change > limit) & (change > ALONE * near)
    # many pixels at once mean that the light changed
    return found if found.sum() <= FEW_HOT else np.zeros_like(found)


class HotPixels:
    """Hot pixels of the dark frames.

    Their signal is not light of the source, and assembly subtracts it.

    Parameters
    ----------
    full
        Largest sample value of the sensor.
    """

    def __init__(self, full: float) -> None:
        self._full = full
        self._known: dict[float, tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]] = {}

    def learn(self, row: int, column: int, exposure_s: float, frame: NDArray[Any]) -> None:
        """Find hot pixels in a dark frame whose first pixel is at this row and column of the sensor."""
        level = float(np.median(frame))
        noise = 1.4826 * float(np.median(np.abs(frame - level)))
        rows, columns = np.nonzero(frame > level + max(HOT_SIGMAS * noise, HOT_SHARE * self._full))
        if len(rows) > MANY:
            rows = columns = rows[:0]
        self._known[exposure_s] = rows + row, columns + column, frame[rows, columns] - level

    def within(self, row: int, column: int, exposure_s: float, shape: tuple[int, int]) -> float:
        """Return the total signal (counts) of the hot pixels in a region of the sensor, for this exposure."""
        rows, columns, counts = self._known.get(exposure_s, (None, None, None))
        if rows is None or columns is None or counts is None or not len(rows):
            return 0.0
        inside = (rows >= row) & (rows < row + shape[0]) & (columns >= column) & (columns < column + shape[1])
        return float(counts[inside].sum())
