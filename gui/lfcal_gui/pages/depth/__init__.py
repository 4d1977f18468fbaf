"""Use > Depth: a depth map of one light-field frame.

- ``page``, ``panel``; ``model``: settings, the task, and what the picture shows; ``step``: the task as a command
"""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, nothing


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether there is a frame."""
    return PageState.READY if project.light_field else PageState.NOTHING


PAGE = PageSpec(
    "depth",
    "Depth",
    "Measure the depth of everything with texture in a light-field frame",
    order=85,
    package=__name__,
    state=state,
    place="use",
    needs="lfcal.lattice",
    takes=nothing,
    keys=(("F5", "measure depth"), ("V", "depth or the frame"), ("Esc", "stop measuring")),
)
