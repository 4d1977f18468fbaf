"""Find defect pixels over the frames: they stay where they are while the spots move."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, check_number, drained, for_each_chunk
from lfcal.frames.cfa import pattern_side, same_colour_offsets
from lfcal.frames.corrections import _kernels
from lfcal.frames.corrections.defects import Defects
from lfcal.frames.source import FrameSource

__all__ = ["find_defects", "iter_find_defects"]

NEIGHBOURS = 8
OUTLIERS = 2
"""Neighbours that may be defect themselves without hiding a pixel."""

CONTRAST = 0.5
"""A hot pixel stands out from its neighbours by this share of what they stand out from the field."""

PERSISTENCE = 0.5
"""A hot pixel stands out in this share of the frames; the peak of a spot passes by."""

RESPONSE = 0.1
"""A pixel whose values span less than this share of its neighbours' does not respond."""

ENCLOSED = 3.0
"""It must have been enclosed by light of this many times its own span, in one frame, to count as dead."""

MIN_FRAMES_HOT = 3
MIN_FRAMES_RESPONSE = 8


def iter_find_defects(
    source: FrameSource, *, frames: int = 64, threshold: float = 8.0, workers: int | None = None
) -> Work[Defects]:
    """Find hot, dead and stuck pixels from the values of each pixel over the frames.

    *Hot*: even its lowest value exceeds that of all but two of its eight nearest same-colour neighbours by
    ``threshold`` robust standard deviations and by half of what those stand out from the field, and it stands out
    in half of the frames. *Dead* and *stuck*: its values span less than a tenth of what all but two neighbours
    span, and in some frame a spot lay around it; a dead one stays at their lowest. Dead and stuck pixels need 8
    frames, and only show where spots cover them. Frames of different positions are needed, or several dark frames;
    those of one position would show the spots as hot pixels. Frames are read twice if there is anything suspect.

    Parameters
    ----------
    source
        Raw or dark-corrected frames; the colour filter is taken from its metadata.
    frames
        Frames read at most, evenly spread.
    threshold
        Standard deviations of the differences to the neighbours.
    workers
        Threads; None takes all processors.

    Raises
    ------
    InputError
        If there are fewer than 3 frames, or more than 5 % of the pixels look defect.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, iter_find_defects
    >>> darks = np.full((3, 16, 16), 20)
    >>> darks[:, 4, 7] = 200
    >>> for step in iter_find_defects(ArraySource(darks, [(0, 0, k) for k in range(3)])):
    ...     print(step.count, "reads", step.note)
    1 of 6 reads
    2 of 6 reads
    3 of 6 reads
    4 of 6 reads
    5 of 6 reads
    6 of 6 reads 1 defect pixels
    """
    check_number("frames to search", frames, at_least=MIN_FRAMES_HOT, integer=True)
    check_number("threshold (standard deviations)", threshold, above=0)
    if len(source) < MIN_FRAMES_HOT:
        raise InputError.expected(
            "frames to find defects in", f"at least {MIN_FRAMES_HOT}", len(source), "record more frames"
        )
    # spread over the whole scan, so that the spots move between the frames read
    chosen = np.unique(np.linspace(0, len(source) - 1, frames).round().astype(int)).tolist()
    clock = Clock("find defect pixels", 2 * len(chosen))
    low = source.read(chosen[0])
    high = low.copy()
    for done, index in enumerate(chosen[1:], 1):
        yield clock.at(done)
        frame = source.read(index)
        # fmin and fmax skip NaN: a pixel masked in one frame is judged by the others
        np.fmin(low, frame, out=low)
        np.fmax(high, frame, out=high)
    suspects = _Suspects(low, high, len(chosen), source.metadata.cfa, threshold, workers)
    for done, index in enumerate(chosen if len(suspects) else [], len(chosen)):
        yield clock.at(done)
        suspects.look_at(source.read(index))
    defects = suspects.verdict(source.shape)
    yield clock.at(2 * len(chosen), f"{len(defects)} defect pixels")
    return defects


