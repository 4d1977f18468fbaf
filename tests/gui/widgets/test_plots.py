from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.theme import DARK, LIGHT, NIGHT, apply_theme
from lfcal_gui.widgets._axes import DecadeAxis
from lfcal_gui.widgets.plots import LINES, LinePlot
from tests.gui.layout import flaws
from tests.gui.waiting import GUARD_MS


@pytest.mark.parametrize("top", [1e-6, 0.5, 2000.0, 2e9])
def test_axes_show_the_values_themselves_after_new_labels(qtbot: QtBot, top: float) -> None:
    plot = LinePlot("depth z (mm)", "value")
    qtbot.addWidget(plot)
    plot.show()
    qtbot.waitExposed(plot, timeout=GUARD_MS)
    plot.set_curve("value", np.arange(3.0), np.array([0.0, top / 2, top]))
    plot.plot.vb.setYRange(0, top)
    qtbot.waitUntil(lambda: plot.plot.getAxis("left").range[1] >= top, timeout=GUARD_MS)
    plot.set_labels("depth z (mm)", "another (px)")
    axis = plot.plot.getAxis("left")
    spacing = top / 5
    shown = axis.tickStrings([spacing], axis.autoSIPrefixScale * axis.scale, spacing)
    assert axis.autoSIPrefixScale == 1.0 and float(shown[0]) == pytest.approx(spacing, rel=0.05)


def test_legends_take_the_colours_of_another_theme(qapp: QApplication, qtbot: QtBot) -> None:
    apply_theme(qapp, LIGHT)
    plot = LinePlot("x (px)", "y", legend=True)
    qtbot.addWidget(plot)
    plot.set_curve("first", [0, 1], [0, 1])
    for theme in (DARK, LIGHT):
        apply_theme(qapp, theme)
        plot.apply_theme()
        (_, label), *_ = plot.plot.legend.items
        assert theme.text in label.item.toHtml()


def test_a_logarithmic_plot_saves_the_values_themselves(qtbot: QtBot, tmp_path: Path) -> None:
    plot = LinePlot("value (counts)", "pixels")
    qtbot.addWidget(plot)
    plot.plot.set_log(x=False, y=True)
    plot.set_curve("pixels", [1.0, 2.0], [10.0, 1000.0])
    plot.save_data(str(tmp_path / "plot.csv"))
    assert np.loadtxt(tmp_path / "plot.csv", delimiter=",").tolist() == [[1, 10], [2, 1000]]


@pytest.mark.parametrize(
    ("low", "high", "numbers"),
    [
        (6.0, 1300.0, "10 20 50 100 200 500 1000"),
        (0.9, 1300.0, "1 10 100 1000"),
        (15.0, 29.0, "15 20 25"),
        (15.0, 33.0, "20 30"),
        (0.51, 0.95, "0.6 0.7 0.8 0.9"),
        (2.12, 2.45, "2.2 2.3 2.4"),
    ],
)
def test_a_logarithmic_axis_has_numbers_however_little_of_a_decade_is_seen(
    qtbot: QtBot, low: float, high: float, numbers: str
) -> None:
    axis = DecadeAxis("left")
    ((_, ticks),) = axis.tickValues(math.log10(low), math.log10(high), 300)
    assert axis.tickStrings(ticks, 1.0, 1.0) == numbers.split()


def test_a_curve_of_which_nothing_is_known_is_no_curve(qtbot: QtBot) -> None:
    """Metrics that are unknown in every plane have such curves, of which pyqtgraph looked for the largest value."""
    plot = LinePlot("z", "value")
    qtbot.addWidget(plot)
    plot.show()
    plot.set_curve("value", [1.0, 2.0], [np.nan, np.nan], symbol="o")
    plot.plot.vb.autoRange()
    assert plot.blank.isVisible()
    plot.set_curve("other", [1.0, 2.0], [3.0, np.nan])
    assert not plot.blank.isVisible()
    plot.remove_curve("other")
    assert plot.blank.isVisible()


def test_numbers_keep_the_room_they_had(qtbot: QtBot) -> None:
    """An axis that gives room back changes the picture beside it, and so its numbers, without end."""
    plot = LinePlot("z", "value")
    qtbot.addWidget(plot)
    plot.resize(500, 400)
    plot.show()
    qtbot.waitExposed(plot, timeout=GUARD_MS)
    plot.set_curve("value", [0.0, 1.0], [0.0, 1e6])
    wide = []
    for top in (123_456_789.0, 1.0):
        plot.plot.vb.setYRange(0, top)
        plot.grab()
        QApplication.processEvents()
        wide.append(plot.plot.getAxis("left").width())
    assert wide[1] == wide[0] > 60


