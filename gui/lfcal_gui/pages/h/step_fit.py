"""A fit as a command. No Qt."""

from __future__ import annotations

from pathlib import Path

from lfcal.psf import open_psf
from lfcal_gui.models import CommandStep, ProjectState, needed_file
from lfcal_gui.pages.h.model_fit import FitSettings, Offer, offer_of, task_files, task_of


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return the step that fits the camera to H; files and unknowns depend on the data in H."""
    psf, offer = needed_file(project.psf, "H", "H"), None
    if Path(psf).is_file():
        with open_psf(psf) as matrix:
            offer = offer_of(matrix)
    return step_as(FitSettings.of(project), project, offer, out or "fit")


def step_as(settings: FitSettings, project: ProjectState, offer: Offer | None, out: str) -> CommandStep:
    """Return the step for given settings and the data that H offers."""
    files = task_files(settings, project, offer)
    return CommandStep.of(task_of(settings, project, offer, Path(out)), files)
