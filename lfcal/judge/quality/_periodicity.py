"""Accuracy of the tiling: control frames over the field compared with the same position in the cell.

The patterns of one cell represent the whole field exactly only if the lens is telecentric (Eberhart, section 2.1).
Frames recorded whole periods away show the deviation, and the period that would fit there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError

__all__ = ["Periodicity", "periodicity"]


@dataclass(frozen=True, slots=True, eq=False)
class Periodicity:
    """Comparison of n control frames with the cell of a plane.

    Attributes
    ----------
    positions
        Position (row, column) of the source's image on the sensor (px), ``(n, 2)``.
    away
        Distance (y, x) from the cell, in whole periods, ``(n, 2)``.
    difference
        Difference from the pattern at the same position of the cell, sqrt(1 - correlation²), from 0 to 1, ``(n,)``.
    best
        The same difference from the pattern at the best-fitting position of the cell, ``(n,)``.
    shift
        Best-fitting minus nominal position (y, x) (px), ``(n, 2)``.
    period
        Period (y, x) for which the best-fitting position would be the nominal one (px), ``(n, 2)``; NaN along an axis
        without displacement.

    Examples
    --------
    >>> from lfcal.psf import open_psf
    >>> from lfcal.judge.quality import Periodicity, periodicity
    >>> with open_psf("H.h5") as H:  # 33 pixels to the right, as at x = 6, not 5
    ...     found: Periodicity = periodicity([H[0, 3, 6]], [(3, 5 + 33)], H.plane(0))
    >>> print(found.shift.round().tolist(), round(found.fitting_period[1]), "px would fit")
    [[0.0, 1.0]] 32 px would fit
    """

    positions: NDArray[np.float64]
    away: NDArray[np.intp]
    difference: NDArray[np.float64]
    best: NDArray[np.float64]
    shift: NDArray[np.float64]
    period: NDArray[np.float64]

    @property
    def fitting_period(self) -> tuple[float, float]:
        """Median over the field of the best-fitting period (y, x) (px); NaN where unknown."""
        known = [column[np.isfinite(column)] for column in self.period.T]
        y, x = (float(np.median(k)) if k.size else float("nan") for k in known)
        return y, x


def periodicity(
    control_frames: ArrayLike,
    positions: ArrayLike,
    plane: NDArray[Any],
    *,
    anchor: tuple[float, float] = (0.0, 0.0),
    search: int = 3,
) -> Periodicity:
    """Compare control frames with the cell of their depth plane.

    Parameters
    ----------
    control_frames
        Dark-subtracted patterns, cut out around the source's image like the patterns of H, ``(n, nt, ns)``.
    positions
        Position (row, column) of the source's image on the sensor in each frame (px), ``(n, 2)``.
    plane
        Depth plane of H in which they were recorded, ``(ny, nx, nt, ns)``; read on demand.
    anchor
        Sensor position (row, column) onto which source position (0, 0) is imaged (px).
    search
        Search range around the nominal position of a frame (px).

    Raises
    ------
    InputError
        If the shapes of the arguments do not match.

    Examples
    --------
    >>> from lfcal.psf import open_psf
    >>> from lfcal.judge.quality import periodicity
    >>> with open_psf("H.h5") as H:  # the same pattern one period (33 pixels) to the right
    ...     found = periodicity([H[0, 3, 5]], [(3, 5 + 33)], H.plane(0))
    >>> print(found.away.tolist(), found.difference.round(3).tolist())
    [[0, 1]] [0.0]
    """
    frames, places = np.asarray(control_frames, np.float64), np.asarray(positions, np.float64)
    if frames.ndim != 3 or frames.shape[1:] != plane.shape[2:] or places.shape != (len(frames), 2):
        raise InputError.expected(
            "control frames",
            f"n frames of {plane.shape[2]} x {plane.shape[3]} pixels and n positions",
            f"{frames.shape} and {places.shape}",
            "make their cutouts like those of H",
        )
    size = np.array(plane.shape[:2])
    steps = np.round(places - np.array(anchor)).astype(np.intp)
    # floor division: a frame in front of the cell is -1 periods away, not 0
    index, away = steps % size, steps // size
    difference, best = np.empty(len(frames)), np.empty(len(frames))
    shift = np.zeros((len(frames), 2))
    for n, frame in enumerate(frames):
        squares = _around(frame, plane, index[n], search)
        difference[n] = np.sqrt(squares[search, search])
        shift[n], lowest = _lowest(squares, search)
        best[n] = np.sqrt(lowest)
    with np.errstate(divide="ignore", invalid="ignore"):
        period = np.where(away == 0, np.nan, size - shift / away)
    return Periodicity(places, away, difference, best, shift, period)


def _around(frame: NDArray[np.float64], plane: NDArray[Any], index: NDArray[np.intp], search: int) -> NDArray[Any]:
    """Return the squared difference from the positions around ``index``, ``(2 search + 1, 2 search + 1)``."""
    ny, nx = plane.shape[:2]
    reach = range(-search, search + 1)
    level = _dark(frame)
    a = frame - level
    norm = float((a * a).sum())
    out = np.ones((len(reach), len(reach)))
    for i, dy in enumerate(reach):
        for j, dx in enumerate(reach):
            b = np.asarray(plane[(index[0] + dy) % ny, (index[1] + dx) % nx], np.float64)
            b = b - _dark(b)
            # the normalised correlation is independent of brightness: control frames may have another exposure
            product, other = float((a * b).sum()), float((b * b).sum())
            if norm > 0 and other > 0 and product > 0:
                out[i, j] = max(0.0, 1.0 - product * product / (norm * other))
    return out


def _dark(frame: NDArray[np.float64]) -> float:
    """Return the level of the corners of a frame."""
    # only the corners: the background must not include light of the pattern
    n = max(1, round(0.06 * min(frame.shape)))
    return float(np.median([frame[:n, :n], frame[:n, -n:], frame[-n:, :n], frame[-n:, -n:]]))


def _lowest(squares: NDArray[np.float64], search: int) -> tuple[NDArray[np.float64], float]:
    """Return the position and value of the smallest squared difference, from a parabola through the neighbours."""
    top = 2 * search
    i, j = (int(k) for k in np.unravel_index(int(np.argmin(squares)), squares.shape))
    place = np.array([i - search, j - search], np.float64)
    lowest = float(squares[i, j])
    if search == 0:
        return place, lowest
    gain = 0.0
    # near the border of the search, the parabola uses the last three values
    for axis, k in ((0, min(max(i, 1), top - 1)), (1, min(max(j, 1), top - 1))):
        line = squares[k - 1 : k + 2, j] if axis == 0 else squares[i, k - 1 : k + 2]
        bend = float(line[0] - 2 * line[1] + line[2])  # squares instead of roots: these are a parabola near zero
        if bend > 0:
            offset = float(np.clip((line[0] - line[2]) / (2 * bend), -1, 1))
            place[axis] = k - search + offset
            gain += bend * offset**2 / 2
    return place, max(0.0, lowest - gain)
