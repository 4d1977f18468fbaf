"""All scenes by name, in their order."""

from __future__ import annotations

from lfcal_gui.scenes.parts import empty, large, parts, target
from lfcal_gui.scenes.recording import recording
from lfcal_gui.scenes.sample import sample
from lfcal_gui.scenes.stage import Scene
from lfcal_gui.scenes.trouble import dialogs, faults, trouble

SCENES: dict[str, Scene] = {
    "empty": empty,
    "sample": sample,
    "parts": parts,
    "dialogs": dialogs,
    "trouble": trouble,
    "faults": faults,
    "large": large,
    "recording": recording,
    "target": target,
}
