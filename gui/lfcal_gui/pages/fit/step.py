"""A fit as a command. No Qt."""

from __future__ import annotations

from pathlib import Path

from lfcal.tasks import FitMatrix, python_of, words_of
from lfcal_gui.models import CAMERA_FILE, CommandStep, ProjectState, needed_file
from lfcal_gui.pages.fit.model import FitSettings

__all__ = ["step"]


def step(project: ProjectState, out: str = "") -> CommandStep:
    """Return how the camera is fitted to H."""
    psf, chosen = needed_file(project.psf, "H", "PSF"), FitSettings.of(project)
    own, unknowns = chosen.camera == "psf", chosen.unknowns
    task = FitMatrix(
        sources=(Path(psf),),
        out=Path(out or "fit"),
        camera="" if own else CAMERA_FILE,
        positions=chosen.positions,
        unknowns=unknowns if isinstance(unknowns, str) else ",".join(unknowns),
        noise=chosen.noise,
    )
    files = () if own else ((CAMERA_FILE, project.camera.to_json()),)
    return CommandStep(words_of(task), python_of(task), files)
