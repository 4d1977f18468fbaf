"""Take white and dark frames of the whole sensor, check them, and write them into the session's folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, check_writable, replace_whole
from lfcal.camera import ScanPlan
from lfcal.devices import Light
from lfcal.frames import CorrectionRecipe

__all__ = ["Stills", "iter_stills", "recipe_of", "still_files"]

COUNT = 8
"""Number of frames of each kind."""

PARTS = 4
"""Number of parts of the sensor along rows and columns; the fraction `LIT` of the parts must reach `DIM` times the
light of the brightest part."""
LIT = 0.75
DIM = 0.1
SATURATED = 1e-3
BRIGHT = 0.15
DARK = 0.05


@dataclass(frozen=True)
class Stills:
    """Frames that were written: their kind, their files, and their brightness (fraction of the range above black).

    The brightness `level` is the 99th percentile of the mean frame.
    """

    kind: str
    files: tuple[Path, ...]
    level: float

    def words(self) -> str:
        """Return a one-line description for display."""
        return (
            f"{len(self.files)} {self.kind} frames in {self.files[0].parent}, at {100 * self.level:.0f} % of the range"
        )


def still_files(folder: Path, kind: str) -> tuple[Path, ...]:
    """Return the paths of the files that `iter_stills` writes to ``folder`` for a ``kind``, "white" or "dark"."""
    return tuple(folder / kind / f"{kind}_{k}.tif" for k in range(COUNT))


def recipe_of(folder: Path) -> CorrectionRecipe:
    """Return the corrections with the white frames and, if they exist, the dark frames in a session's ``folder``.

    Without white frames, the recipe is empty, even if there are dark frames.
    """
    white, dark = (folder / kind if still_files(folder, kind)[0].is_file() else "" for kind in ("white", "dark"))
    # a recording has separate darks; those of the whole sensor are for the white image
    return CorrectionRecipe(white=white, dark=dark) if white else CorrectionRecipe()


def iter_stills(
    take: Callable[[int], NDArray[Any]], plan: ScanPlan, folder: Path, kind: str, *, light: Light | None = None
) -> Work[Stills]:
    """Take `COUNT` frames of the whole sensor, check their mean, and write each frame as TIFF.

    Parameters
    ----------
    take
        Function that returns frame ``k`` of the whole sensor, ``(rows, columns)`` (counts).
    plan
        Plan of the session; its sensor states black level and range.
    folder, kind
        Folder of the session, and kind of the frames: ``"white"`` or ``"dark"``.
    light
        Light to switch off for dark frames, and on again afterwards; None if it cannot be switched.

    Raises
    ------
    InputError
        If white frames are dim, saturated or not lit everywhere, or dark frames are not dark.
    StorageError
        If the files cannot be written; this is checked before the first frame.
    """
    files = still_files(folder, kind)
    for path in files:
        check_writable(path)
    clock, frames = Clock(f"{kind} frames", COUNT), []
    light = light if kind == "dark" else None
    try:
        if light is not None:
            light.switch(False)
        for k in range(COUNT):
            yield clock.at(k)
            frames.append(take(k))
    finally:
        if light is not None:
            light.switch(True)
    level = _checked(np.mean(frames, axis=0, dtype=np.float64), plan, kind)
    import tifffile  # slow to import

    for path, frame in zip(files, frames, strict=True):
        with replace_whole(path) as part:
            tifffile.imwrite(part, frame)
    yield clock.at(COUNT)
    return Stills(kind, files, level)


def _checked(mean: NDArray[np.float64], plan: ScanPlan, kind: str) -> float:
    """Return the brightness of the mean frame (fraction of the range); raise `InputError` if it is not as required."""
    sensor = plan.camera.sensor
    shares = (mean - sensor.black_level) / (sensor.max_value - sensor.black_level)
    level = float(np.percentile(shares, 99))
    if kind == "dark":
        if level > DARK:
            raise InputError.expected(
                "dark frames", f"at most {100 * DARK:.0f} % of the range", f"{100 * level:.0f} %", "cover the lens"
            )
        return level
    if level < BRIGHT:
        raise InputError.expected(
            "white frames", f"at least {100 * BRIGHT:.0f} % of the range", f"{100 * level:.0f} %", "expose longer"
        )
    if float((mean >= sensor.max_value).mean()) > SATURATED:
        raise InputError.expected("white frames", "no saturated pixels", "many of them", "use a shorter exposure")
    rows, columns = (np.array_split(np.arange(n), PARTS) for n in mean.shape)
    parts = [float(np.percentile(shares[np.ix_(r, c)], 95)) for r in rows for c in columns]
    lit = float(np.mean([part > DIM * level for part in parts]))
    if lit < LIT:
        raise InputError.expected(
            "white frames",
            f"light on {100 * LIT:.0f} % of the sensor",
            f"on {100 * lit:.0f} %",
            "place uniform illumination or a diffuser in front of the lens",
        )
    return level
