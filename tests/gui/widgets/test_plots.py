"""Plots: their axes show whole numbers and values that can be read, empty ones say so, and data is saved."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pyqtgraph as pg
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication, QFileDialog, QMenu
from pytestqt.qtbot import QtBot

from lfcal_gui.models.shot import Shot
from lfcal_gui.pages.acquire._pictures import ErrorView
from lfcal_gui.pages.h.fit_view import DecadePlot
from lfcal_gui.theme import DARK, LIGHT, NIGHT, Theme, apply_theme
from lfcal_gui.widgets._axes import DecadeAxis, PixelAxis
from lfcal_gui.widgets._blank import NOTHING
from lfcal_gui.widgets.cost_curve import CostCurve
from lfcal_gui.widgets.period_map import PeriodMap
from lfcal_gui.widgets.picture import Picture
from lfcal_gui.widgets.plots import LINES, LinePlot
from tests.gui.layout import drawn_numbers, flaws
from tests.gui.waiting import GUARD_MS


def made(qtbot: QtBot, widget: Any, width: int = 500, height: int = 400) -> Any:
    qtbot.addWidget(widget)
    widget.resize(width, height)
    widget.show()
    qtbot.waitExposed(widget, timeout=GUARD_MS)
    return widget


def with_axes(unit: str = "px") -> Picture:
    return Picture(axes=(f"column ({unit})", f"row ({unit})"))


def ticks(axis: PixelAxis, low: float, high: float, size: float = 300.0) -> list[float]:
    return sorted(value for _, values in axis.tickValues(low, high, size) for value in values)


# -- axes of pictures --------------------------------------------------------------------------------------
def test_axes_of_pictures_count_whole_pixels(qtbot: QtBot) -> None:
    """A matrix of 4 rows had ticks at 0.5, and the map of a period at -1 and beyond its end."""
    view, period = with_axes(), PeriodMap()
    for widget in (view, period):
        qtbot.addWidget(widget)
    view.set_shot(Shot(np.ones((4, 7)), origin=(-2.0, 0.0)))
    period.set_values(np.ones((3, 5)))
    left = view.plot.getAxis("left")
    assert ticks(left, -2.6, 1.6) == [-2, -1, 0, 1]
    assert ticks(left, 1.6, -2.6) == [-2, -1, 0, 1], "rows count downwards"
    assert ticks(period.plot.getAxis("bottom"), -1.4, 6.2) == [0, 1, 2, 3, 4]
    assert ticks(period.plot.getAxis("left"), 0.8, 1.3) == [1], "however large it is shown"
    for origin, step in (((0.5, 0.5), 1.0), ((0.0, 0.0), 0.25)):
        other = with_axes("µm")
        qtbot.addWidget(other)
        other.set_shot(Shot(np.ones((4, 4)), origin=origin, step=step))
        assert any(value % 1 for value in ticks(other.plot.getAxis("left"), 0.0, 1.0)), "other units have fractions"


def test_numbers_of_an_axis_keep_apart(qtbot: QtBot) -> None:
    """A picture of 110 rows on 30 screen pixels had 110 numbers; two digits were 15 px apart, which is their width."""
    for side, count, low, high, size, least in (
        ("left", 19, -15.0, 35.0, 100.0, 14.0),
        ("left", 110, -60.0, 170.0, 10.0, 14.0),
        ("left", 110, -60.0, 170.0, 30.0, 14.0),
        *(("bottom", 95, 47 * (1 - k), 47 * (1 + k), 190.0, 22.0) for k in (1.0, 1.5, 3.0)),
        *(("bottom", 6576, 3288 * (1 - k), 3288 * (1 + k), 400.0, 36.0) for k in (1.0, 1.5, 3.0)),
        *(("bottom", 10, 4.5 * (1 - k), 4.5 * (1 + k), 120.0, 15.0) for k in (1.0, 1.5, 3.0)),
    ):
        axis = PixelAxis(side)
        axis.cover(0, count)
        found = ticks(axis, low, high, size)
        assert found and all(gap * size / (high - low) >= least - 1e-9 for gap in np.diff(found)), (count, size)
        assert len(found) >= 2 or count == 110


def test_numbers_and_names_of_axes_are_whole_or_shortened(qtbot: QtBot) -> None:
    """The upper half of the 0 was cut where rows are low, and a long name was cut by the edge of its plot."""
    for width, height in ((150, 84), (300, 84), (400, 300)):
        view = made(qtbot, Picture(axes=("χ² = photon / additive noise variance", "row (px)")), width, height)
        view.set_shot(Shot(np.ones((19, 33))))
        left, below = view.plot.getAxis("left"), view.plot.getAxis("bottom")
        qtbot.waitUntil(lambda axis=left: "0" in [text for _, text in drawn_numbers(axis)], timeout=GUARD_MS)
        seen = view.graphics.sceneRect()
        for axis in (left, below):
            assert all(seen.contains(axis.mapRectToScene(box.adjusted(1, 1, -1, -1))) for box, _ in drawn_numbers(axis))
        assert below.label.boundingRect().width() <= below.size().width() + 12
        assert ("…" in below.label.toPlainText()) == (width == 150) == bool(below.toolTip())


def test_values_of_a_period_are_copied_and_saved(qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A map offered its picture alone."""
    view = made(qtbot, PeriodMap())

    def offered() -> dict[str, Any]:
        view.customContextMenuRequested.emit(view.rect().center())
        (menu,) = (one for one in view.findChildren(QMenu) if one.isVisible())
        found = {action.text(): action for action in menu.actions()}
        menu.close()
        return found

    assert {"Copy values", "Save data …"} & offered().keys() == set(), "there are none yet"
    values = np.arange(6.0).reshape(2, 3) / 7
    view.set_values(values)
    actions = offered()
    actions["Copy values"].trigger()
    rows = [line.split("\t") for line in QApplication.clipboard().text().splitlines()]
    np.testing.assert_allclose(np.array(rows, float), values, rtol=1e-6)
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *_, **__: (str(tmp_path / "map.csv"), ""))
    actions["Save data …"].trigger()
    np.testing.assert_allclose(np.loadtxt(tmp_path / "map.csv", delimiter=","), values, rtol=1e-6)
    # thousands of crosses covered the map of a recording that had just begun
    recorded = np.ones((55, 95), int)
    recorded[3, 4:7] = 0
    view.set_values(np.ones((55, 95)), recorded)
    assert len(view.shot.overlays[0].points) == 3, "few missing positions are crossed out"
    view.set_values(np.ones((55, 95)), 1 - recorded)
    assert len(view.shot.overlays[0].points) == 0 and np.isnan(view.values).sum() == 55 * 95 - 3


