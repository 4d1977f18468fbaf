"""Reduce H to a smaller file within a tolerance."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from lfcal.base import Work
from lfcal.records import COMPRESSIONS, opt, read_share, record, required
from lfcal.tasks.matrices import CopyTask, report_missing, with_task
from lfcal.tasks.task import RunSettings, TaskResult, TaskSet

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix

__all__ = ["REDUCE", "Reduce", "ReducedFile"]

RATE = 50e6
"""Estimated number of bytes of H read, rounded and written per second of processor time."""


@dataclass(frozen=True, kw_only=True)
class ReducedFile(TaskResult):
    """The smaller file ``out`` that was written; ``matrix`` is its H, still open.

    ``tolerance`` is the requested limit of the relative L1 error of each pattern, ``source_bytes`` the size of the
    source (bytes), and ``seconds`` the duration (s).
    """

    out: Path
    matrix: PSFMatrix
    tolerance: float
    source_bytes: int
    seconds: float

    @property
    def bound(self) -> Any:
        """Largest relative L1 error of a pattern in each plane: by cropping, by rounding and in total, ``(nz, 3)``."""
        return self.matrix.facts.known()["bound"]

    @property
    def bytes(self) -> int:
        """Size of the file (bytes)."""
        return self.out.stat().st_size

    def close(self) -> None:
        """Close the file."""
        self.matrix.close()

    def _values(self) -> dict[str, Any]:
        return {
            "out": self.out,
            "shape": self.matrix.shape,
            "tolerance": self.tolerance,
            "bound": self.bound,
            "bytes": self.bytes,
            "source_bytes": self.source_bytes,
            "seconds": self.seconds,
        }


@record
class Reduce(CopyTask):
    """Store H in a fraction of its bytes; each pattern stays within a tolerance that the file states.

    Examples
    --------
    >>> from lfcal.tasks import Reduce
    >>> (made,) = Reduce(source="H.h5", out="made.h5", tolerance=0.01).run()
    >>> print(made.matrix.shape, bool(made.bound.max() <= 0.01))
    (2, 19, 33, 55, 55) True
    >>> made.close()
    """

    name: ClassVar[str] = "reduce"
    input_words: ClassVar[str] = "H"
    in_units: ClassVar[bool] = True

    out: Path = required("H file to write (.h5).", label="H file", short="-o", file="out")
    tolerance: float = opt(
        0.005,
        "Largest relative L1 error of a pattern that rounding and cropping may cause.",
        above=0,
        below=1,
        read=read_share,
    )
    compression: str = opt("gzip", "Compression of the file.", choices=COMPRESSIONS, more=True)

    def work(self, run: RunSettings | None = None) -> Work[tuple[ReducedFile, ...]]:
        """Write H to the new file, with patterns cropped and rounded as far as the tolerance allows."""
        from lfcal.psf import iter_save, open_psf

        start, run = time.perf_counter(), run or RunSettings()
        with self.opened() as matrix:
            report_missing(matrix)
            yield from iter_save(
                matrix,
                self.out,
                compression=self.compression,
                workers=run.workers,
                store_tolerance=self.tolerance,
                provenance=with_task(self, matrix),
                run=run.choice(self.out, matrix.nbytes / RATE),
            )
        made = ReducedFile(
            out=self.out,
            matrix=open_psf(self.out),
            tolerance=self.tolerance,
            source_bytes=self.source.stat().st_size,
            seconds=time.perf_counter() - start,
        )
        return (made,)


REDUCE = TaskSet("reduce", (Reduce,), lambda given: Reduce, "lfcal reduce H.h5 -o small.h5 --tolerance 0.005")
