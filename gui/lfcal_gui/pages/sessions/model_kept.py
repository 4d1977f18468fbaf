"""Cache of images and verdicts of results in a folder, by the stamp of each file. No Qt."""

from __future__ import annotations

import hashlib
import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LfcalError, Work, map_npy, npy_header, parse_json, read_text, replace_whole
from lfcal_gui.models import DisplaySettings, levels_of, stamp_of, to_uint8
from lfcal_gui.pages.sessions.model import WORST, Verdict

if TYPE_CHECKING:
    from lfcal.judge import StoredResult

SIDE = 128
"""Largest number of rows and columns of an image (px)."""

MOST = 2000
"""Largest number of stored images; the oldest are removed first."""

U1 = NDArray[np.uint8]


def cache_folder() -> Path:
    """Return the folder in which images and verdicts are stored."""
    from platformdirs import user_cache_path

    return user_cache_path("lfcal") / "results"


def thumbnail(values: NDArray[np.generic]) -> U1:
    """Return an image of values (0 to 255) with at most `SIDE` rows and columns, from the maximum of each block."""
    step = max(1, -(-max(values.shape) // SIDE))
    rows, columns = (max(1, n // step) for n in values.shape)
    blocks = np.nan_to_num(np.asarray(values[: rows * step, : columns * step], np.float32))
    if step > 1 and min(values.shape) >= step:
        blocks = blocks.reshape(rows, step, columns, step).max((1, 3))
    low, high = levels_of(blocks)
    return to_uint8(blocks, DisplaySettings(scale="gamma"), (max(low, 0.0), max(high, low + 1e-30)))


class KeptResults:
    """Cache of images and verdicts by file and modification time; entries of an earlier version of a file are ignored.

    If the folder cannot be written, nothing is stored and no error is raised.

    Parameters
    ----------
    folder
        Folder of the cache. None: the default.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder or cache_folder()

    def picture(self, result: StoredResult) -> U1 | None:
        """Return the image of a result, or None if it has none; raise `LfcalError` if the result cannot be read."""
        from lfcal.judge import picture_of

        place = self._place(result, ".npy")
        if place is not None:
            with suppress(LfcalError, OSError):
                return np.array(map_npy(place), np.uint8)
        values = picture_of(result)
        if values is None:
            return None
        made = thumbnail(values)
        if place is not None:
            self._write(place, npy_header(made.shape, made.dtype) + made.tobytes())
        return made

    def verdict(self, result: StoredResult) -> Verdict | None:
        """Return the stored verdict on H; None if there is none."""
        place = self._place(result, ".json")
        found = None
        if place is not None:
            with suppress(LfcalError, OSError):
                found = parse_json(read_text(place), str(place))
        if not isinstance(found, list) or len(found) != 2 or not all(isinstance(one, str) for one in found):
            return None
        return (found[0], found[1]) if found[0] in WORST else None

    def keep_verdict(self, result: StoredResult, verdict: Verdict) -> None:
        """Store the verdict on H."""
        place = self._place(result, ".json")
        if place is not None:
            self._write(place, json.dumps(verdict).encode())

    def _place(self, result: StoredResult, suffix: str) -> Path | None:
        inner = result.path / "session.json" if result.kind == "recording" else result.path
        stamp = stamp_of(str(inner.absolute()))
        if stamp is None:
            return None
        return self.folder / f"{hashlib.sha256(repr(stamp).encode()).hexdigest()[:32]}{suffix}"

    def _write(self, place: Path, content: bytes) -> None:
        with suppress(LfcalError, OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            with replace_whole(place) as part:
                part.write_bytes(content)

    def sweep(self) -> None:
        """Remove the oldest images if there are too many."""
        with suppress(OSError):
            found = sorted(self.folder.glob("*.npy"), key=lambda one: one.stat().st_mtime)
            for one in found[: max(0, len(found) - MOST)]:
                one.unlink(missing_ok=True)


@dataclass(eq=False)
class JudgedResult:
    """Result of a judgement that runs in a thread."""

    verdict: Verdict | None = None


def iter_judged(path: str, mat_order: str, kept: JudgedResult) -> Work[None]:
    """Judge an H by its metrics and by the comparison with its camera."""
    from lfcal.judge import iter_inspection
    from lfcal.judge.quality import iter_inspect
    from lfcal.psf import open_psf

    with open_psf(path, mat_order=mat_order) as opened:
        matrix = opened.T if opened.is_transposed else opened
        report = yield from iter_inspect(matrix)
        found = yield from iter_inspection(matrix, report)
    kept.verdict = found.merit, found.verdict
