"""Defective pixels: their positions on the sensor, their detection from many frames, and their repair."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Work, check_number, drained, for_each_chunk, format_pixels
from lfcal.frames.cfa import check_cfa, pattern_side, same_colour_offsets
from lfcal.frames.corrections import _kernels
from lfcal.frames.corrections.steps import fingerprint
from lfcal.frames.source import FrameSource

__all__ = ["Defects", "find_defects", "iter_find_defects", "nearest_good", "repair_nan"]

MAX_SHARE = 0.05
"""Largest fraction of defective pixels; more means that the search has failed."""


@dataclass(frozen=True, eq=False)
class Defects:
    """Correction that replaces each defective pixel by the mean of its nearest good neighbours of the same colour.

    Defects are listed in sensor coordinates. A repair is linear in the frame. Pixels of a floating-point frame that the
    reader has set to NaN need not be listed. They are also repaired if a neighbour within one period of the colour
    filter pattern is good.

    Attributes
    ----------
    pixels
        Row and column of each defect on the sensor, ``(n, 2)``. They are sorted in row-major order, and duplicates are
        removed.
    shape
        Shape ``(rows, columns)`` of the sensor (px).
    cfa
        Colour filter pattern in row-major order, such as ``"RGGB"``; empty for monochrome frames.
    kinds
        Kind of each defect: ``"hot"``, ``"dead"``, ``"stuck"`` or ``"listed"``; empty if unknown.
    neighbours, margin
        Row and column of up to m neighbours used for each defect, ``(n, m, 2)``, padded with -1; and the width of the
        margin needed around a region to repair it (px). This width is the largest distance of a neighbour plus one
        period of the pattern. Both are computed.

    Raises
    ------
    InputError
        If a pixel is outside the sensor, or has no good neighbour of its colour within two periods of the pattern. Also
        if more than 5 % of the sensor is defective (a single defect is always allowed). Also if the number of ``kinds``
        is neither 0 nor that of the pixels.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import CorrectionChain, Defects
    >>> frame = np.arange(16, dtype=np.uint16).reshape(4, 4)
    >>> frame[1, 1] = 4095
    >>> chain = CorrectionChain((Defects([(1, 1)], shape=(4, 4)),))
    >>> chain.apply(frame)[1].tolist()
    [4.0, 5.0, 6.0, 7.0]
    """

    pixels: ArrayLike = field(repr=False)
    shape: tuple[int, int]
    cfa: str = ""
    kinds: tuple[str, ...] = field(default=(), repr=False)
    neighbours: NDArray[np.int32] = field(init=False, repr=False)
    margin: int = field(init=False)

    def __post_init__(self) -> None:
        """Check and sort the pixels and find their neighbours."""
        check_cfa(self.cfa)
        pixels = np.asarray(self.pixels, np.int64).reshape(-1, 2)
        if self.kinds and len(self.kinds) != len(pixels):
            raise InputError.expected(
                "kinds of defects",
                f"as many as defective pixels ({len(pixels)})",
                len(self.kinds),
                "give one kind for each pixel",
            )
        if pixels.size and (pixels.min() < 0 or (pixels >= np.array(self.shape)).any()):
            raise InputError.expected(
                "defect pixels",
                f"pixels on the sensor of {format_pixels(self.shape)}",
                "rows {} to {}, columns {} to {}".format(*np.stack([pixels.min(0), pixels.max(0)], 1).ravel().tolist()),
                "check rows and columns",
            )
        # row-major numbers sort the pixels and drop repeated ones in one go
        flat, first = np.unique(pixels[:, 0] * self.shape[1] + pixels[:, 1], return_index=True)
        # a small sensor may have one defect, even if that exceeds the share
        if len(flat) > max(1, MAX_SHARE * self.shape[0] * self.shape[1]):
            raise InputError.expected(
                "defect pixels",
                f"at most {100 * MAX_SHARE:g} % of the sensor",
                f"{100 * len(flat) / (self.shape[0] * self.shape[1]):.3g} %",
                "raise the threshold, give frames between which the spots move, or mask large areas (--mask)",
            )
        chosen = np.ascontiguousarray(pixels[first], np.int32)
        object.__setattr__(self, "pixels", chosen)
        object.__setattr__(self, "kinds", tuple(self.kinds[k] for k in first) if self.kinds else ())
        neighbours = self._find_neighbours(chosen)
        object.__setattr__(self, "neighbours", neighbours)
        reach = np.abs(neighbours - chosen[:, None, :])[neighbours[..., 0] >= 0]
        # plus the pattern's side, because a NaN one period away is repaired as well
        object.__setattr__(self, "margin", int(reach.max(initial=0)) + pattern_side(self.cfa))

    def _find_neighbours(self, pixels: NDArray[np.int32]) -> NDArray[np.int32]:
        bad = np.zeros(self.shape, bool)
        bad[pixels[:, 0], pixels[:, 1]] = True
        found = nearest_good(pixels, bad, self.cfa)
        alone = np.flatnonzero((found[..., 0] < 0).all(axis=1))
        if alone.size:
            r, c = (int(v) for v in pixels[alone[0]])
            raise InputError.expected(
                f"defect pixel ({r}, {c})",
                "a good neighbour of its colour",
                "only defective ones within two periods of the colour pattern",
                "such a cluster cannot be repaired; mask it (--mask)",
            )
        return found

    def __len__(self) -> int:
        """Return the number of defect pixels."""
        return int(self.neighbours.shape[0])

    def mask(self) -> NDArray[np.bool_]:
        """Return a mask of the sensor, ``(rows, columns)``, True at the defects."""
        mask = np.zeros(self.shape, bool)
        pixels = np.asarray(self.pixels)
        mask[pixels[:, 0], pixels[:, 1]] = True
        return mask

    def describe(self) -> dict[str, Any]:
        """Return a JSON-compatible description of the step, for provenance."""
        return {
            "kind": "defects",
            "count": len(self),
            "cfa": self.cfa,
            **{name: self.kinds.count(name) for name in sorted(set(self.kinds))},
            "crc32": fingerprint(np.asarray(self.pixels)),
        }


def nearest_good(
    pixels: NDArray[np.int32], bad: NDArray[np.bool_], cfa: str, *, origin: tuple[int, int] = (0, 0), reach: int = 2
) -> NDArray[np.int32]:
    """Return, for each pixel, the good pixels of the nearest ring of same-colour neighbours that contains any.

    Parameters
    ----------
    pixels
        Rows and columns in ``bad``, shape ``(n, 2)``.
    bad
        Boolean map ``(rows, columns)``, true at the pixels that must not be used.
    cfa
        Colour filter pattern in row-major order.
    origin
        Sensor coordinates of the first pixel of ``bad``.
    reach
        Largest distance of a neighbour along each axis, in periods of the pattern.

    Returns
    -------
    NDArray
        Rows and columns of the neighbours in ``bad``, shape ``(n, m, 2)``, padded with -1. All are -1 for a pixel
        without a good neighbour.
    """
    side = pattern_side(cfa)
    table = same_colour_offsets(cfa, reach)
    most = max(len(ring) for line in table for rings in line for ring in rings)
    found = np.full((len(pixels), most, 2), -1, np.int32)
    phase = (pixels + np.array(origin)) % side
    # pixels of one phase of the pattern share their rings, so they are looked up together
    for pr, pc in np.ndindex(side, side):
        todo = np.flatnonzero((phase[:, 0] == pr) & (phase[:, 1] == pc))
        for ring in table[pr][pc]:
            if not todo.size:
                break
            near = pixels[todo, None, :] + ring[None]
            good: NDArray[np.bool_] = np.all((near >= 0) & (near < np.array(bad.shape)), axis=2)
            # an index outside the map would wrap around; (0, 0) replaces it, and stays marked as not good
            inside = np.where(good[..., None], near, 0)
            good &= ~bad[inside[..., 0], inside[..., 1]]
            found[todo, : len(ring)] = np.where(good[..., None], near, -1)
            # pixels whose ring contains a good neighbour are done; the others try the next ring
            todo = todo[~good.any(axis=1)]
    return found


def repair_nan(values: NDArray[np.float32], origin: tuple[int, int], slopes: NDArray[np.float64], cfa: str) -> None:
    """Repair, in place, each NaN of a corrected region from its nearest neighbours of the same colour.

    The new value is the mean of the neighbours before the background was subtracted, minus the background at the pixel.
    ``slopes`` is this background, ``(level, per row, per column)``; zeros if none was subtracted. ``origin`` is the
    position (row, column) of the first pixel of ``values`` on the sensor. Pixels without a good neighbour within one
    period of the colour pattern stay NaN.
    """
    bad = np.isnan(values)
    if not bad.any():
        return
    pixels = np.ascontiguousarray(np.argwhere(bad), np.int32)
    neighbours = nearest_good(pixels, bad, cfa, origin=origin, reach=1)
    _kernels.repair_pixels(values, 0, 0, slopes, pixels, neighbours)


NEIGHBOURS = 8
OUTLIERS = 2
"""Number of neighbours that may be defective themselves without hiding a pixel."""

CONTRAST = 0.5
"""A hot pixel exceeds its neighbours by at least this fraction of the amount by which they exceed the median."""

PERSISTENCE = 0.5
"""Fraction of the frames in which a hot pixel must stand out; the peak of a spot moves on to other pixels."""

RESPONSE = 0.1
"""A pixel whose range of values is below this fraction of its neighbours' range does not respond."""

