"""Read the frames of earlier runs of a session in the background."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.live_coverage import SAMPLE, LiveCoverage
from lfcal.acquire.live_quality import LiveQuality
from lfcal.acquire.recording import RECORD, RecordingFile
from lfcal.base import FileFormatError

__all__ = ["EarlierFrames", "EarlierRuns", "PlaneSum"]

SECONDS = 30.0
"""Longest time for reading the frames of one plane (s)."""
MEMORY = 1 << 28
"""Memory for depth sums (bytes)."""
SAMPLED = 8
"""Largest number of frames of a plane from which its background is sampled."""
SHOWN_S = 0.25
"""Time between two updates of the displayed sum (s)."""
GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True, eq=False)
class EarlierRuns:
    """Frames recorded by earlier runs of a session.

    Attributes
    ----------
    flat
        Flat indices ``(n,)`` of the recorded positions, or of the recorded frames of a target, in ``grid``.
    grid
        Shape of the grid of positions, ``(nz, ny, nx)``. For a target: ``(nz, 1, n)`` with the largest number n of
        frames in a plane.
    recordings
        Names of the recordings in the session's folder, oldest first.
    """

    flat: NDArray[np.intp]
    grid: tuple[int, int, int]
    recordings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class PlaneSum:
    """Background-subtracted sum of the cutouts of a plane, over the frames read so far.

    Attributes
    ----------
    light
        Sum of the cutouts, ``(rows, columns)`` (counts).
    read, total, damaged
        Numbers of frames of the plane: added to ``light`` so far, recorded in total, and unreadable so far.
    ended
        Whether reading has ended.
    """

    light: NDArray[np.float64]
    read: int
    total: int
    damaged: int = 0
    ended: bool = False

    @property
    def words(self) -> str:
        """Text on the progress of reading; empty once reading has ended and every recorded frame was added."""
        if not self.ended:
            return f"reading frame {self.read + self.damaged} of {self.total} …"
        return "" if self.read == self.total else f"{self.read} of {self.total} frames"


@dataclass(frozen=True, eq=False)
class _Frames:
    """The newest frames of positions: their file and slot in it, plane and record, each ``(n,)``."""

    files: list[RecordingFile]
    where: NDArray[np.intp]
    slots: NDArray[np.intp]
    planes: NDArray[np.intp]
    records: NDArray[Any]

    @classmethod
    def of(cls, files: list[RecordingFile], known: EarlierRuns) -> _Frames:
        grid = known.grid
        where, slots = np.full((2, grid[0] * grid[1] * grid[2]), -1, np.intp)
        for k, file in enumerate(files):  # oldest first, because the latest frame of a position counts
            held = np.flatnonzero(file.taken & (file.records["index"] < len(where)))
            flat = file.records["index"][held]
            where[flat], slots[flat] = k, held
        flat = known.flat[where[known.flat] >= 0]
        records = np.zeros(len(flat), RECORD)
        for k, file in enumerate(files):
            here = where[flat] == k
            records[here] = file.records[slots[flat[here]]]
        return cls(files, where[flat], slots[flat], flat // (grid[1] * grid[2]), records)

    def read(self, k: int) -> NDArray[Any] | None:
        """Return frame ``k``, or None if it is damaged."""
        try:
            frame: NDArray[Any] = self.files[self.where[k]].read(int(self.slots[k]))
        except FileFormatError:
            return None
        return frame


class EarlierFrames:
    """Reader of earlier runs that passes their records to ``quality``, and sums the frames of the displayed plane.

    The records are passed on first, with backgrounds from a few frames of each plane. If ``quality`` is a
    `LiveQuality`, the frames of the displayed plane are then added up for at most ``seconds``, in an order spread over
    the period. Sums of several planes are cached up to `MEMORY` bytes. `want` and `read` may be called from different
    threads.

    Parameters
    ----------
    folder, quality
        Folder of the session, and the object that receives its records.
    known
        Frames recorded by earlier runs; None if there are none.
    seconds, clock
        Longest time for reading a plane (s), and the function that returns the current time (s).
    """

    def __init__(
        self,
        folder: Path,
        quality: LiveQuality | LiveCoverage,
        known: EarlierRuns | None,
        *,
        seconds: float = SECONDS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._folder, self._quality, self._known = folder, quality, known
        self._seconds, self._clock = seconds, clock
        self._wanted = -1
        self._reported = False
        self._sums: dict[int, PlaneSum] = {}

    def want(self, z: int) -> bool:
        """Request plane ``z`` in place of the previous one; return whether a call of `read` is necessary.

        Returns False if ``z`` was already requested.
        """
        before, self._wanted = self._wanted, z
        if before == z or self._known is None or not self._known.flat.size:
            return False
        found = self._sums.get(z)
        summed = isinstance(self._quality, LiveCoverage) or (found is not None and found.ended)
        return not (self._reported and summed)

    def sum_of(self, z: int) -> PlaneSum | None:
        """Return the sum of plane ``z`` over the frames read so far; None before the first frame."""
        return self._sums.get(z)

    def read(self, z: int, going: Callable[[], bool] = lambda: True) -> None:
        """Pass on the records if this has not been done, then add up the frames of plane ``z``, requested with `want`.

        Reading ends early when ``going`` returns False or another plane is requested. It also ends after the time limit
        for a plane.

        Raises
        ------
        LfcalError, OSError
            If a file of the session cannot be read.
        """

        def wanted() -> bool:
            return self._wanted == z and going()

        if self._known is None:
            return
        with ExitStack() as stack:
            files = [stack.enter_context(RecordingFile(self._folder / name)) for name in self._known.recordings]
            frames = _Frames.of(files, self._known)
            if not self._reported:
                self._report(frames, self._known.grid[2], wanted)
            if isinstance(self._quality, LiveQuality):
                self._add_up(z, self._quality, frames, wanted)

    def _report(self, frames: _Frames, most: int, wanted: Callable[[], bool]) -> None:
        """Pass on the records, with backgrounds measured in a few frames of each plane."""
        records, levels = frames.records, np.zeros(len(frames.records))
        level_of = _border_level if isinstance(self._quality, LiveQuality) else _frame_level
        planes = np.unique(frames.planes)
        size = int(frames.files[0].layout.frame_bytes)
        count = int(np.clip(MEMORY // (size * max(1, len(planes))), 1, SAMPLED))
        for z in planes:
            here = np.flatnonzero(frames.planes == z)
            here = here[np.argsort(records["sequence"][here])]
            sampled = here[np.unique(np.linspace(0, len(here) - 1, count).round().astype(np.intp))]
            found = {k: level_of(frame) for k in sampled.tolist() if wanted() and (frame := frames.read(k)) is not None}
            if not wanted():
                return
            if found:
                levels[here] = np.interp(records["sequence"][here], records["sequence"][list(found)], [*found.values()])
        if isinstance(self._quality, LiveQuality):
            self._quality.know(records, levels)
        else:
            pixels = frames.files[0].layout.shape[0] * frames.files[0].layout.shape[1]
            for record, level in zip(records, levels.tolist(), strict=True):
                light = float(record["energy"]) - level * pixels
                self._quality.know(*divmod(int(record["index"]), most), light, int(record["saturated"]))
        self._reported = True

    def _add_up(self, z: int, quality: LiveQuality, frames: _Frames, wanted: Callable[[], bool]) -> None:
        """Add up frames of a plane in an order spread over it, so that a part of them represents the plane."""
        here = np.flatnonzero(frames.planes == z)
        if not len(here) or not wanted():
            return
        order = here[np.argsort((np.arange(len(here)) * GOLDEN) % 1)]
        light, damaged = np.zeros(frames.files[0].layout.shape), 0
        levels: dict[int, float] = {}
        start = shown = self._clock()
        for k in order.tolist():
            if not wanted():
                return
            frame = frames.read(k)
            if frame is None:
                damaged += 1
                continue
            levels[k] = _border_level(frame)
            light += frame
            now = self._clock()
            if now - shown > SHOWN_S or len(levels) == 1:
                shown = now
                self._keep(z, PlaneSum(light - sum(levels.values()), len(levels), len(here), damaged))
            if now - start > self._seconds:
                break
        quality.know(frames.records[list(levels)], np.array([*levels.values()]))
        self._keep(z, PlaneSum(light - sum(levels.values()), len(levels), len(here), damaged, ended=True))

    def _keep(self, z: int, found: PlaneSum) -> None:
        """Store a sum; discard the sums of other planes if they need too much memory."""
        kept = {other: seen for other, seen in self._sums.items() if other != z}
        while kept and (1 + len(kept)) * found.light.nbytes > MEMORY:
            del kept[next(iter(kept))]
        self._sums = {**kept, z: found}


def _border_level(frame: NDArray[Any]) -> float:
    """Return the background of a cutout (counts) from its border, because the spot is in the middle."""
    border = np.concatenate([frame[0], frame[-1], frame[1:-1, 0], frame[1:-1, -1]])
    return float(np.median(border))


def _frame_level(frame: NDArray[Any]) -> float:
    """Return the background of a whole frame (counts): its median, because most of it is dark."""
    stride = max(1, int(np.sqrt(frame.size / SAMPLE)))
    return float(np.median(frame[::stride, ::stride]))
