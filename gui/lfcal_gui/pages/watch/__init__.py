"""Watch: whether H is still valid for each frame of a series, and recalibration if it is not.

- ``page``, ``panel``; ``model``: settings, the task, and rows of the table; ``step``: the task as a command
"""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state, nothing


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether there is an H to watch."""
    there = file_state(project.psf, ready=False) is PageState.DONE
    return PageState.READY if there else PageState.NOTHING


PAGE = PageSpec(
    "watch",
    "Watch H",
    "Check with ordinary frames whether H is still valid, and recalibrate it if it is not",
    order=97,
    package=__name__,
    state=state,
    needs="lfcal.recalibrate",
    takes=nothing,
    keys=(("F5", "check the frames"), ("Esc", "stop")),
)
