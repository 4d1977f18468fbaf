"""Where frames come from and how they are cleaned.

- ``source``: the protocol all frames share
"""

from lfcal.frames.source import FrameSource, Position

__all__ = ["FrameSource", "Position"]
