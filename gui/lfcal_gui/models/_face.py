"""The public names of `lfcal_gui.models`: each is loaded on first access."""

from __future__ import annotations

from lfcal_gui.models.page import PageSpec, PageState
from lfcal_gui.models.settings import PageSettings

__all__ = [
    "PageSettings",
    "PageSpec",
    "PageState",
]
