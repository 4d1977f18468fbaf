"""Names of `lfcal_gui.scenes` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal_gui.scenes.all import SCENES
from lfcal_gui.scenes.stage import Capture, Stage
