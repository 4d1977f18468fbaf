"""Plan: where the point source goes, what is kept around its image, and what the scan costs."""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether there is a plan."""
    return PageState.READY if project.plan is None else PageState.DONE


def takes(path: str) -> bool:
    """Return whether a file may be a plan."""
    return path.endswith(".json")


PAGE = PageSpec(
    "plan",
    "Plan",
    "Choose planes and cutout; see what the scan costs",
    order=20,
    package=__name__,
    state=state,
    place="setup",
    needs="lfcal.camera",
    takes=takes,
)
