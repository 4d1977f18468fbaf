"""Quality: is the PSF good, what is wrong if not, and what to record again.

- ``page``, ``panel``; ``inspect_panel``: verdict, faults, metrics; ``evidence_view``: positions and pictures
- ``_showing``: which fault or metric is looked at
- ``_comparing``: a second H beside the first
- ``model``: settings, rows and words; ``model_run``: the work
"""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, kept_verdict, nothing, stamp_of

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether there is an H to judge, or what was found of it."""
    verdict = kept_verdict(project)
    if verdict is None:
        return PageState.NOTHING if stamp_of(project.psf) is None else PageState.READY
    return PageState.DONE if verdict.usable else PageState.ATTENTION


PAGE = PageSpec(
    "quality",
    "Quality",
    "Judge the PSF and find what to record again",
    order=60,
    package=__name__,
    state=state,
    place="h",
    needs="lfcal.judge",
    takes=nothing,
    keys=(("F5", "inspect H, or compare two"), ("Esc", "stop")),
)
