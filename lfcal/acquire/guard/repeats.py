"""Frames with the content of an earlier exposure: a buffer handed out again, whole or in part, under a new number."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.guard._kernels import count_lit, same_rows
from lfcal.acquire.guard.doubts import NO_DOUBT, Doubt
from lfcal.acquire.recording import Suspicion, frame_crc
from lfcal.frames import Position

__all__ = ["FramePlace", "Repeats", "RowSample"]

SAMPLES = 1 << 14
"""So many samples of a frame are compared, whole rows of it: noise repeats in none of them."""
BUFFERS = 8
"""Torn frames are looked for among so many earlier exposures: as many as drivers have buffers."""
FEW = 16
"""So many lit samples must be equal. Where no light is, frames of a sensor without noise may well be the same."""


class FramePlace(NamedTuple):
    """Where a frame was taken: the plan's position and whole periods (y, x) away from it."""

    position: Position
    periods: tuple[int, int] = (0, 0)


class RowSample(NamedTuple):
    """Rows of one exposure, their CRC-32, the bytes of the first and the last of them, and where it was taken."""

    place: FramePlace
    rows: NDArray[Any]
    crc: int
    edges: tuple[bytes, bytes]


class Repeats:
    """The content of every exposure so far, as checksums, and of the latest ones, as samples.

    Content is compared in sensor coordinates, of different places only: a source that moved makes another image even
    for a sensor without noise, and at one place it may make the same.

    Parameters
    ----------
    ceiling
        Sample value of a saturated pixel.
    recorded
        CRC-32 of the frames that earlier runs of the session kept, with their positions.
    """

    def __init__(self, ceiling: float, recorded: Mapping[int, Position] | None = None) -> None:
        self._ceiling = ceiling
        self._seen: dict[int, FramePlace] = {}
        self._recorded = recorded or {}
        self._latest: deque[RowSample] = deque(maxlen=BUFFERS)

    def look(
        self, place: FramePlace, raws: Iterable[NDArray[Any]], floor: float
    ) -> tuple[Doubt, tuple[RowSample, ...]]:
        """Return the doubt about the exposures ``raws`` of ``place``, and what `remember` takes of them.

        Parameters
        ----------
        place
            Where they were taken.
        raws
            ``(rows, columns)`` each, the same region of the sensor for every frame.
        floor
            What exceeds it is light (counts).
        """
        doubt, samples = NO_DOUBT, []
        for raw in raws:
            # one array in memory: its rows may be those of a larger region
            rows = np.ascontiguousarray(raw[:: math.ceil(raw.size / SAMPLES)])
            sample = RowSample(place, rows, frame_crc(rows.data), (rows[0].tobytes(), rows[-1].tobytes()))
            samples.append(sample)
            if not doubt:
                doubt = self._whole(sample, floor) or self._part(sample, floor) or NO_DOUBT
        return doubt, tuple(samples)

    def remember(self, samples: Iterable[RowSample]) -> None:
        """Hold later exposures against these; what was taken at a wrong place must not be among them."""
        for sample in samples:
            self._seen.setdefault(sample.crc, sample.place)
            self._latest.append(sample)

    def kept(self, position: Position, frame: NDArray[Any], noise: float, floor: float) -> Doubt:
        """Return the doubt about a frame to be kept, against those that earlier runs of the session kept.

        Of those only checksums of the cutouts are left, which move along with the source: without noise frames of
        different places may be equal.
        """
        if not self._recorded or noise <= 0:
            return NO_DOUBT
        other = self._recorded.get(frame_crc(frame.data), position)
        if other == position or count_lit(frame, floor, self._ceiling) < FEW:
            return NO_DOUBT
        return _repeated(other)

    def _whole(self, sample: RowSample, floor: float) -> Doubt | None:
        other = self._seen.get(sample.crc, sample.place)
        if other == sample.place or count_lit(sample.rows, floor, self._ceiling) < FEW:
            return None
        return _repeated(other.position)

    def _part(self, sample: RowSample, floor: float) -> Doubt | None:
        rows, n = sample.rows, len(sample.rows)
        for place, earlier, _, edges in self._latest:
            # with noise the outermost rows hardly ever agree: that is soon seen
            if edges[0] != sample.edges[0] and edges[1] != sample.edges[1]:
                continue
            if place == sample.place or earlier.shape != rows.shape or earlier.dtype != rows.dtype:
                continue
            top, bottom = same_rows(rows, earlier)
            for count, part in ((top, rows[:top]), (bottom, rows[n - bottom :])):
                if count and count_lit(part, floor, self._ceiling) >= FEW:
                    got = f"{100 * count / n:.0f} % of its rows as at (z, y, x) = {tuple(place.position)}"
                    why = f"frame: expected one exposure, got {got}; the camera mixes its buffers"
                    return Doubt(Suspicion.TORN, (why,))
        return None


def _repeated(position: Position) -> Doubt:
    got = f"that of (z, y, x) = {tuple(position)} again"
    return Doubt(Suspicion.REPEATED, (f"frame: expected new content, got {got}; the camera repeats a buffer",))
