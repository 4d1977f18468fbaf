"""Record > Compute: compute H with the effects that it needs, and show what accuracy costs."""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state, nothing


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether the project has an H to compare with."""
    return file_state(project.reference, ready=True)


PAGE = PageSpec(
    "simulate",
    "Compute",
    "Compute H of the described camera",
    order=70,
    package=__name__,
    state=state,
    place="record",
    needs="lfcal.simulate",
    takes=nothing,
    keys=(("F5", "measure what accuracy costs"), ("Esc", "stop computing or measuring")),
)
