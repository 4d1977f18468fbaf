"""H from the frames of a project, as ``lfcal assemble`` makes it. No Qt."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import Work
from lfcal.judge import judgement_of
from lfcal.tasks import AssemblyRun
from lfcal_gui.models import going_on, stamp_of_files
from lfcal_gui.pages.frames.model import Opened, task_of

if TYPE_CHECKING:
    from lfcal.psf import AssemblyReport


def iter_assembly(opened: Opened, path: str) -> Work[AssemblyReport]:
    """Check the frames against the path of the plan, then assemble H plane by plane from the corrected frames.

    If you stop it, completed planes are kept, and the next call continues from them.

    Raises
    ------
    InputError
        As `lfcal.psf.upright.iter_upright` and `lfcal.psf.iter_assemble_plan`.
    """
    from lfcal.psf import Reopening
    from lfcal.tasks import ChannelPart

    given, chosen = opened.delivered, opened.chosen
    task = task_of(chosen, opened.folder, path)
    told = {
        "from": asdict(chosen),
        "plan": opened.plan.to_dict(),
        "stamp": stamp_of_files(
            opened.folder,
            *(chosen.dark, chosen.white, chosen.manifest, str(task.fill or ""), str(task.leave_out or "")),
            but=path,
        ),
    }
    part = ChannelPart(given.frames, opened.plan, given.recipe.channel, Path(path))
    how = AssemblyRun(going_on(), reopening=Reopening("", told))
    made = yield from task.iter_part(part, given.scan, given.recipe, given.corrected, how)
    return made.report


def notes_of(report: AssemblyReport) -> tuple[str, ...]:
    """Return the verdict on an H that was assembled, and how its frames were turned and averaged, a line each."""
    told = report.matrix.provenance.get("orientation", {}).get("note")
    return (judgement_of(report).verdict, *([told] if told else []), *report.notes)
