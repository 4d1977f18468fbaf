"""Fit: the optics from a few recorded positions, and what is made of them.

- ``page``, ``panel``; ``_results``: what is made of a fit; ``_choices_panel``: what is fitted
- ``_found_tabs``: what a fit found, made when one has
- ``patterns_view``, ``_place_map``: measured, model and residual of a position, and where it is
- ``rounds_view``: how the fit converges
- ``model``: settings, and what an H offers; ``model_run``: the fit as work; ``model_words``: rows and lines
- ``model_use``: what a fitted camera changes in the project
"""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, nothing, stamp_of

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether there is an H to fit."""
    return PageState.NOTHING if stamp_of(project.psf) is None else PageState.READY


PAGE = PageSpec(
    "fit",
    "Fit",
    "Find the camera from a few positions",
    order=65,
    package=__name__,
    state=state,
    place="h",
    needs="lfcal.fit",
    takes=nothing,
    keys=(
        ("F5", "fit"),
        ("Esc", "stop the fit"),
        ("←  →", "step through the patterns of a plane"),
        ("Page up, Page down", "step through depth planes"),
        ("W", "the pattern that is explained worst"),
        ("Ctrl+C", "copy the table"),
    ),
)
