"""H from a recorded session, as ``lfcal assemble`` makes it. No Qt."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import Work
from lfcal.tasks import Assemble, AssembleTarget, RunSettings

if TYPE_CHECKING:
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf import AssemblyReport

__all__ = ["iter_assembly", "task_of"]


def task_of(folder: Path, out: Path, recipe: CorrectionRecipe) -> Assemble | AssembleTarget:
    """Return the task that makes H of a session."""
    from lfcal.acquire import NAME, SessionFile

    of_points = (folder / NAME).is_file() and SessionFile.read(folder).target is not None
    return (AssembleTarget if of_points else Assemble)(frames=folder, out=out, corrections=recipe)


def iter_assembly(folder: Path, out: Path, planes: list[int] | None, recipe: CorrectionRecipe) -> Work[AssemblyReport]:
    """Assemble H of a session: single planes at once, for more may be recorded meanwhile, and all of it in units.

    Planes that are done stay where it is stopped; called again it continues with them.

    Raises
    ------
    InputError
        As `lfcal.acquire.finish.iter_assemble_session`.
    """
    from lfcal.acquire import iter_assemble_session

    if planes is not None:
        return (yield from iter_assemble_session(folder, out, planes=planes, recipe=recipe))
    (made,) = yield from task_of(folder, out, recipe).work(RunSettings(resume=True))
    return made.report
