"""Large frames: values follow the frame, and nothing of an earlier one is drawn late."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from PySide6.QtCore import QEvent, QPointF
from pytestqt.qtbot import QtBot

from lfcal_gui.context import Context
from lfcal_gui.widgets.frame_view import FrameView
from tests.gui.waiting import GUARD_MS, idle


def made(context: Context, qtbot: QtBot) -> FrameView:
    view = FrameView(context.jobs, "frame")
    qtbot.addWidget(view)
    view.resize(300, 260)
    view.show()
    qtbot.waitExposed(view, timeout=GUARD_MS)
    return view


def test_a_resting_pointer_tells_the_value_of_the_new_frame(context: Context, qtbot: QtBot) -> None:
    view, told = made(context, qtbot), []
    view.set_frame(np.zeros((3, 3), np.uint16), (0, 9))
    view.hovered.connect(lambda *found: told.append(found))
    view._moved(view.plot.vb.mapViewToScene(QPointF(1.0, 1.0)))
    view.set_frame(np.full((3, 3), 7, np.uint16), (0, 9))
    assert told == [(1, 1, 0.0), (1, 1, 7.0)]
    view.set_frame(None, (0, 1))
    assert told[-1][0] == -1
    view.leaveEvent(QEvent(QEvent.Type.Leave))
    seen = len(told)
    view.set_frame(np.ones((3, 3), np.uint16), (0, 9))
    assert len(told) == seen
    idle(context.jobs, qtbot)


def test_a_frame_that_is_taken_away_is_not_drawn_late(context: Context, qtbot: QtBot) -> None:
    view = made(context, qtbot)
    view.set_frame(np.ones((30, 30), np.uint16), (0, 9))
    view.set_frame(None, (0, 1))
    idle(context.jobs, qtbot)
    assert view.item.image is None


def test_a_cutout_comes_with_the_picture_of_its_frame(qtbot: QtBot) -> None:
    """Frames came faster than they were drawn: the cutout of one lay over the light of another."""
    jobs = Held()
    view = FrameView(jobs, "frame")  # type: ignore[arg-type]
    qtbot.addWidget(view)
    for k in range(3):
        frame = np.zeros((40, 40), np.uint16)
        frame[10 * k, 5] = 100
        view.set_frame(frame, (0, 100), lambda k=k: view.set_cutout(10 * k, 5, (1, 1), (10.0 * k, 5.0)))  # type: ignore[misc]
    drawn = []
    while jobs.asked:
        jobs.answer()
        top = float(view.cutout.getData()[1][0]) + 0.5
        drawn.append((int(np.argmax(view.item.image.max(axis=1))), top))
    assert drawn == [(0, 0.0), (20, 20.0)], "a late picture with its own cutout, then the newest"


def test_a_late_picture_without_a_cutout_is_dropped(qtbot: QtBot) -> None:
    jobs = Held()
    view = FrameView(jobs, "frame")  # type: ignore[arg-type]
    qtbot.addWidget(view)
    for k in range(2):
        view.set_frame(np.full((40, 40), k, np.uint16), (0, 1))
    jobs.answer()
    assert view.item.image is None
    jobs.answer()
    assert view.item.image is not None and not jobs.asked


class Held:
    """Computes when it is asked to."""

    def __init__(self) -> None:
        self.asked: list[tuple[Callable[[], Any], Callable[[Any], None]]] = []

    def compute(self, _: str, work: Callable[[], Any], done: Callable[[Any], None], *others: Any) -> None:
        self.asked.append((work, done))

    def answer(self) -> None:
        work, done = self.asked.pop(0)
        done(work())
