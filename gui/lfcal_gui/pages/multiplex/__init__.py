"""Multiplexing: filters, masks and lenslets in one language, their noise, and what reconstructs from them.

- ``page``, ``panel``; ``_pictures``: the reconstructions side by side; ``matrix_view``: a matrix as a picture
- ``model``: settings, modulators; ``model_compare``: numbers and gains
- ``model_scene``: scenes, their reconstruction; ``model_routes``: transmissions of every pixel, the camera's lattice
- ``_drawing``, ``figures_view``: the figures of the paper; ``search_view``, ``model_search``: designs that can be made
"""

from __future__ import annotations

from pathlib import Path

from lfcal_gui.models import PageSpec, PageState, ProjectState, Sketch

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return that it needs nothing of the project."""
    return PageState.READY


def icon(sketch: Sketch) -> None:
    """Draw a colour filter array."""
    sketch.box(3, 3, 16, 16)
    sketch.box(4, 4, 6, 6, filled=True)
    sketch.box(12, 12, 6, 6, filled=True)


def takes(path: str) -> bool:
    """Return whether a file may be a picture."""
    from lfcal.frames.formats import image_suffixes

    return Path(path).is_file() and Path(path).suffix.lower() in image_suffixes()


PAGE = PageSpec(
    "multiplex",
    "Multiplexing",
    "Compare filters, masks and lenslets",
    order=90,
    package=__name__,
    state=state,
    needs="lfcal.multiplex",
    icon=icon,
    takes=takes,
)
