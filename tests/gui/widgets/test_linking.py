"""Pictures that are moved together."""

from __future__ import annotations

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from lfcal_gui.widgets.image_view import ImageView
from lfcal_gui.widgets.linking import link_views


def test_moving_one_moves_the_other(qtbot: QtBot) -> None:
    views = [ImageView(), ImageView()]
    for view in views:
        qtbot.addWidget(view)
        view.resize(300, 260)
        view.show()
        view.set_image(np.eye(50))
    link_views(views)
    first, second = (view.plot.vb for view in views)
    first.setRange(xRange=(10, 20), yRange=(10, 20), padding=0)
    first.sigRangeChangedManually.emit(first.mouseEnabled())
    assert second.viewRect().center().x() == pytest.approx(15) == second.viewRect().center().y()
    assert second.viewRect().width() == pytest.approx(first.viewRect().width(), rel=0.05)
    views[1].show_all()
    assert first.viewRect().width() >= 50
