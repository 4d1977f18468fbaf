"""Use: export H for another code, and reconstruct volumes from light fields.

- ``page``, ``panel``; ``_volume_view``: the volume rotated (``_solid_picture``) or from three sides (``model_volume``)
- ``_exporting``, ``export_model``: H as a file for another code; ``step``: both as commands
- ``model``: settings; ``model_solving``: light fields, the forecast, and a run that is stopped and continued
- ``_costing``: what accuracy costs
"""

from __future__ import annotations

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state, is_image


def state(project: ProjectState) -> PageState:
    """Return the state of the page: whether a volume is saved."""
    there = file_state(project.psf, ready=False) is PageState.DONE
    return file_state(project.volume, ready=there)


PAGE = PageSpec(
    "reconstruct",
    "Volume",
    "Export H, and turn a light field into a volume",
    order=80,
    package=__name__,
    state=state,
    place="use",
    needs="lfcal.reconstruct",
    takes=is_image,
    keys=(("Page up, Page down", "step through depth planes"), ("Home", "initial view of the volume")),
)
