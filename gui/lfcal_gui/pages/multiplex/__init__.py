"""Multiplexing: filters, masks and lenslets in one formalism, their noise, and reconstructions from their frames.

- ``page``, ``panel``; ``_pictures``: the reconstructions side by side
- ``model``: fields, settings, modulators; ``model_compare``: numbers, gains, and searches
- ``model_scene``: scenes and frames, and their reconstruction by every route
- ``figures_view``: the figures of the paper; ``search_view``: designs that can be made
"""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, is_image


def state(project: ProjectState) -> PageState:
    """Return the state of the page, which needs no part of the project."""
    return PageState.READY


PAGE = PageSpec(
    "multiplex",
    "Multiplexing",
    "Compare filters, masks and lenslets",
    order=90,
    package=__name__,
    state=state,
    needs="lfcal.multiplex",
    takes=is_image,
)
