"""Find defect pixels over the frames: they stay where they are while the spots move."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.camera._checks import check_number
from lfcal.errors import InputError, expectation
from lfcal.frames import _kernels
from lfcal.frames.cfa import pattern_side, same_colour_offsets
from lfcal.frames.defects import Defects
from lfcal.frames.source import FrameSource
from lfcal.progress import Clock, Work, drain
from lfcal.threads import for_each_chunk

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

MIN_FRAMES_HOT = 3
MIN_FRAMES_RESPONSE = 8


def iter_find_defects(
    source: FrameSource, *, frames: int = 64, threshold: float = 8.0, workers: int | None = None
) -> Work[Defects]:
    """Find hot, dead and stuck pixels from the lowest and highest value of each over the frames.

    *Hot*: even its lowest value exceeds that of all but two of its eight nearest same-colour neighbours by
    ``threshold`` robust standard deviations and by half of what those stand out from the field, and it does so in
    half of the frames. *Dead* and *stuck*: its values span less than a tenth of what all but two neighbours span;
    a dead one stays at their lowest. Dead and stuck ones need 8 frames, and light. Frames of different positions
    are needed, or several dark frames; those of one position would show the spots as hot pixels.

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
    """
    check_number("frames to search", frames, at_least=MIN_FRAMES_HOT, integer=True)
    check_number("threshold (standard deviations)", threshold, above=0)
    if len(source) < MIN_FRAMES_HOT:
        raise InputError(
            expectation("frames to find defects in", f"at least {MIN_FRAMES_HOT}", len(source), "record more frames")
        )
    chosen = np.unique(np.linspace(0, len(source) - 1, frames).round().astype(int)).tolist()
    cfa = str(source.metadata.get("cfa", ""))
    clock = Clock("find defect pixels", len(chosen) + 1)
    search = _Search(cfa, threshold, workers)
    for done, index in enumerate(chosen):
        yield clock.at(done)
        search.add(source.read(index))
    yield clock.at(len(chosen))
    defects = search.result(source.shape)
    yield clock.at(len(chosen) + 1, f"{len(defects)} defect pixels")
    return defects


def find_defects(
    source: FrameSource, *, frames: int = 64, threshold: float = 8.0, workers: int | None = None
) -> Defects:
    """Return the hot, dead and stuck pixels of the sensor; see `iter_find_defects`."""
    return drain(iter_find_defects(source, frames=frames, threshold=threshold, workers=workers))


class _Search:
    """What is remembered of the frames: lowest and highest values, and how often candidates stand out."""

    def __init__(self, cfa: str, threshold: float, workers: int | None) -> None:
        self._cfa, self._threshold, self._workers = cfa, threshold, workers
        self._offsets = nearest_offsets(cfa)
        self._first: list[NDArray[Any]] = []
        self._count = 0
        self._pixels = np.zeros((0, 2), np.intp)
        self._standing = np.zeros(0, np.intp)

    def add(self, frame: NDArray[Any]) -> None:
        """Take one more frame."""
        self._count += 1
        if self._count == 1:
            self._low, self._high = frame.copy(), frame.copy()
        np.fmin(self._low, frame, out=self._low)
        np.fmax(self._high, frame, out=self._high)
        if self._count < MIN_FRAMES_HOT:
            self._first.append(frame)
        elif self._count == MIN_FRAMES_HOT:
            low = self._low.astype(np.float32)
            noise = self._noise(low)
            self._margin = self._threshold / 2 * noise
            self._pixels = np.argwhere(self._stands_out(low, noise, self._threshold / 2))
            self._standing = np.zeros(len(self._pixels), np.intp)
            for early in (*self._first, frame):
                self._follow(early)
            self._first.clear()
        else:
            self._follow(frame)

    def _follow(self, frame: NDArray[Any]) -> None:
        """Count the candidates that stand out in ``frame`` as well."""
        rows, columns = self._pixels.T
        side = self._offsets.shape[0]
        near = self._pixels[:, None, :] + self._offsets[rows % side, columns % side]
        there = np.all((near >= 0) & (near < np.array(frame.shape)), axis=2)
        near = np.where(there[..., None], near, 0)
        values = np.where(there, frame[near[..., 0], near[..., 1]].astype(np.float32), -np.inf)
        values.sort(axis=1)
        upper = np.where(there.all(axis=1), values[:, -1 - OUTLIERS], values[:, -1])
        self._standing += frame[rows, columns] - upper > self._margin

    def _noise(self, low: NDArray[np.float32]) -> float:
        """Return the robust standard deviation of the differences between horizontal neighbours, floored."""
        step = self._offsets.shape[0]
        some = _sample(low[:, step:] - low[:, :-step])
        sigma = 1.4826 * float(np.nanmedian(np.abs(some - np.nanmedian(some)))) / np.sqrt(2) if some.size else 0.0
        return max(sigma, 0.5 if self._low.dtype.kind in "iu" else 1e-6 * float(np.nanmax(np.abs(low))))

    def _rank(self, image: NDArray[np.float32], rank: int) -> NDArray[np.float32]:
        out = np.empty_like(image)

        def rows(start: int, stop: int) -> None:
            _kernels.neighbour_of_rank(image, self._offsets, rank, start, stop, out)

        for_each_chunk(rows, image.shape[0], self._workers)
        return out

    def _stands_out(self, low: NDArray[np.float32], noise: float, threshold: float) -> NDArray[np.bool_]:
        upper = self._rank(low, NEIGHBOURS - 1 - OUTLIERS)
        field = np.nanmedian(_sample(low))
        out: NDArray[np.bool_] = low - upper > np.maximum(threshold * noise, CONTRAST * (upper - field))
        return out

    def result(self, shape: tuple[int, int]) -> Defects:
        """Return the defects that the frames show."""
        low = self._low.astype(np.float32)
        noise = self._noise(low)
        lasting = np.zeros(shape, bool)
        rows, columns = self._pixels[self._standing >= PERSISTENCE * self._count].T
        lasting[rows, columns] = True
        hot = lasting & self._stands_out(low, noise, self._threshold)
        deaf = np.zeros(shape, bool)
        if self._count >= MIN_FRAMES_RESPONSE:
            span = self._high.astype(np.float32) - low
            around = self._rank(span, OUTLIERS)
            deaf = (span < RESPONSE * around) & (around > self._threshold * noise)
        lowest = self._rank(low, NEIGHBOURS // 2) + self._threshold * noise
        pixels = np.argwhere(hot | deaf)
        kinds = tuple(
            "hot" if not deaf[r, c] else "dead" if low[r, c] <= lowest[r, c] else "stuck" for r, c in pixels.tolist()
        )
        return Defects(pixels, shape, self._cfa, kinds)


def nearest_offsets(cfa: str) -> NDArray[np.int32]:
    """Return the eight nearest same-colour neighbours of each pattern position, shape ``(side, side, 8, 2)``."""
    side = pattern_side(cfa)
    table = same_colour_offsets(cfa)
    return np.array([[np.concatenate(table[r][c])[:NEIGHBOURS] for c in range(side)] for r in range(side)], np.int32)


def _sample(values: NDArray[np.float32], most: int = 1_000_000) -> NDArray[np.float32]:
    return values.ravel()[:: 1 + values.size // most]
