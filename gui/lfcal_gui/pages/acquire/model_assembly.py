"""H from a recorded session, as ``lfcal assemble`` makes it. No Qt."""

from __future__ import annotations

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import Work, plain
from lfcal_gui.models import going_on, stamp_of_files

if TYPE_CHECKING:
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf import AssemblyReport

__all__ = ["iter_assembly"]


def iter_assembly(
    folder: Path, out: Path, planes: list[int] | None, recipe: CorrectionRecipe | None
) -> Work[AssemblyReport]:
    """Assemble H of a session: single planes at once, for more may be recorded meanwhile, and all of it in units.

    Planes that are done stay where it is stopped; called again it goes on from them.

    Raises
    ------
    InputError
        As `lfcal.acquire.finish.iter_assemble_session`.
    """
    from lfcal.acquire import SessionFile, iter_assemble_session
    from lfcal.psf import Reopening, iter_assemble_plan

    if SessionFile.read(folder).target is not None:
        return (yield from _iter_points(folder, out, recipe))
    if planes is not None:
        return (yield from iter_assemble_session(folder, out, planes=planes, recipe=recipe))
    frames = () if recipe is None else (str(recipe.dark), str(recipe.white))
    told = {
        "session": str(folder.absolute()),
        "recipe": None if recipe is None else plain(asdict(recipe)),
        "stamp": stamp_of_files(str(folder), *frames, but=str(out)),
    }
    make = partial(iter_assemble_plan, run=going_on(), reopening=Reopening("", told))
    return (yield from iter_assemble_session(folder, out, recipe=recipe, make=make))


def _iter_points(folder: Path, out: Path, recipe: CorrectionRecipe | None) -> Work[AssemblyReport]:
    """Assemble H of the points of a target's session that show positions."""
    from lfcal.acquire import TargetRecording
    from lfcal.campaign import iter_assemble_points
    from lfcal.frames import CorrectionRecipe, corrected_view
    from lfcal.targets import decoded

    with TargetRecording(folder) as source:
        view = corrected_view(source, recipe or CorrectionRecipe(), source.plan)
        return (yield from iter_assemble_points(decoded(view, source.target), source.target, out)).report
