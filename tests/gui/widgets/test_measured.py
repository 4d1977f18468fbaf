"""One menu for every view of a picture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.context import Context
from lfcal_gui.widgets.frame_view import FrameView
from lfcal_gui.widgets.image_view import ImageView
from lfcal_gui.widgets.measured_part import MeasuredPart

IMAGE = np.arange(12, dtype=np.uint16).reshape(3, 4)


@pytest.fixture(params=["image", "frame", "part"])
def view(request: pytest.FixtureRequest, context: Context, qtbot: QtBot) -> Any:
    made: Any
    if request.param == "image":
        made = ImageView()
        made.set_image(IMAGE)
    elif request.param == "frame":
        made = FrameView(context.jobs, "frame")
        made.set_frame(IMAGE, (0.0, 11.0))
    else:
        owner = QWidget()
        qtbot.addWidget(owner)
        graphics = pg.GraphicsLayoutWidget(owner)
        made = MeasuredPart(owner, graphics.addPlot(), "slice", "counts", lambda _: None)
        made.take(IMAGE)
        made.owner = owner
    qtbot.addWidget(made)
    return made


def titles(view: Any) -> list[str]:
    return [text for text, _ in view.entries()]


def test_the_menu_follows_what_is_shown_and_what_was_chosen(view: Any) -> None:
    copied = [] if isinstance(view, FrameView) else ["Copy values"]
    first, last = "Contrast, profile, region …", "Save data …"
    assert titles(view) == [first, *copied, last]
    view.set_contrast((1.0, 2.0))
    assert titles(view) == [first, "Automatic contrast", *copied, last]
    dict(view.entries())["Automatic contrast"]()
    assert view.contrast is None and titles(view) == [first, *copied, last]
    assert view.quantity() and view.file_name()
    view.copy_data()
    assert QApplication.clipboard().text().splitlines()[1] == "4\t5\t6\t7"


def test_where_nothing_is_shown_nothing_is_offered(context: Context, qtbot: QtBot) -> None:
    for made in (ImageView(), FrameView(context.jobs, "frame")):
        qtbot.addWidget(made)
        assert made.entries() == []
