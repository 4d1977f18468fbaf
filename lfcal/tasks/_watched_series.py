"""The result of ``lfcal watch`` for the frames of a series: which H applies to each, and what its volume states."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError, note

if TYPE_CHECKING:
    from lfcal.recalibrate import StoredWatch
    from lfcal.reconstruct import FrameFile

__all__ = ["WatchedSeries"]


@dataclass(frozen=True)
class WatchedSeries:
    """Frames of a series with the result of ``lfcal watch``.

    Attributes
    ----------
    frames, found
        The frames, and the result.
    recalibrated
        H for the frames from the first drift on. None: the same H for all frames.
    """

    frames: Sequence[FrameFile]
    found: StoredWatch
    recalibrated: Path | None

    @classmethod
    def read(cls, path: Path, psf: Path, frames: Sequence[FrameFile], *, recalibrated: bool) -> WatchedSeries:
        """Return the result in the file or folder ``path`` for frames that are reconstructed with ``psf``.

        Raises
        ------
        InputError
            If the result is for another H or other frames, or if ``recalibrated`` is set and there is no H for a drift.
        """
        from lfcal.fit import MODEL
        from lfcal.recalibrate import read_watch

        found = read_watch(path)
        watched = found.psf / MODEL if found.psf.is_dir() else found.psf
        if os.path.realpath(watched) != os.path.realpath(psf):
            raise InputError.expected(
                f"{path}, H", str(psf), str(watched), "watch the frames with this H, or reconstruct with that H"
            )
        _check_frames(path, frames, [str(one["name"]) for one in found.frames])
        own = found.recalibrated / MODEL
        if not recalibrated or found.first_moved is None:
            return cls(frames, found, None)
        if not (found.has_recalibrated and own.is_file()):
            raise InputError.expected(
                str(own),
                "the recalibrated H of this result",
                "that of an earlier one" if own.is_file() else "no file",
                "run lfcal watch with --recalibrate, or leave this option out",
            )
        return cls(frames, found, own)

    @property
    def parts(self) -> list[tuple[Path | None, list[FrameFile]]]:
        """H and frames of each part of the series; None: the H of the task."""
        if self.recalibrated is None or self.found.first_moved is None:
            return [(None, list(self.frames))]
        k = self.found.first_moved
        both = [(None, list(self.frames[:k])), (self.recalibrated, list(self.frames[k:]))]
        return [part for part in both if part[1]]

    @property
    def of_frames(self) -> dict[str, dict[str, Any]]:
        """Entry ``watch`` of the metadata of each frame's volume, by the name of the frame."""
        k = len(self.frames) if self.recalibrated is None else self.found.first_moved or 0
        pairs = zip(self.frames, self.found.frames, strict=True)
        return {one.name: {"watch": {**said, "recalibrated": n >= k}} for n, (one, said) in enumerate(pairs)}

    def report(self) -> None:
        """Report the verdict, and from which frame on another H is used."""
        note(f"{self.found.file.name}: {self.found.verdict}")
        if self.recalibrated is not None:
            note(f"from {self.parts[-1][1][0].name} on, frames are reconstructed with {self.recalibrated}")


def _check_frames(path: Path, frames: Sequence[FrameFile], watched: Sequence[str]) -> None:
    """Raise `InputError` unless the ``watched`` frames are those of the series, in the same order."""
    alike = len(frames) == len(watched) and all(
        Path(name).stem == one.name for one, name in zip(frames, watched, strict=True) if one.name == one.file.stem
    )
    if not alike:
        got = f"{len(watched)} frames, the first {watched[0]}" if watched else "no frames"
        raise InputError.expected(
            f"{path}, frames", f"the {len(frames)} frames of the series", got, "watch the frames of this series"
        )
