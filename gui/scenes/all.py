"""All scenes by their names, in the order in which they are played."""

from __future__ import annotations

from gui.scenes.dialogs import dialogs
from gui.scenes.faults import faults
from gui.scenes.large import large
from gui.scenes.parts import parts
from gui.scenes.recording import recording
from gui.scenes.sample import sample
from gui.scenes.stage import Scene
from gui.scenes.start import empty
from gui.scenes.target import target
from gui.scenes.trouble import trouble

__all__ = ["SCENES"]

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
