"""Large frames: values follow the frame, and nothing of an earlier one is drawn late."""

from __future__ import annotations

import numpy as np
from PySide6.QtCore import QEvent, QPointF
from pytestqt.qtbot import QtBot

from gui.context import Context
from gui.widgets.frame_view import FrameView
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