# -- empty views -------------------------------------------------------------------------------------------


def numbers(view: Any) -> list[str]:
    """Return the numbers at the axes."""
    found = []
    for side in ("bottom", "left"):
        axis = view.plot.getAxis(side)
        low, high = axis.range
        if axis._tickLevels is not None:  # fixed numbers
            found += [text for level in axis._tickLevels for _, text in level]
            continue
        for spacing, values in axis.tickValues(low, high, 300):
            found += axis.tickStrings(values, 1.0, spacing)
    return found


def test_an_empty_view_says_so_and_has_no_numbers(qtbot: QtBot) -> None:
    image, plot, rounds = with_axes(), LinePlot("x", "y"), DecadePlot("χ²", "#000000")
    for view in (image, plot, rounds, ErrorView(), CostCurve()):
        qtbot.addWidget(view)
        view.show()
        assert view.blank.isVisible() and numbers(view) == [], view
    assert image.blank.text() == plot.blank.text() == rounds.blank.text() == NOTHING
    image.set_shot(Shot(np.eye(5)))
    plot.set_curve("line", [1, 2, 3], [4, 5, 6])
    rounds.show_values([1.0, 0.1], [False, False])
    for view in (image, plot, rounds):
        assert not view.blank.isVisible() and numbers(view)
    image.set_shot(None)
    plot.clear()
    assert image.blank.isVisible() and plot.blank.isVisible()
    assert numbers(image) == [] == numbers(plot)
    # metrics that are unknown in every plane: pyqtgraph looked for their largest value
    plot.set_curve("value", [1.0, 2.0], [np.nan, np.nan], symbol="o")
    plot.plot.vb.autoRange()
    assert plot.blank.isVisible()
    plot.set_curve("other", [1.0, 2.0], [3.0, np.nan])
    assert not plot.blank.isVisible()
    plot.remove_curve("other")
    assert plot.blank.isVisible()


def test_an_empty_view_says_what_it_waits_for(qtbot: QtBot) -> None:
    """Four pictures said "Nothing to show yet." while a plane was read for them."""
    view = made(qtbot, Picture())
    view.blank.words = "Open a light field."
    for action, text in (
        (lambda: view.blank.wait("Making lf.tif …"), "Making lf.tif …"),
        (lambda: view.blank.wait(""), "Open a light field."),
        (lambda: view.blank.wait("Making lf.tif …"), "Making lf.tif …"),
        (lambda: (view.set_shot(Shot(np.eye(5))), view.set_shot(None)), "Open a light field."),
        (lambda: view.blank.wait("Making lf.tif …"), "Making lf.tif …"),
        (lambda: setattr(view.blank, "words", "It failed."), "It failed."),
    ):
        action()
        assert view.blank.text() == text


# -- plots of curves ---------------------------------------------------------------------------------------
def test_axes_show_values_without_a_prefix_after_new_labels(qtbot: QtBot) -> None:
    for top in (1e-6, 0.5, 2000.0, 2e9):
        plot = made(qtbot, LinePlot("depth z (mm)", "value"))
        plot.set_curve("value", np.arange(3.0), np.array([0.0, top / 2, top]))
        plot.plot.vb.setYRange(0, top)
        axis = plot.plot.getAxis("left")
        qtbot.waitUntil(lambda axis=axis, top=top: axis.range[1] >= top, timeout=GUARD_MS)
        plot.set_labels("depth z (mm)", "another (px)")
        shown = axis.tickStrings([top / 5], axis.autoSIPrefixScale * axis.scale, top / 5)
        assert axis.autoSIPrefixScale == 1.0 and float(shown[0]) == pytest.approx(top / 5, rel=0.05)