ENCLOSED = 3.0
"""In one frame, the light around a dead or stuck pixel must be at least this many times the pixel's own range."""

MIN_FRAMES_HOT = 3
MIN_FRAMES_RESPONSE = 8


def iter_find_defects(
    source: FrameSource,
    *,
    frames: int = 64,
    threshold: float = 8.0,
    ignore: NDArray[np.bool_] | None = None,
    workers: int | None = None,
) -> Work[Defects]:
    """Find hot, dead and stuck pixels from the values of each pixel over the frames.

    Each pixel is compared with its eight nearest neighbours of the same colour, of which two may be defective. The
    lowest value of a *hot* pixel over the frames exceeds those of these neighbours by ``threshold`` robust standard
    deviations. It also exceeds them by at least half of the amount by which they exceed the median over all pixels. In
    addition, a hot pixel is brighter than its neighbours in at least half of the frames. A pixel is *dead* or *stuck*
    if a spot surrounded it in some frame, but its values vary by less than a tenth of the range of its neighbours. A
    dead pixel remains at the level without light. Dead and stuck pixels are found only in 8 or more frames, and only
    where spots cover them. Use frames of different positions, or several dark frames: in frames of a single position,
    spots would look like hot pixels. Frames are read a second time if any pixel is suspect.

    Parameters
    ----------
    source
        Raw or dark-corrected frames; their metadata state the colour filter pattern.
    frames
        Largest number of frames to read, evenly spread over the source.
    threshold
        Threshold for hot pixels, in robust standard deviations of a pixel, which are estimated from the differences
        between pixels of the same colour.
    ignore
        Mask ``(rows, columns)``, True at pixels that are not examined. None: all pixels are examined.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    InputError
        If there are fewer than 3 frames, or the defective pixels found cannot be repaired (see `Defects`).

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
        # fmin and fmax skip NaN: a pixel masked in one frame is judged from the others
        np.fmin(low, frame, out=low)
        np.fmax(high, frame, out=high)
    suspects = _Suspects(low, high, len(chosen), source.metadata.cfa, threshold, workers, ignore=ignore)
    for done, index in enumerate(chosen if len(suspects) else [], len(chosen)):
        yield clock.at(done)
        suspects.add_frame(source.read(index))
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
    """Pixels with suspect lowest and highest values, checked in single frames.

    Parameters
    ----------
    low, high
        Lowest and highest value of each pixel over the ``count`` frames.
    cfa, threshold, workers, ignore
        As in `iter_find_defects`.
    """

    def __init__(
        self,
        low: NDArray[Any],
        high: NDArray[Any],
        count: int,
        cfa: str,
        threshold: float,
        workers: int | None,
        *,
        ignore: NDArray[np.bool_] | None = None,
    ) -> None:
        self._cfa, self._count = cfa, count
        self._offsets = nearest_offsets(cfa)
        whole_numbers = low.dtype.kind in "iu"
        low = low.astype(np.float32)
        span = high.astype(np.float32) - low
        noise = _noise(low, self._offsets.shape[0], whole_numbers)
        hot = self._is_outlier(low, threshold * noise, workers)
        unresponsive = np.zeros_like(hot)
        if count >= MIN_FRAMES_RESPONSE:
            around = self._rank(span, OUTLIERS, workers)
            # without light on its neighbours, a pixel cannot be said to be unresponsive
            unresponsive = (span < RESPONSE * around) & (around > threshold * noise)
        suspect = hot | unresponsive
        self._pixels = np.argwhere(suspect if ignore is None else suspect & ~ignore)
        at = tuple(self._pixels.T)
        base = self._rank(low, NEIGHBOURS // 2, workers)[at]
        self._hot, self._unresponsive = hot[at], unresponsive[at]
        self._low = low[at] <= base + threshold * noise
        self._margin = threshold / 2 * noise
        self._light = base + np.maximum(threshold * noise, ENCLOSED * span[at])
        self._outlier_frames = np.zeros(len(self._pixels), np.intp)
        self._enclosed = np.zeros(len(self._pixels), bool)

    def __len__(self) -> int:
        return len(self._pixels)

    def _rank(self, image: NDArray[np.float32], rank: int, workers: int | None) -> NDArray[np.float32]:
        out = np.empty_like(image)

        def rows(start: int, stop: int) -> None:
            _kernels.neighbour_of_rank(image, self._offsets, rank, start, stop, out)

        for_each_chunk(rows, image.shape[0], workers)
        return out

    def _is_outlier(self, low: NDArray[np.float32], least: float, workers: int | None) -> NDArray[np.bool_]:
        # of eight sorted neighbours, two may be hot themselves
        upper = self._rank(low, NEIGHBOURS - 1 - OUTLIERS, workers)
        # next to a static bright object, a pixel must also exceed its neighbours' difference from the field
        field = np.nanmedian(_sample(low))
        out: NDArray[np.bool_] = low - upper > np.maximum(least, CONTRAST * (upper - field))
        return out

    def add_frame(self, frame: NDArray[Any]) -> None:
        """Record which suspects stand out in ``frame``, and which are within a spot."""
        rows, columns = self._pixels.T
        side = self._offsets.shape[0]
        near = self._pixels[:, None, :] + self._offsets[rows % side, columns % side]
        there = np.all((near >= 0) & (near < np.array(frame.shape)), axis=2)
        near = np.where(there[..., None], near, 0)
        values = frame[near[..., 0], near[..., 1]].astype(np.float32)
        # at the sensor's edge there are fewer neighbours, and none of them may be left out
        inner = there.all(axis=1)
        falling = np.sort(np.where(there, values, -np.inf), axis=1)[:, ::-1]
        rising = np.sort(np.where(there, values, np.inf), axis=1)
        self._outlier_frames += (
            frame[rows, columns] - np.where(inner, falling[:, OUTLIERS], falling[:, 0]) > self._margin
        )
        self._enclosed |= np.where(inner, rising[:, OUTLIERS], rising[:, 0]) > self._light

    def verdict(self, shape: tuple[int, int]) -> Defects:
        """Return the suspects that the frames confirm."""
        hot = self._hot & (self._outlier_frames >= PERSISTENCE * self._count)
        unresponsive = self._unresponsive & self._enclosed
        names = np.where(unresponsive, np.where(self._low, "dead", "stuck"), "hot")
        sure = hot | unresponsive
        return Defects(self._pixels[sure], shape, self._cfa, tuple(names[sure].tolist()))


def nearest_offsets(cfa: str) -> NDArray[np.int32]:
    """Return the offsets (row, column) of the eight nearest same-colour neighbours of each pattern position.

    The shape is ``(side, side, 8, 2)``, where ``side`` is the period of the pattern ``cfa`` in pixels.
    """
    side = pattern_side(cfa)
    table = same_colour_offsets(cfa)
    return np.array([[np.concatenate(table[r][c])[:NEIGHBOURS] for c in range(side)] for r in range(side)], np.int32)


def _sample(values: NDArray[np.float32], most: int = 1_000_000) -> NDArray[np.float32]:
    # a million values determine a median well below the noise, in a hundredth of the time
    return values.ravel()[:: 1 + values.size // most]


def _noise(low: NDArray[np.float32], step: int, whole_numbers: bool) -> float:
    """Return the robust standard deviation of a pixel, from pixels ``step`` columns apart; it is never 0."""
    some = _sample(low[:, step:] - low[:, :-step])
    # the difference of two pixels has sqrt(2) times the noise of one; integers have at least half a count of rounding
    sigma = 1.4826 * float(np.nanmedian(np.abs(some - np.nanmedian(some)))) / np.sqrt(2) if some.size else 0.0
    return max(sigma, 0.5 if whole_numbers else 1e-6 * float(np.nanmax(np.abs(low))))
