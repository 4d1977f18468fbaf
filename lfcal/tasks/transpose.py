"""Transpose H into HT."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar

from lfcal.base import Work
from lfcal.records import COMPRESSIONS, opt, record, required
from lfcal.tasks.matrices import CopyTask, report_dark, report_missing, with_task
from lfcal.tasks.task import RunSettings, TaskResult, TaskSet

__all__ = ["TRANSPOSE", "Transpose", "TransposedFile"]

RATE = 150e6
"""Estimated number of bytes of H read, transposed and written per second of processor time."""


@dataclass(frozen=True, kw_only=True)
class TransposedFile(TaskResult):
    """The transposed file that was written.

    ``out`` is its path. ``shape`` is the shape of the source, ``bytes`` its uncompressed size, and ``dark`` lists the
    indices of its planes without light. ``method`` is the method of transposing, and ``seconds`` the duration (s).
    ``missing`` is the number of positions that were neither recorded nor filled. ``made`` is what the file contains:
    ``"HT"``, or ``"H"`` if the source was HT and the method is exact.
    """

    out: Path
    shape: tuple[int, ...]
    bytes: int
    seconds: float
    method: str
    dark: tuple[int, ...]
    missing: int
    made: str

    def _values(self) -> dict[str, Any]:
        return {one.name: getattr(self, one.name) for one in fields(self) if one.name != "made"}


@record
class Transpose(CopyTask):
    """Transpose H into HT, from file to file, with one plane of each in memory.

    Examples
    --------
    >>> from lfcal.psf import open_psf
    >>> from lfcal.tasks import Transpose
    >>> (made,) = Transpose(source="H.h5", out="made.h5").run()
    >>> with open_psf("made.h5") as HT:
    ...     print(made.made, HT.is_transposed, HT.provenance["task"]["task"])
    HT True transpose
    """

    name: ClassVar[str] = "transpose"
    input_words: ClassVar[str] = "H"
    in_units: ClassVar[bool] = True

    out: Path = required("HT file to write (.h5).", label="HT file", short="-o", file="out")
    method: str = opt(
        "exact",
        "Algorithm. exact: the exact transpose. paper: the published loop, which leaves a border of zeros. "
        "paper-padded: the same loop on H padded with zeros, which makes the result exact.",
        choices=("exact", "paper", "paper-padded"),
        more=True,
    )
    compression: str = opt("gzip", "Compression of the file.", choices=COMPRESSIONS, more=True)

    def work(self, run: RunSettings | None = None) -> Work[tuple[TransposedFile, ...]]:
        """Transpose H and write the result plane by plane, because both may be larger than memory."""
        from lfcal.psf import iter_transpose_file

        start, run = time.perf_counter(), run or RunSettings()
        with self.opened() as matrix:
            dark, missing = report_dark(matrix), report_missing(matrix)
            yield from iter_transpose_file(
                matrix,
                self.out,
                method=self.method,
                compression=self.compression,
                workers=run.workers,
                provenance=with_task(self, matrix),
                run=run.choice(self.out, matrix.nbytes / RATE),
            )
            back = matrix.is_transposed and self.method == "exact"
            made = TransposedFile(
                out=self.out,
                shape=matrix.shape,
                bytes=matrix.nbytes,
                seconds=time.perf_counter() - start,
                method=self.method,
                dark=dark,
                missing=missing,
                made="H" if back else "HT",
            )
        return (made,)


TRANSPOSE = TaskSet("transpose", (Transpose,), lambda given: Transpose, "lfcal transpose H.h5 -o HT.h5")