find_defects = drained(
    iter_find_defects,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, find_defects
    >>> darks = np.full((3, 16, 16), 20)
    >>> darks[:, 4, 7] = 200
    >>> found = find_defects(ArraySource(darks, [(0, 0, k) for k in range(3)]))
    >>> print(found.pixels.tolist(), found.kinds)
    [[4, 7]] ('hot',)
    """,
)


class _Suspects:
    """Pixels that the lowest and highest values make suspect, judged by how they do in single frames.

    Parameters
    ----------
    low, high
        Lowest and highest value of each pixel over the ``count`` frames.
    cfa, threshold, workers
        As in `iter_find_defects`.
    """

    def __init__(
        self, low: NDArray[Any], high: NDArray[Any], count: int, cfa: str, threshold: float, workers: int | None
    ) -> None:
        self._cfa, self._count = cfa, count
        self._offsets = nearest_offsets(cfa)
        whole_numbers = low.dtype.kind in "iu"
        low = low.astype(np.float32)
        span = high.astype(np.float32) - low
        noise = _noise(low, self._offsets.shape[0], whole_numbers)
        hot = self._stands_out(low, threshold * noise, workers)
        deaf = np.zeros_like(hot)
        if count >= MIN_FRAMES_RESPONSE:
            around = self._rank(span, OUTLIERS, workers)
            # where its neighbours show no light either, a pixel cannot be said not to respond
            deaf = (span < RESPONSE * around) & (around > threshold * noise)
        self._pixels = np.argwhere(hot | deaf)
        at = tuple(self._pixels.T)
        base = self._rank(low, NEIGHBOURS // 2, workers)[at]
        self._hot, self._deaf = hot[at], deaf[at]
        self._low_there = low[at] <= base + threshold * noise
        self._margin = threshold / 2 * noise
        self._light = base + np.maximum(threshold * noise, ENCLOSED * span[at])
        self._standing = np.zeros(len(self._pixels), np.intp)
        self._enclosed = np.zeros(len(self._pixels), bool)

    def __len__(self) -> int:
        return len(self._pixels)

    def _rank(self, image: NDArray[np.float32], rank: int, workers: int | None) -> NDArray[np.float32]:
        out = np.empty_like(image)

        def rows(start: int, stop: int) -> None:
            _kernels.neighbour_of_rank(image, self._offsets, rank, start, stop, out)

        for_each_chunk(rows, image.shape[0], workers)
        return out

    def _stands_out(self, low: NDArray[np.float32], least: float, workers: int | None) -> NDArray[np.bool_]:
        # of eight sorted neighbours, two may be hot themselves
        upper = self._rank(low, NEIGHBOURS - 1 - OUTLIERS, workers)
        # next to a static bright object, a pixel must also exceed what its neighbours exceed the field by
        field = np.nanmedian(_sample(low))
        out: NDArray[np.bool_] = low - upper > np.maximum(least, CONTRAST * (upper - field))
        return out

    def look_at(self, frame: NDArray[Any]) -> None:
        """Note which suspects stand out in ``frame``, and which lie within a spot."""
        rows, columns = self._pixels.T
        side = self._offsets.shape[0]
        near = self._pixels[:, None, :] + self._offsets[rows % side, columns % side]
        there = np.all((near >= 0) & (near < np.array(frame.shape)), axis=2)
        near = np.where(there[..., None], near, 0)
        values = frame[near[..., 0], near[..., 1]].astype(np.float32)
        # at the sensor's edge fewer neighbours are there, and none of them may be left out
        inner = there.all(axis=1)
        falling = np.sort(np.where(there, values, -np.inf), axis=1)[:, ::-1]
        rising = np.sort(np.where(there, values, np.inf), axis=1)
        self._standing += frame[rows, columns] - np.where(inner, falling[:, OUTLIERS], falling[:, 0]) > self._margin
        self._enclosed |= np.where(inner, rising[:, OUTLIERS], rising[:, 0]) > self._light

    def verdict(self, shape: tuple[int, int]) -> Defects:
        """Return those that the frames confirm."""
        hot = self._hot & (self._standing >= PERSISTENCE * self._count)
        deaf = self._deaf & self._enclosed
        names = np.where(deaf, np.where(self._low_there, "dead", "stuck"), "hot")
        sure = hot | deaf
        return Defects(self._pixels[sure], shape, self._cfa, tuple(names[sure].tolist()))


def nearest_offsets(cfa: str) -> NDArray[np.int32]:
    """Return the eight nearest same-colour neighbours of each pattern position, shape ``(side, side, 8, 2)``."""
    side = pattern_side(cfa)
    table = same_colour_offsets(cfa)
    return np.array([[np.concatenate(table[r][c])[:NEIGHBOURS] for c in range(side)] for r in range(side)], np.int32)


def _sample(values: NDArray[np.float32], most: int = 1_000_000) -> NDArray[np.float32]:
    # a million values fix a median well below the noise, at a hundredth of the time
    return values.ravel()[:: 1 + values.size // most]


def _noise(low: NDArray[np.float32], step: int, whole_numbers: bool) -> float:
    """Return the robust standard deviation of a pixel from its neighbour ``step`` away, with a floor."""
    some = _sample(low[:, step:] - low[:, :-step])
    # the difference of two pixels has sqrt(2) times the noise of one; integers have at least half a count of rounding
    sigma = 1.4826 * float(np.nanmedian(np.abs(some - np.nanmedian(some)))) / np.sqrt(2) if some.size else 0.0
    return max(sigma, 0.5 if whole_numbers else 1e-6 * float(np.nanmax(np.abs(low))))
