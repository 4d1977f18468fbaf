"""Record > Folder: view recorded frames with their cutouts, correct them, and assemble H."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import lazy_face
from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state

if TYPE_CHECKING:
    from lfcal_gui.pages.frames._shared import *  # noqa: F403


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether frames are imported."""
    return file_state(project.frames, ready=True)


def takes(path: str) -> bool:
    """Return whether a path is a folder, or may be a list of frames."""
    from lfcal.frames.lists import TABLE_SUFFIXES

    return Path(path).is_dir() or Path(path).suffix.lower() in TABLE_SUFFIXES


PAGE = PageSpec(
    "frames",
    "Folder",
    "Import frames, correct them and extract their cutouts",
    order=40,
    package=__name__,
    state=state,
    place="record",
    needs="lfcal.frames",
    takes=takes,
    keys=(
        ("←  →  ↑  ↓", "step through source positions"),
        ("Page up, Page down", "step through depth planes"),
        ("Space", "play or stop"),
        ("Esc", "stop assembling"),
        ("L, G", "log or gamma scaling of the images"),
    ),
)

lazy_face(__name__)
