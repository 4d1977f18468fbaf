"""The public names of `lfcal_gui`: each is loaded on first access."""

from __future__ import annotations

from lfcal_gui.base_page import BasePage

__all__ = [
    "BasePage",
]
