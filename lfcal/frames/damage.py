"""Selection of frames: those that cannot be read, and those at unwanted positions, are left out."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, FileFormatError, InputError, Region, StorageError, Work, worker_count
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, LeftOut, Position, Samples
from lfcal.frames.view import SourceView

__all__ = ["SelectedSource", "frame_errors", "iter_undamaged", "without_positions"]

BLOCK = 64


@contextmanager
def frame_errors(label: str, position: Position) -> Iterator[None]:
    """Context manager that adds ``label``, ``position`` and a remedy to the error that an unreadable frame raises."""
    try:
        yield
    except (FileFormatError, StorageError) as error:
        path, _, said = str(error).partition(": ")
        message = said if path.endswith(label) else str(error)
        message = message.removesuffix("leave it out").removesuffix(", or ")
        where = f"{label}, (z, y, x) = {tuple(position)}"
        joint = "" if message.endswith(" ") else ", or "
        raise type(error)(f"{where}: {message}{joint}leave it out (--skip-damaged)") from error


class SelectedSource(SourceView):
    """View of another source that contains only the frames with the indices ``chosen``.

    The metadata of the view list the frames ``left_out``.
    """

    def __init__(self, source: FrameSource, chosen: NDArray[np.int64], left_out: tuple[LeftOut, ...]) -> None:
        super().__init__(source)
        self.chosen = chosen
        """Indices of the frames in ``source``."""
        self._left_out = left_out

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known`` with the view's list of damaged frames, ``left_out``."""
        return replace(known, left_out=self._left_out)

    def __len__(self) -> int:
        """Return the number of frames chosen."""
        return len(self.chosen)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``."""
        return self.source.info(int(self.chosen[index]))

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or only the part of it in ``region``."""
        return self.source.read(int(self.chosen[index]), region)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index``, or only those in ``region``."""
        return self.source.samples(int(self.chosen[index]), region)

    def repeats(self) -> FrameSource | None:
        """Return the repeated frames of the source; None if it has none."""
        return self.source.repeats() if isinstance(self.source, Frames) else None


def iter_undamaged(source: FrameSource, *, workers: int | None = None) -> Work[SelectedSource]:
    """Read every frame once, in several threads, and return a view of ``source`` without the unreadable frames.

    Parameters
    ----------
    source
        Raw frames.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    FileFormatError
        If no frame can be read.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from lfcal.frames import LeftOut, iter_undamaged, open_frames
    >>> from lfcal.base import drain
    >>> Path("copied").mkdir()
    >>> for x in range(3):
    ...     np.save(f"copied/y0_x{x}.npy", np.eye(4) + x)
    >>> size = Path("copied/y0_x1.npy").write_bytes(b"cut short")
    >>> with open_frames("copied", pattern="y{y}_x{x}.npy") as source:
    ...     sound = drain(iter_undamaged(source, workers=1))
    >>> lost: LeftOut = sound.metadata.left_out[0]
    >>> print(len(sound), "of 3; left out:", lost.label)
    2 of 3; left out: y0_x1.npy
    """
    clock = Clock("check frames", len(source))
    left_out: dict[int, LeftOut] = {}

    def reason(index: int) -> str:
        try:
            source.read(index)
        except (FileFormatError, StorageError) as error:
            return str(error)
        return ""

    with ThreadPoolExecutor(worker_count(workers)) as pool:
        for start in range(0, len(source), BLOCK):
            yield clock.at(start)
            indices = range(start, min(start + BLOCK, len(source)))
            for index, why in zip(indices, pool.map(reason, indices), strict=True):
                if why:
                    info = source.info(index)
                    left_out[index] = LeftOut(info.label, info.points[0] if len(info.points) == 1 else None, why)
    yield clock.at(len(source))
    chosen = np.setdiff1d(np.arange(len(source)), list(left_out))
    if not chosen.size:
        raise FileFormatError.expected(
            "frames", "at least one readable frame", f"only damaged ones ({len(left_out)})", "record or copy them again"
        )
    return SelectedSource(source, chosen, (*source.metadata.left_out, *left_out.values()))


def without_positions(source: FrameSource, positions: Collection[tuple[int, int, int]]) -> FrameSource:
    """Return a view of ``source`` without the frames at ``positions``.

    Parameters
    ----------
    source
        Frames of a scan.
    positions
        Positions (z, y, x) to leave out; those without a frame are ignored.

    Raises
    ------
    InputError
        If no frame remains.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, without_positions
    >>> frames = ArraySource(np.zeros((3, 4, 4), np.uint16), [(0, 0, 0), (0, 0, 1), (0, 0, 2)])
    >>> rest = without_positions(frames, [(0, 0, 1)])
    >>> print([tuple(rest.info(k).position) for k in range(len(rest))])
    [(0, 0, 0), (0, 0, 2)]
    """
    unwanted = set(map(tuple, positions))
    chosen = np.array([k for k in range(len(source)) if tuple(source.info(k).position) not in unwanted], np.int64)
    if not len(chosen):
        got = f"all {len(source)} in the list of positions to leave out"
        raise InputError.expected("frames", "at least one to use", got, "shorten the list")
    if isinstance(source, SelectedSource):  # so that frames are numbered as they are in the files
        return SelectedSource(source.source, source.chosen[chosen], source.metadata.left_out)
    return SelectedSource(source, chosen, source.metadata.left_out)
