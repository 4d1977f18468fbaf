"""A recording and the assembly of its H, as commands and as work. No Qt."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.acquire import RedoList
from lfcal.base import InputError, Work
from lfcal.frames import CorrectionRecipe
from lfcal.tasks import Assemble, AssembleTarget, RunSettings, load_job
from lfcal_gui.models import PLAN_FILE, CommandStep, ProjectState, iter_made, needed_plan
from lfcal_gui.pages.acquire.model import AcquireSettings

if TYPE_CHECKING:
    from lfcal.frames import CorrectionRecipe
    from lfcal.psf import AssemblyReport

REDO_FILE = "lfcal-redo.json"


def task_of(folder: Path, out: Path, recipe: CorrectionRecipe) -> Assemble | AssembleTarget:
    """Return the task that makes H of a session."""
    from lfcal.acquire import NAME, SessionFile

    of_points = (folder / NAME).is_file() and SessionFile.read(folder).target is not None
    return (AssembleTarget if of_points else Assemble)(frames=folder, out=out, corrections=recipe)


def iter_assembly(folder: Path, out: Path, planes: list[int] | None, recipe: CorrectionRecipe) -> Work[AssemblyReport]:
    """Assemble H of a session: some of its planes while others are being recorded, or the whole session.

    If you stop it, completed planes are kept, and the next call continues with the others.

    Raises
    ------
    InputError
        As `lfcal.acquire.finish.iter_assemble_session`.
    """
    from lfcal.acquire import iter_assemble_session

    if planes is not None:
        return (yield from iter_assemble_session(folder, out, planes=planes, recipe=recipe))
    return (yield from iter_made(task_of(folder, out, recipe)))


def remade(folder: Path, psf: Path, out: Path, recipe: CorrectionRecipe) -> Assemble | AssembleTarget:
    """Return the task that makes the H ``psf`` of a session again, with the same settings, into ``out``.

    Raises
    ------
    InputError
        If ``psf`` is not H of all planes of this session.
    """
    from lfcal.acquire import SessionFile
    from lfcal.psf import open_psf

    session = SessionFile.read(folder)
    with open_psf(psf) as matrix:
        known, shape = matrix.provenance, matrix.shape[:3]
    if known.get("session", session.identity) != session.identity or shape != session.plan.shape[:3]:
        wanted = f"H of all planes of the session in {folder}"
        raise InputError.expected(
            psf.name,
            wanted,
            f"H of another session or other planes, of shape {shape}",
            "choose the folder of its session in Record > Rig",
        )
    made: Any = known.get("task")
    if psf.suffix == ".h5" and isinstance(made, dict) and made.get("task") == "assemble":
        task, _ = load_job(psf, {"frames": str(folder), "out": str(out)})
        if isinstance(task, (Assemble, AssembleTarget)):
            return task
    return task_of(folder, out, recipe)


def step(
    project: ProjectState, out: str = "", *, resume: bool = False, redo: Sequence[tuple[int, int, int]] = ()
) -> CommandStep:
    """Return the step that records or resumes the session, or that records positions again."""
    plan, chosen = needed_plan(project), AcquireSettings.of(project)
    begun, listed = resume or bool(redo), REDO_FILE if redo else ""
    out = out or project.recording or "session"
    origin = plan.stage.origin_um
    task = chosen.task(chosen.target or PLAN_FILE, out, begun=begun, redo=listed, origin=origin)
    files: tuple[tuple[str, str], ...] = () if chosen.target else ((PLAN_FILE, plan.to_json()),)
    files += ((REDO_FILE, RedoList.of(redo).to_json()),) if redo else ()
    return CommandStep.of(task, files, RunSettings(resume=resume))


def assembled(folder: str, out: str, planes: Sequence[int] | None, recipe: CorrectionRecipe) -> CommandStep:
    """Return the step that assembles H of a session with the dark frames and the white image in its folder."""
    if planes is not None:
        raise InputError.expected(
            "planes", "all", "single planes of a session that is being recorded", "wait until the session is complete"
        )
    return CommandStep.of(task_of(Path(folder), Path(out), recipe))
