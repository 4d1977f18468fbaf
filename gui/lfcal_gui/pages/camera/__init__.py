"""Camera: the description of optics, lenslets and sensor, with a drawing to scale."""

from __future__ import annotations

from pathlib import Path

from lfcal_gui.models import PageSpec, PageState, ProjectState

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether a camera was chosen: a new project begins with a preset."""
    untouched = project.plan is None and not project.psf and project.camera == ProjectState().camera
    return PageState.READY if untouched else PageState.DONE


def takes(path: str) -> bool:
    """Return whether a file is a description that no other page takes."""
    return Path(path).suffix.lower() in (".xml", ".yaml", ".yml", ".cfg")


PAGE = PageSpec(
    "camera",
    "Camera",
    "Describe main lens, lenslets and sensor",
    order=10,
    package=__name__,
    state=state,
    place="setup",
    needs="lfcal.camera",
    takes=takes,
)
