"""Set up: description of the camera, and plan of the scan with its appearance and cost."""

from __future__ import annotations

from pathlib import Path

from lfcal_gui.models import PageSpec, PageState, ProjectState


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether there is a plan."""
    return PageState.READY if project.plan is None else PageState.DONE


def takes(path: str) -> bool:
    """Return whether a file may be a plan, or a camera that no other page takes."""
    return Path(path).suffix.lower() in (".json", ".xml", ".yaml", ".yml", ".cfg")


PAGE = PageSpec(
    "setup",
    "Set up",
    "Drag the cutout to move the scan. Dashed: area of all cutouts",
    order=10,
    package=__name__,
    state=state,
    place="setup",
    needs="lfcal.camera",
    keys=(("Arrow keys", "move the scan by a pixel, when the image has the focus"),),
    takes=takes,
)
