"""A reconstruction as a command. No Qt."""

from __future__ import annotations

from lfcal.base import InputError
from lfcal.tasks import python_of, words_of
from lfcal_gui.models import CommandStep, ProjectState, needed_file, stated_order
from lfcal_gui.pages.reconstruct.model import ReconstructSettings, task_of

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the light field becomes a volume."""
    psf = needed_file(project.psf, "H", "PSF")
    frame, chosen = needed_file(project.light_field, "light field", "Reconstruct"), ReconstructSettings.of(project)
    if chosen.region:
        raise InputError.expected("region", "the whole light field", chosen.region, "a command takes all of it")
    task = task_of(chosen, psf, frame, out or "volume.tif", stated_order(project, psf))
    return CommandStep(words_of(task), python_of(task))
