"""Simulate: only the effects the scene calls for, and what accuracy costs in time."""

from __future__ import annotations

import math

from lfcal_gui.models import PageSpec, PageState, ProjectState, Sketch, file_state, nothing

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether there is a simulated H to compare with."""
    return file_state(project.reference, ready=True)


def icon(sketch: Sketch) -> None:
    """Draw a wave."""
    sketch.line(*((2 + x / 2, 11 - 7.8 * math.sin(2 * math.pi * x / 36)) for x in range(37)))


PAGE = PageSpec(
    "simulate",
    "Simulate",
    "Compute the PSF of the described camera",
    order=70,
    package=__name__,
    state=state,
    needs="lfcal.simulate",
    icon=icon,
    takes=nothing,
)
