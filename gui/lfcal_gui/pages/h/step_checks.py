"""Inspection as a command. No Qt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lfcal.tasks import Inspect
from lfcal_gui.models import CommandStep, ProjectState, needed_file, stated_order
from lfcal_gui.pages.h.model_checks import QualitySettings


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that inspects H. A command can use the camera of a fit only if the fit was saved."""
    psf, chosen = needed_file(project.psf, "H", "H"), QualitySettings.of(project)
    given: dict[str, Any] = {"seconds": chosen.seconds, "session": chosen.session or None}
    given["mat_order"] = stated_order(project, psf)
    if chosen.seconds:  # further options concern only the comparison with the camera
        given |= {"patterns": chosen.patterns, "fit": chosen.fit if chosen.camera == "saved" else None}
    return CommandStep.of(Inspect(source=Path(psf), report=Path(out or "report"), **given))
