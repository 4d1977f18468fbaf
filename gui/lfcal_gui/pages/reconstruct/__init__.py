"""Reconstruct: what the PSF is worth: a light field becomes a volume.

- ``page``, ``panel``; ``_volume_view``: the volume turned (``_solid_picture``) or from three sides (``model_volume``)
- ``model``: settings, light fields; ``model_solving``: a reconstruction that can be stopped and gone on with
"""

from __future__ import annotations

from pathlib import Path

from lfcal_gui.models import PageSpec, PageState, ProjectState, file_state

__all__ = ["PAGE"]


def state(project: ProjectState) -> PageState:
    """Return whether a volume is saved."""
    there = file_state(project.psf, ready=False) is PageState.DONE
    return file_state(project.volume, ready=there)


def takes(path: str) -> bool:
    """Return whether a file may be a picture."""
    from lfcal.frames.formats import image_suffixes

    return Path(path).is_file() and Path(path).suffix.lower() in image_suffixes()


PAGE = PageSpec(
    "reconstruct",
    "Reconstruct",
    "Turn a light field into a volume",
    order=80,
    package=__name__,
    state=state,
    place="use",
    needs="lfcal.reconstruct",
    takes=takes,
)
