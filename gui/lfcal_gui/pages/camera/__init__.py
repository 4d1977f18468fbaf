"""Camera: the description of optics, lenslets and sensor, with a drawing to scale."""

from __future__ import annotations

from pathlib import Path

from lfcal_gui.models import PageSpec, PageState, ProjectState, Sketch

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether a camera was chosen: a new project begins with a preset."""
    untouched = project.plan is None and not project.psf and project.camera == ProjectState().camera
    return PageState.READY if untouched else PageState.DONE


def icon(sketch: Sketch) -> None:
    """Draw a camera body with its lens."""
    sketch.box(2, 6, 18, 12, radius=2)
    sketch.circle(11, 12, 3.6)
    sketch.line((7, 6), (8.5, 3.5), (13.5, 3.5), (15, 6))


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
    needs="lfcal.camera",
    icon=icon,
    takes=takes,
)
