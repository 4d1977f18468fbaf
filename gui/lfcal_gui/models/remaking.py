"""H made again from the frames it was made of: with the same settings, in a new file next to the one before. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lfcal.base import InputError, Work

if TYPE_CHECKING:
    from lfcal.psf import AssemblyReport
    from lfcal.tasks import Assemble, AssembleTarget, FitMatrix

Place = tuple[int, int, int]


def iter_made(task: Assemble | AssembleTarget) -> Work[AssemblyReport]:
    """Make H in units; called again it continues with the planes that are done."""
    from lfcal.tasks import RunSettings

    (made,) = yield from task.work(RunSettings(resume=True))
    return made.report


def new_file(psf: Path) -> Path:
    """Return a file next to an H that does not exist: ``H-2.h5`` for ``H.h5``."""
    stem, _, number = psf.stem.rpartition("-")
    stem, first = (stem, int(number) + 1) if stem and number.isdigit() else (psf.stem, 2)
    return next(path for k in range(first, first + 10_000) if not (path := psf.with_name(f"{stem}-{k}.h5")).exists())


def shown_first(places: Sequence[Place]) -> Place:
    """Return the position (z, y, x) to look at: in the plane with most of ``places``."""
    z = int(np.bincount([place[0] for place in places]).argmax())
    return next(place for place in places if place[0] == z)


@dataclass(frozen=True)
class WithoutBad:
    """How an H is made again without some positions.

    Attributes
    ----------
    fit
        Finds the camera that fills them; None where H was filled by a fit already.
    assemble
        Makes H.
    listed
        Text of the file that lists the positions.
    """

    fit: FitMatrix | None
    assemble: Assemble
    listed: str

    def write_list(self) -> None:
        """Write the list of positions."""
        assert self.assemble.leave_out is not None
        self.assemble.leave_out.write_text(self.listed, encoding="utf-8")


def without_bad(psf: Path, places: Sequence[Place]) -> WithoutBad:
    """Return how the H ``psf`` is made again without the frames of ``places``, which a fit of H fills.

    Raises
    ------
    InputError, FileFormatError, StorageError
        If H was not assembled from frames of one colour.
    """
    from lfcal.acquire import RedoList
    from lfcal.tasks import Assemble, FitMatrix, load_job

    out = new_file(psf)
    listed, folder = out.with_name(f"{out.stem}_left_out.json"), out.with_name(f"{out.stem}_fit")
    made, _ = load_job(psf, {"out": str(out)})
    if not isinstance(made, Assemble) or made.channel == "each":
        raise InputError.expected(psf.name, "an H that was assembled from one scan", "another H", "assemble it again")
    fit = FitMatrix(sources=(psf,), out=folder, write_h=False) if made.fill is None else None
    again = {"out": str(out), "leave_out": str(listed)} | ({} if fit is None else {"fill": str(folder)})
    task, _ = load_job(psf, again)
    assert isinstance(task, Assemble)
    before = () if made.leave_out is None else made.positions_left_out
    return WithoutBad(fit, task, RedoList.of(sorted({*before, *places})).to_json())
