"""H from the frames of a project, as ``lfcal assemble`` makes it. No Qt."""

from __future__ import annotations

from typing import TYPE_CHECKING

from gui.pages.frames.model import Opened
from lfcal.frames.corrections.recipe import check_turned_colours
from lfcal.frames.oriented import oriented
from lfcal.progress import Work
from lfcal.psf.upright import iter_upright

if TYPE_CHECKING:
    from lfcal.psf import AssemblyReport

__all__ = ["iter_assembly", "notes_of"]


def iter_assembly(opened: Opened, path: str) -> Work[AssemblyReport]:
    """Hold the frames against the plan's path, and assemble H from them, corrected and upright.

    Raises
    ------
    InputError
        As `lfcal.psf.upright.iter_upright` and `lfcal.psf.iter_assemble_plan`.
    """
    from lfcal.psf import AssemblySettings, iter_assemble_plan

    given = opened.delivered
    metadata = given.frames.metadata
    known = {"intake": list(metadata["notes"])} if "notes" in metadata else {}
    turn, lie = yield from iter_upright(given.corrected, opened.plan, given.orientation)
    upright = oriented(given.corrected, turn, opened.plan.camera.sensor.shape)
    check_turned_colours(given.frames, given.scan, given.recipe, lie["orientation"]["applied"])
    settings = AssemblySettings(interpolation=opened.interpolation)
    return (yield from iter_assemble_plan(upright, opened.plan, path, settings, provenance=known | lie))


def notes_of(report: AssemblyReport) -> tuple[str, ...]:
    """Return what a user should know of an H that was assembled, a line each."""
    told = report.matrix.provenance.get("orientation", {}).get("note")
    notes = (*([told] if told else []), *report.notes)
    return notes or ("complete: every position once, no saturated pixel",)