def test_curves_are_red_where_all_is_red_and_have_their_tones_again(qapp: QApplication, qtbot: QtBot) -> None:
    apply_theme(qapp, LIGHT)
    plot = LinePlot("x (px)", "y (counts)")
    qtbot.addWidget(plot)
    plot.set_curve("a", [0, 1], [1, 2], symbol="o")
    plot.set_curve("b", [0, 1], [2, 3], colour="#123456", dashed=True)

    def tones() -> list[str]:
        return [pg.mkPen(curve.opts["pen"]).color().name() for curve in plot._curves.values()]

    before = tones()
    apply_theme(qapp, NIGHT)
    plot.apply_theme()
    plot.set_curve("c", [0, 1], [3, 4])
    assert (
        all(int(tone[3:5], 16) < 0x90 and int(tone[5:], 16) < 0x60 for tone in tones()) and len(set(tones())) == 3 - 1
    )
    assert pg.mkPen(plot._curves["b"].opts["pen"]).style() is Qt.PenStyle.DashLine
    apply_theme(qapp, LIGHT)
    plot.apply_theme()
    assert tones() == [*before, LINES[2]]


def test_another_name_of_an_axis_stands_in_its_middle(qtbot: QtBot) -> None:
    """It began where the one before had: as far from the middle as one is longer than the other."""
    plot = LinePlot("x", "y")
    qtbot.addWidget(plot)
    plot.resize(500, 300)
    plot.show()
    qtbot.waitExposed(plot, timeout=GUARD_MS)
    plot.set_labels("processor time of the whole H (s)", "relative error (%)")
    for side in ("bottom", "left"):
        axis = plot.plot.getAxis(side)
        centre = axis.label.mapToParent(axis.label.boundingRect().center())
        size = axis.size()
        along, length = (centre.x(), size.width()) if side == "bottom" else (centre.y(), size.height())
        assert along == pytest.approx(length / 2, abs=3)


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("misfit (%)", (260, 130)),
        ("relative L1 error of a pattern whose image is between pixels (%)", (500, 400)),
    ],
)
def test_an_upright_name_is_whole_in_two_lines(qtbot: QtBot, name: str, size: tuple[int, int]) -> None:
    """It was shortened to "mi… (%)", which names nothing."""
    plot = LinePlot("x", "y")
    qtbot.addWidget(plot)
    plot.resize(*size)
    plot.show()
    qtbot.waitExposed(plot, timeout=GUARD_MS)
    plot.set_labels("x", name)
    plot.set_curve("curve", [1, 2, 3], [0, 5000, 90000])
    left = plot.plot.getAxis("left")
    qtbot.waitUntil(lambda: not flaws(plot), timeout=GUARD_MS)
    assert left.label.toPlainText().split() == name.split() and not left.toolTip()
    assert not flaws(plot)
    plot.resize(size[0], 900)
    qtbot.waitUntil(lambda: "\n" not in left.label.toPlainText() and not flaws(plot), timeout=GUARD_MS)


def test_what_is_counted_has_no_ticks_between(qtbot: QtBot) -> None:
    """Iterations had ticks at 1.5 and 2.5."""
    plot = LinePlot("iteration", "residual (%)", counted=True)
    qtbot.addWidget(plot)
    axis = plot.plot.getAxis("bottom")
    for last in (3, 5, 40):
        ticks = [v for _, values in axis.tickValues(0.8, last + 0.2, 400.0) for v in values]
        assert ticks and all(float(v).is_integer() and v >= 0 for v in ticks)
    assert axis.labelText == "iteration"


@pytest.mark.parametrize("top", [0.1, 1.0, 35_000.0, 7e6])
def test_numbers_of_a_low_plot_do_not_lie_over_each_other(qtbot: QtBot, top: float) -> None:
    plot = LinePlot("frame", "energy (counts)")
    qtbot.addWidget(plot)
    plot.graphics.setMinimumHeight(50)
    for side in ("left", "bottom"):
        plot.plot.getAxis(side).showLabel(False)
    plot.set_curve("energy", [0, 1, 2], [0, top, top / 2])
    plot.show()
    axis = plot.plot.getAxis("left")
    for height in (200, 110, 80, 70):
        plot.resize(300, height)
        QApplication.processEvents()
        low, high = axis.range
        ticks = sorted(axis.tickValues(low, high, axis.height())[0][1])
        seen = [tick for tick in ticks if low < tick < high]
        assert len(seen) > (height > 70), "one number tells no scale"
        apart = np.diff(ticks) * axis.height() / (high - low)
        assert not apart.size or apart.min() > 12
    assert not flaws(plot)


def test_numbers_of_an_axis_follow_a_growing_curve(qtbot: QtBot) -> None:
    drawn = []
    for counts in ((1, 8, 120), (120,)):
        plot = LinePlot("frame", "light (counts)", counted=True)
        qtbot.addWidget(plot)
        plot.resize(280, 180)
        for count in counts:
            number = np.arange(1.0, count + 1)
            plot.set_curve("light", number, 1e5 + number)
            plot.plot.vb.setYRange(0.0, 2e5, padding=0)
            found = plot.grab().toImage()  # the range follows when it is drawn
        drawn.append(found)
    assert drawn[0] == drawn[1]
