"""What other packages of lfcal use of `lfcal_gui.scenes`, and nobody else: it may change."""

from __future__ import annotations

from lfcal_gui.scenes.all import SCENES
from lfcal_gui.scenes.stage import Shot, Stage

__all__ = [
    "SCENES",
    "Shot",
    "Stage",
]
