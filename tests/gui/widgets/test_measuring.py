"""Contrast, line and region of a picture, and the menu of every picture and plot."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QPointF
from PySide6.QtWidgets import QApplication, QMenu, QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.jobs import Jobs
from lfcal_gui.models.shot import Shot
from lfcal_gui.widgets.picture import LARGE, Picture
from lfcal_gui.widgets.plots import LinePlot
from tests.gui.waiting import GUARD_MS, idle

R, C = np.mgrid[:40, :60]
SPOT = (100 + 1000 * np.exp(-((R - 20) ** 2 + (C - 30) ** 2) / 32)).astype(np.float32)


@pytest.fixture
def jobs(qapp: QApplication) -> Iterator[Jobs]:
    made = Jobs()
    yield made
    made.close()


def shown(widget: Any, qtbot: QtBot) -> Any:
    qtbot.addWidget(widget)
    widget.resize(360, 300)
    widget.show()
    qtbot.waitExposed(widget, timeout=GUARD_MS)
    return widget


def entries(widget: QWidget) -> dict[str, Any]:
    """Return the menu of a right click by its words."""
    widget.customContextMenuRequested.emit(QPoint(5, 5))
    menu = widget.findChildren(QMenu)[-1]
    found = {action.text(): action for action in menu.actions()}
    menu.hide()
    return found


@pytest.fixture(params=["small", "large"])
def view(request: pytest.FixtureRequest, qtbot: QtBot, jobs: Jobs) -> Any:
    """Return a picture of a spot that is drawn at once, or in the background."""
    made = shown(Picture(jobs=jobs), qtbot)
    values = SPOT if request.param == "small" else np.pad(SPOT, ((0, 600), (0, LARGE // 600)), constant_values=100)
    made.set_shot(Shot(values, levels=(0.0, 2000.0)))
    idle(jobs, qtbot)
    return made


def test_chosen_levels_stay_with_the_next_picture(view: Any, qtbot: QtBot, jobs: Jobs) -> None:
    window = view.measure()
    assert window.contrast.levels == (0.0, 2000.0), "the handles stand where the page put the scale"
    window.contrast.set_levels((200.0, 700.0))
    idle(jobs, qtbot)
    assert view.levels == (200.0, 700.0)
    assert view.item.image.max() == 255 and view.item.image.min() == 0, "values beyond the handles are cut off"
    view.set_shot(Shot(view.values + 1, levels=(0.0, 2000.0)))
    idle(jobs, qtbot)
    assert view.levels == (200.0, 700.0)
    entries(view)["Automatic contrast"].trigger()
    idle(jobs, qtbot)
    assert view.levels == (0.0, 2000.0) == window.contrast.levels
    assert "Automatic contrast" not in entries(view)


def test_line_and_region_are_measured_where_they_lie(view: Any, qtbot: QtBot, jobs: Jobs) -> None:
    window = view.measure()
    window.line.setPos((0, 0))
    for handle, (x, y) in zip(window.line.getHandles(), ((8, 20), (52, 20)), strict=True):
        window.line.movePoint(handle, QPointF(x, y))
    window.region.setPos((27.5, 17.5))
    window.region.setSize((5, 5))
    window.measure()
    assert "44.0 px long, FWHM 9.4" in window.profile_words.text()
    assert "5 × 5 px, rows 18 to 22, columns 28 to 32" in window.region_words.text()
    assert "centroid row 20.00, column 30.00" in window.region_words.text()
    before = len(view.box.addedItems)
    window.close()
    assert len(view.box.addedItems) == before - 2, "line and rectangle go with their window"
    idle(jobs, qtbot)


def test_a_picture_in_axis_units_is_measured_in_its_pixels(qtbot: QtBot) -> None:
    view = shown(Picture(), qtbot)
    view.set_shot(Shot(SPOT, origin=(-20.0, -30.0)))
    window = view.measure()
    window.region.setPos((-2.5, -2.5))
    window.region.setSize((5, 5))
    window.measure()
    assert "centroid row 20.00, column 30.00" in window.region_words.text()
    view.set_shot(None)
    window.measure()
    assert window.profile_words.text() == "no image"


def test_every_picture_and_plot_is_copied_and_saved(view: Any, qtbot: QtBot, jobs: Jobs, tmp_path: Path) -> None:
    plot = shown(LinePlot("x (px)", "y (counts)"), qtbot)
    plot.set_curve("line", [1, 2, 3], [4, 5, 7])
    for widget in (view, plot):
        offered = entries(widget)
        assert {"Copy image", "Save image …", "Save data …", "Show all"} <= set(offered)
    entries(plot)["Copy values"].trigger()
    assert QApplication.clipboard().text().splitlines()[1:] == ["1\t4", "2\t5", "3\t7"]
    entries(plot)["Copy image"].trigger()
    assert not QApplication.clipboard().pixmap().isNull()
    plot.save_picture(str(tmp_path / "plot.svg"))
    root = ElementTree.parse(tmp_path / "plot.svg").getroot()
    assert root.tag.endswith("svg") and len(root.findall(".//{http://www.w3.org/2000/svg}polyline")) > 0
    for widget, name in ((plot, "plot.png"), (view, "view.png")):
        widget.save_picture(str(tmp_path / name))
        assert (tmp_path / name).read_bytes()[:4] == b"\x89PNG"
    view.save_data(str(tmp_path / "a.npy"))
    view.save_data(str(tmp_path / "a.csv"))
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), view.values)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "a.csv", delimiter=","), view.values, rtol=1e-6)
    idle(jobs, qtbot)
