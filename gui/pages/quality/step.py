"""Inspection as a command. No Qt."""

from __future__ import annotations

from gui.models.project import ProjectState
from gui.models.step import Step, needed_file, options_of
from gui.pages.quality.model import QualitySettings

__all__ = ["step"]


def step(project: ProjectState) -> Step:
    """Return how H is inspected; a fit that is in no folder is not known to a command."""
    psf, chosen = needed_file(project.psf, "H", "PSF"), QualitySettings.of(project)
    saved = chosen.fit if chosen.camera == "saved" else ""
    pairs = (("--seconds", f"{chosen.seconds:g}"), ("--fit", saved), ("--report", "report"))
    python = f"""
from lfcal.inspect import iter_inspection
from lfcal.progress import drain
from lfcal.psf import open_psf
from lfcal.psf.quality import inspect

with open_psf({psf!r}) as H:
    quality = inspect(H)
    found = drain(iter_inspection(H, quality, seconds={chosen.seconds!r}))
    print(quality.merit, found.bad)
"""
    return Step(("inspect", psf, *options_of(pairs)), python)
