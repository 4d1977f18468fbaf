"""Reassembly of H with its bad positions left out and filled. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Progress, Work
from lfcal_gui.models.words import plane_words

if TYPE_CHECKING:
    from lfcal.psf import AssemblyProgress, AssemblyReport
    from lfcal.tasks import Assemble, AssembleTarget, FitMatrix


@dataclass
class Filling:
    """H during its assembly: current plane, and light of the patterns ``(nz, ny, nx)``, NaN if not there yet."""

    plane: int | None = None
    energy: NDArray[np.float64] | None = None
    job: int = 0

    def follows(self, job: int, record: Progress | None) -> bool:
        """Return whether the job with this record is, or now becomes, the one that fills H."""
        if _of_assembly(record) is not None and job != self.job:
            self.job, self.plane, self.energy = job, None, None
        return job == self.job

    def take(self, record: Progress | None) -> bool:
        """Update from a progress record of the assembly; return whether anything changed."""
        found = _of_assembly(record)
        if found is None or found.energy is self.energy:
            return False
        self.plane, self.energy = found.plane, found.energy
        return True

    def light(self, z: int) -> NDArray[np.float64] | None:
        """Return the light of the patterns of plane ``z``; None if there are none yet."""
        found = None if self.energy is None else self.energy[z]
        return found if found is not None and np.isfinite(found).any() else None

    def words(self, z: int, count: int, *, under_way: bool) -> str:
        """Return the progress of plane ``z`` of ``count`` planes as text; empty if unknown."""
        energy = self.light(z)
        if energy is None:
            return ""
        there = int(np.isfinite(energy).sum())
        state = "fills" if under_way else "holds"
        return f"{plane_words(z, count)} of H {state}: light at {there} of {energy.size} positions"

    def short_words(self, z: int) -> str:
        """Return the progress of plane ``z`` in a few words."""
        energy = self.light(z)
        there = 0 if energy is None else int(np.isfinite(energy).sum())
        return f"H fills: plane {z}, {there} of {0 if energy is None else energy.size}"


def _of_assembly(record: Progress | None) -> AssemblyProgress | None:
    """Return the record if it is of an assembly, else None."""
    if record is None or type(record) is Progress:
        return None
    from lfcal.psf import AssemblyProgress

    return record if isinstance(record, AssemblyProgress) else None


Place = tuple[int, int, int]


def iter_made(task: Assemble | AssembleTarget) -> Work[AssemblyReport]:
    """Assemble H in units; a repeated call continues after the completed planes."""
    from lfcal.tasks import RunSettings

    (made,) = yield from task.work(RunSettings(resume=True))
    return made.report


def new_file(psf: Path) -> Path:
    """Return an unused path next to an H, such as ``H-2.h5`` for ``H.h5``."""
    stem, _, number = psf.stem.rpartition("-")
    stem, first = (stem, int(number) + 1) if stem and number.isdigit() else (psf.stem, 2)
    return next(path for k in range(first, first + 10_000) if not (path := psf.with_name(f"{stem}-{k}.h5")).exists())


def shown_first(places: Sequence[Place]) -> Place:
    """Return the first position (z, y, x) to show: in the plane with most of ``places``."""
    z = int(np.bincount([place[0] for place in places]).argmax())
    return next(place for place in places if place[0] == z)


@dataclass(frozen=True)
class WithoutBad:
    """Tasks that make an H again without some positions.

    Attributes
    ----------
    fit
        Task that fits the camera with which the positions are filled. None: H is already filled from a fit.
    assemble
        Task that assembles H.
    listed
        Content of the file that lists the positions.
    """

    fit: FitMatrix | None
    assemble: Assemble
    listed: str

    def write_list(self) -> None:
        """Write the list of positions."""
        assert self.assemble.leave_out is not None
        self.assemble.leave_out.write_text(self.listed, encoding="utf-8")


def without_bad(psf: Path, places: Sequence[Place]) -> WithoutBad:
    """Return the tasks that make the H ``psf`` again without the frames of ``places``, which a fit fills.

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
        got = "an H of each colour" if isinstance(made, Assemble) else f"an H made by lfcal {made.name}"
        remedy = "assemble one colour" if isinstance(made, Assemble) else "open an assembled H"
        raise InputError.expected(psf.name, "an H assembled from frames of one colour", got, remedy)
    fit = FitMatrix(sources=(psf,), out=folder, write_h=False) if made.fill is None else None
    again = {"out": str(out), "leave_out": str(listed)} | ({} if fit is None else {"fill": str(folder)})
    task, _ = load_job(psf, again)
    assert isinstance(task, Assemble)
    before = () if made.leave_out is None else made.positions_left_out
    return WithoutBad(fit, task, RedoList.of(sorted({*before, *places})).to_json())
