"""What other packages of lfcal use of `lfcal_gui.pages.frames`, and nobody else: it may change."""

from __future__ import annotations

from lfcal_gui.pages.frames.model import FrameSettings

__all__ = [
    "FrameSettings",
]
