"""Names of `lfcal_gui.pages.frames` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal_gui.pages.frames.model import FrameSettings
