"""The sample session as a session of the window."""

from __future__ import annotations

from pathlib import Path

from gui.models.project import FrameSettings, SessionState
from lfcal.camera import ScanPlan
from lfcal.cli.sample import sample_session

__all__ = ["demo_state"]


def demo_state(folder: Path) -> SessionState:
    """Return the sample session with H assembled; ``folder`` keeps the H file from one start to the next."""
    session = sample_session()
    plan = ScanPlan.from_json((session / "plan.json").read_text(encoding="utf-8"))
    target = folder / "sample_H.h5"
    if not target.is_file():
        _assemble(session, plan, target)
    frames = FrameSettings(folder=str(session / "frames"), dark=str(session / "dark"), white=str(session / "white"))
    return SessionState("sample session", plan.camera, plan, frames, psf=str(target))


def _assemble(session: Path, plan: ScanPlan, target: Path) -> None:
    from lfcal.frames import open_frames
    from lfcal.frames.corrections.recipe import CorrectionRecipe, build_chain
    from lfcal.psf import Cutout, assemble

    with open_frames(session / "frames", plan_shape=plan.shape[:3]) as source:
        chain = build_chain(source, CorrectionRecipe(session / "dark", session / "white"))
        report = assemble(
            source,
            plan.shape[:3],
            Cutout.for_plan(plan),
            out=target,
            corrections=chain,
            depths=plan.depths_um,
            camera=plan.camera,
            provenance={"plan": plan.to_dict()},
        )
    report.matrix.close()
