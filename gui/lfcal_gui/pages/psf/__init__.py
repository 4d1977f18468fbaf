"""PSF: H and its transpose, at once, for any plane and position."""

from __future__ import annotations

from pathlib import Path

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether there is an H."""
    return file_state(project.psf, ready=False)


def takes(path: str) -> bool:
    """Return whether a file may be an H."""
    return Path(path).suffix.lower() in (".h5", ".mat", ".npy", ".lfc")


PAGE = PageSpec(
    "psf",
    "PSF",
    "Look at H and its transpose",
    order=50,
    package=__name__,
    state=state,
    place="h",
    needs="lfcal.psf",
    takes=takes,
    keys=(
        ("←  →  ↑  ↓", "step through source positions"),
        ("Page up, Page down", "step through depth planes"),
        ("T", "H or its transpose"),
        ("L, G", "log or gamma scaling of the pictures"),
    ),
)
