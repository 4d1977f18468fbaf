"""H from the frames of a project, as ``lfcal assemble`` makes it. No Qt."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

from lfcal.base import Work
from lfcal.frames import check_turned_colours, oriented
from lfcal.judge import judgement_of
from lfcal.psf import iter_upright
from lfcal_gui.models import going_on, stamp_of_files
from lfcal_gui.pages.frames.model import Opened

if TYPE_CHECKING:
    from lfcal.psf import AssemblyReport

__all__ = ["iter_assembly", "notes_of"]


def iter_assembly(opened: Opened, path: str) -> Work[AssemblyReport]:
    """Hold the frames against the plan's path, and assemble H from them, corrected and upright, plane by plane.

    Planes that are done stay where it is stopped; called again it goes on from them.

    Raises
    ------
    InputError
        As `lfcal.psf.upright.iter_upright` and `lfcal.psf.iter_assemble_plan`.
    """
    from lfcal.psf import AssemblySettings, Reopening, iter_assemble_plan

    given = opened.delivered
    notes = given.frames.metadata.notes
    known = {"intake": list(notes)} if notes else {}
    turn, lie = yield from iter_upright(given.corrected, opened.plan, given.orientation)
    upright = oriented(given.corrected, turn, opened.plan.camera.sensor.shape)
    check_turned_colours(given.frames, given.scan, given.recipe, lie["orientation"]["applied"])
    settings = AssemblySettings(interpolation=opened.interpolation)
    chosen = opened.chosen
    told = {
        "from": asdict(chosen),
        "plan": opened.plan.to_dict(),
        "turn": turn.name,
        "stamp": stamp_of_files(
            opened.folder, opened.chosen.dark, opened.chosen.white, opened.chosen.manifest, but=path
        ),
    }
    return (
        yield from iter_assemble_plan(
            upright,
            opened.plan,
            path,
            settings,
            provenance=known | lie,
            run=going_on(),
            reopening=Reopening("", told),
        )
    )


def notes_of(report: AssemblyReport) -> tuple[str, ...]:
    """Return the verdict on an H that was assembled, and how its frames were turned and averaged, a line each."""
    told = report.matrix.provenance.get("orientation", {}).get("note")
    return (judgement_of(report).verdict, *([told] if told else []), *report.notes)
