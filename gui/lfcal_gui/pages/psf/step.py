"""Export of H as a command. No Qt."""

from __future__ import annotations

from lfcal_gui.models import CommandStep, ProjectState, needed_file, stated_order
from lfcal_gui.pages.psf.export_model import ExportIntent, export_task

__all__ = ["step"]


def step(project: ProjectState, out: str = "", intent: ExportIntent | None = None) -> CommandStep:
    """Return how H is exported: for MATLAB where nothing else was asked for."""
    psf, out = needed_file(project.psf, "H", "PSF"), out or "H.mat"
    return CommandStep.of(export_task(psf, out, intent or ExportIntent.of_path(out), stated_order(project, psf)))