def test_legends_and_curves_take_the_colours_of_a_theme(qapp: QApplication, qtbot: QtBot) -> None:
    plot = LinePlot("x (px)", "y (counts)", legend=True)
    qtbot.addWidget(plot)
    plot.set_curve("a", [0, 1], [1, 2], symbol="o")
    plot.set_curve("b", [0, 1], [2, 3], colour="#123456", dashed=True)

    def tones(theme: Theme) -> list[str]:
        apply_theme(qapp, theme)
        plot.apply_theme()
        (_, label), *_ = plot.plot.legend.items
        assert theme.text in label.item.toHtml()
        return [pg.mkPen(curve.opts["pen"]).color().name() for curve in plot._curves.values()]

    before = tones(LIGHT)
    assert tones(DARK)
    night = tones(NIGHT)
    assert all(int(tone[3:5], 16) < 0x90 and int(tone[5:], 16) < 0x60 for tone in night), "all is red"
    assert pg.mkPen(plot._curves["b"].opts["pen"]).style() is Qt.PenStyle.DashLine
    plot.set_curve("c", [0, 1], [3, 4])
    assert tones(LIGHT) == [*before, LINES[2]]


def test_a_logarithmic_plot_saves_its_values_and_has_numbers_in_every_range(qtbot: QtBot, tmp_path: Path) -> None:
    plot = LinePlot("value (counts)", "pixels")
    qtbot.addWidget(plot)
    plot.plot.set_log(x=False, y=True)
    plot.set_curve("pixels", [1.0, 2.0], [10.0, 1000.0])
    plot.save_data(str(tmp_path / "plot.csv"))
    assert np.loadtxt(tmp_path / "plot.csv", delimiter=",").tolist() == [[1, 10], [2, 1000]]
    for low, high, wanted in (
        (6.0, 1300.0, "10 20 50 100 200 500 1000"),
        (0.9, 1300.0, "1 10 100 1000"),
        (15.0, 29.0, "15 20 25"),
        (15.0, 33.0, "20 30"),
        (0.51, 0.95, "0.6 0.7 0.8 0.9"),
        (2.12, 2.45, "2.2 2.3 2.4"),
    ):
        axis = DecadeAxis("left")
        ((_, found),) = axis.tickValues(math.log10(low), math.log10(high), 300)
        assert axis.tickStrings(found, 1.0, 1.0) == wanted.split(), (low, high)


def test_an_axis_keeps_the_width_of_its_longest_numbers(qtbot: QtBot) -> None:
    """An axis that becomes narrower changes the picture next to it, and so its own numbers, without end."""
    plot = made(qtbot, LinePlot("z", "value"))
    plot.set_curve("value", [0.0, 1.0], [0.0, 1e6])
    wide = []
    for top in (123_456_789.0, 1.0):
        plot.plot.vb.setYRange(0, top)
        plot.grab()
        QApplication.processEvents()
        wide.append(plot.plot.getAxis("left").width())
    assert wide[1] == wide[0] > 60


def test_an_upright_name_is_whole_in_two_lines_in_the_middle_of_its_axis(qtbot: QtBot) -> None:
    """It was shortened to "mi… (%)", which names nothing, and began where the name before it had begun."""
    long = "relative L1 error of a pattern whose image is between pixels (%)"
    for name, width, height in (("misfit (%)", 260, 130), (long, 500, 400)):
        plot = made(qtbot, LinePlot("x", "y"), width, height)
        plot.set_labels("processor time (s)", name)
        plot.set_curve("curve", [1, 2, 3], [0, 5000, 90000])
        left = plot.plot.getAxis("left")
        qtbot.waitUntil(lambda plot=plot: not flaws(plot), timeout=GUARD_MS)
        assert left.label.toPlainText().split() == name.split() and not left.toolTip()
        plot.resize(width, 900)
        qtbot.waitUntil(
            lambda at=plot, axis=left: "\n" not in axis.label.toPlainText() and not flaws(at), timeout=GUARD_MS
        )


def test_counted_values_have_no_ticks_between(qtbot: QtBot) -> None:
    """Iterations had ticks at 1.5 and 2.5."""
    plot = LinePlot("iteration", "residual (%)", counted=True)
    qtbot.addWidget(plot)
    axis = plot.plot.getAxis("bottom")
    for last in (3, 5, 40):
        found = ticks(axis, 0.8, last + 0.2, 400.0)
        assert found and all(float(v).is_integer() and v >= 0 for v in found)
    assert axis.labelText == "iteration"


@pytest.mark.parametrize("top", [0.1, 1.0, 35_000.0, 7e6])
def test_numbers_of_a_low_plot_do_not_overlap(qtbot: QtBot, top: float) -> None:
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
        assert len(seen) > (height > 70), "one number shows no scale"
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
