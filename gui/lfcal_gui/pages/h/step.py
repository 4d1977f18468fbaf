"""Export of H as a command. No Qt."""

from __future__ import annotations

from pathlib import Path

from lfcal.psf import regions_of
from lfcal.tasks import task_set
from lfcal_gui.models import CommandStep, ProjectState, needed_file, stated_order


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that exports the displayed region of H for MATLAB, or in the format of the suffix."""
    psf = needed_file(project.psf, "H", "H")
    shown, *others = regions_of(psf) if Path(psf).is_file() else ("",)
    given = {"region": shown if others else "", "mat_order": stated_order(project, psf)}
    given = {name: value for name, value in given.items() if value}
    return CommandStep.of(task_set("export").make({"source": psf, "out": out or "H.mat", **given}, str))
