"""The sample session as a project of the window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from lfcal.base import Work, sample_session
from lfcal.camera import ScanPlan
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.frames import FrameSettings

__all__ = ["iter_demo"]


def iter_demo(folder: Path) -> Work[ProjectState]:
    """Return a project of the sample session with H assembled, which ``folder`` keeps for the next start."""
    session = sample_session()
    plan = ScanPlan.from_json((session / "plan.json").read_text(encoding="utf-8"))
    target = folder / "sample_H.h5"
    if not target.is_file():
        yield from _assemble(session, plan, target)
    corrections = FrameSettings(dark=str(session / "dark"), white=str(session / "white"))
    made = ProjectState("sample", plan.camera, plan, frames=str(session / "frames"), psf=str(target))
    return replace(made, settings=corrections.into(made))


def _assemble(session: Path, plan: ScanPlan, target: Path) -> Work[None]:
    from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
    from lfcal.psf import iter_assemble_plan

    with open_frames(session / "frames", plan_shape=plan.shape[:3]) as source:
        recipe = CorrectionRecipe(dark=session / "dark", white=session / "white")
        report = yield from iter_assemble_plan(corrected_view(source, recipe, plan), plan, target)
    report.matrix.close()
