"""Sessions: gallery of recordings and results, quality over time, and comparison of two results.

- ``page``, ``panel``; ``_tiles``: the results as tiles; ``_looking``: folders looked through in the background
- ``_pairing``: two results compared; ``trend_panel``: reports over time
- ``model``: selection, order and texts of the results; ``model_kept``: cache of images and verdicts
- ``model_trend``: rows and curves of reports over time
"""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, nothing


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether the project has a file."""
    return PageState.READY if project.psf or project.frames or project.recording else PageState.NOTHING


PAGE = PageSpec(
    "sessions",
    "Sessions",
    "Find earlier recordings, H, fits and exports, and compare two of them",
    order=100,
    package=__name__,
    state=state,
    needs="lfcal.judge",
    takes=nothing,
    keys=(
        ("F5", "search the folder again"),
        ("Return", "open the selected result"),
        ("Ctrl+D", "compare the two selected results"),
    ),
)
