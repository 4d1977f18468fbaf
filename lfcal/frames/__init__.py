"""Where frames come from and how they are cleaned.

- ``source``: the protocol all frames share
- ``stack``: frames of one array, memory map or dataset
- ``regions``: parts of a frame, read without the rest where the source can
- ``cfa``: colour filter patterns
- ``steps``, ``defects``, ``background``: single corrections
- ``corrections``: the ordered chain of them
- ``corrected_source``: a source seen through a chain
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.frames.background import Background
    from lfcal.frames.corrected_source import CorrectedSource, corrected
    from lfcal.frames.corrections import CorrectionChain
    from lfcal.frames.defects import Defects
    from lfcal.frames.regions import read_region
    from lfcal.frames.source import FrameSource, Position
    from lfcal.frames.stack import ArraySource, frame_drift, frame_exposure
    from lfcal.frames.steps import Dark, Exposure, White, average_frames

_HOME = {
    "ArraySource": "stack",
    "Background": "background",
    "CorrectedSource": "corrected_source",
    "CorrectionChain": "corrections",
    "Dark": "steps",
    "Defects": "defects",
    "Exposure": "steps",
    "FrameSource": "source",
    "Position": "source",
    "White": "steps",
    "average_frames": "steps",
    "corrected": "corrected_source",
    "frame_drift": "stack",
    "frame_exposure": "stack",
    "read_region": "regions",
}

__all__ = [
    "ArraySource",
    "Background",
    "CorrectedSource",
    "CorrectionChain",
    "Dark",
    "Defects",
    "Exposure",
    "FrameSource",
    "Position",
    "White",
    "average_frames",
    "corrected",
    "frame_drift",
    "frame_exposure",
    "read_region",
]


def __getattr__(name: str) -> Any:
    if name in _HOME:
        return getattr(import_module(f"lfcal.frames.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
