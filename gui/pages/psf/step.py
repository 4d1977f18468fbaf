"""Export of H as a command. No Qt."""

from __future__ import annotations

from gui.models.project import ProjectState
from gui.models.step import Step, needed_file

__all__ = ["step"]


def step(project: ProjectState) -> Step:
    """Return how H is exported for MATLAB."""
    psf = needed_file(project.psf, "H", "PSF")
    python = f"""
from lfcal.psf import export, open_psf

with open_psf({psf!r}) as H:
    print(H.shape, H.depths, H.T[0, 0, 0].sum())
    export(H, "H.mat")
"""
    return Step(("export", psf, "--out=H.mat"), python)
