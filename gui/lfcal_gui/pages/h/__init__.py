"""The place H: H and its transpose, its checks, the fit of the optics, and another H to compare with.

- ``page``, ``panel``: pictures and inspector; ``model``: what they show
- ``checks_view``: the checks; ``model_checks``: rows, words and the work
- ``fit_view``: the fit; ``model_fit``: settings, what an H offers, and what a fitted camera changes in the project;
  ``model_fit_run``: the work, rows and lines
"""

from __future__ import annotations

from pathlib import Path

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state, kept_verdict


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether there is an H, and whether it can be used without changes."""
    verdict = kept_verdict(project)
    bad = verdict is not None and not verdict.usable
    return PageState.ATTENTION if bad else file_state(project.psf, ready=False)


def takes(path: str) -> bool:
    """Return whether a file may be an H."""
    return Path(path).suffix.lower() in (".h5", ".mat", ".npy", ".lfc")


PAGE = PageSpec(
    "h",
    "H",
    "Look at H and its transpose, judge H, fit the optics, compare with another H",
    order=50,
    package=__name__,
    state=state,
    place="h",
    needs="lfcal.psf",
    takes=takes,
    keys=(
        ("←  →  ↑  ↓", "step through source positions"),
        ("Page up, Page down", "step through depth planes"),
        ("T", "HT alone, H alone, or both"),
        ("D", "difference from another H"),
        ("W", "the fitted pattern with the largest χ²"),
        ("F5", "inspect H, fit it, or compare it with another"),
        ("Backspace", "back to the verdict"),
        ("Esc", "stop"),
        ("Ctrl+C", "copy the table"),
        ("L, G", "log or gamma scaling of the images"),
    ),
)
