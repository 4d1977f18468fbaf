"""Frames: look at them, clean them, see the cutout move with the point, assemble H."""

from __future__ import annotations

from gui.models.page import PageSpec, PageState, Sketch, file_state
from gui.models.project import ProjectState

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether frames are imported."""
    return file_state(project.frames, ready=True)


def icon(sketch: Sketch) -> None:
    """Draw two frames, one behind the other."""
    sketch.box(3, 7, 12, 12)
    sketch.line((6, 4), (18, 4), (18, 16))


PAGE = PageSpec(
    "frames",
    "Frames",
    "Import frames, correct them, crop them",
    order=40,
    package=__name__,
    state=state,
    needs="lfcal.frames",
    icon=icon,
    keys=(
        ("←  →  ↑  ↓", "step through source positions"),
        ("Page up, Page down", "step through depth planes"),
        ("Space", "play or stop"),
        ("L, G", "log or gamma scaling of the pictures"),
    ),
)
