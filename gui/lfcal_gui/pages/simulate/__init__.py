"""Simulate: only the effects the scene calls for, and what accuracy costs in time."""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state, nothing

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether there is a simulated H to compare with."""
    return file_state(project.reference, ready=True)


PAGE = PageSpec(
    "simulate",
    "Simulate",
    "Compute the PSF of the described camera",
    order=70,
    package=__name__,
    state=state,
    place="record",
    needs="lfcal.simulate",
    takes=nothing,
)
