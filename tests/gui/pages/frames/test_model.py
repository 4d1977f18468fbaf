from __future__ import annotations

from typing import Any

import numpy as np

from gui.pages.frames.model import Opened
from gui.pages.plan.model import default_plan
from lfcal.camera import preset
from lfcal.frames.source import Position


def opened(shape: tuple[int, int, int]) -> Opened:
    source: Any = None
    return Opened(source, None, np.zeros(shape, np.int64), default_plan(preset("bench")))


def test_positions_stay_within_the_frames_there_are() -> None:
    """A project with fewer planes than the one shown before."""
    frames = opened((2, 3, 4))
    assert frames.place(Position(5, 9, -1)) == (1, 2, 0)
    assert frames.place(Position(1, 2, 3)) == (1, 2, 3)


def test_steps_go_line_after_line() -> None:
    frames = opened((2, 3, 4))
    assert frames.step(Position(1, 0, 3), 0, 1) == (1, 1, 0)
    assert frames.step(Position(1, 0, 0), 0, -1) == (1, 2, 3)
    assert frames.step(Position(0, 2, 1), 1, 0) == (0, 0, 1)
    seen = {Position(0, 0, 0)}
    position = Position(0, 0, 0)
    for _ in range(11):
        position = frames.step(position, 0, 1)
        seen.add(position)
    assert len(seen) == 12
