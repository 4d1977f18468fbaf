"""Accuracy: error against cost in each step of the work; a click in the chart applies a setting.

- ``page``, ``panel``: the parts, and the curve of the selected part
- ``model``: settings, measurements, words, and what a point changes in the project
"""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state, nothing


def state(project: ProjectState) -> PageState:
    """Return whether there is a plan or H to measure; measurements are not kept in the project."""
    there = project.plan is not None or file_state(project.psf, ready=False) is PageState.DONE
    return PageState.READY if there else PageState.NOTHING


PAGE = PageSpec(
    "accuracy",
    "Accuracy",
    "Error and cost of each part of the processing",
    order=95,
    package=__name__,
    state=state,
    needs="lfcal.accuracy",
    takes=nothing,
    keys=(("F5", "measure"), ("Esc", "stop measuring")),
)
