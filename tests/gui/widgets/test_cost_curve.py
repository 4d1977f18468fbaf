"""The curve of cost and accuracy: by mouse, by keyboard, and with names that can be read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QPointF, QRectF, Qt
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.models.cost import ChartPoint
from lfcal_gui.widgets.cost_curve import MARGIN, RING, CostCurve

POINTS = tuple(
    ChartPoint(
        float(np.log10(cost)), float(np.log10(error)), efficient, picked, False, f"{name}, wave", f"{name}\nmore"
    )
    for cost, error, efficient, picked, name in (
        (1.0, 15.0, True, False, "30 %"),
        (1.5, 1.1, True, True, "3 %"),
        (1.55, 4.5, False, False, "10 %"),
        (3.0, 0.5, True, False, "2 %"),
    )
)


@pytest.fixture
def curve(qapp: QApplication, qtbot: QtBot) -> CostCurve:
    made = CostCurve()
    qtbot.addWidget(made)
    made.resize(400, 400)
    made.show()
    qtbot.waitExposed(made)
    made.show_points(POINTS, float(np.log10(3.0)))
    QApplication.processEvents()
    return made


def at(curve: CostCurve, x: float, y: float) -> Any:
    return curve.graphics.mapFromScene(curve.plot.vb.mapViewToScene(QPointF(x, y)))


def test_the_line_is_dragged_to_another_error(curve: CostCurve, qtbot: QtBot) -> None:
    asked: list[float] = []
    curve.moved.connect(asked.append)
    view, start = curve.graphics.viewport(), at(curve, 0.4, np.log10(3.0))
    qtbot.mousePress(view, Qt.MouseButton.LeftButton, pos=start)
    for step in (10, 20, 40):
        place = start + QPointF(0, -step).toPoint()
        qtbot.mouseMove(view, place)
        QApplication.processEvents()
    qtbot.mouseRelease(view, Qt.MouseButton.LeftButton, pos=start + QPointF(0, -40).toPoint())
    assert asked and asked == sorted(asked) and asked[-1] > 0.03
    assert curve.limit.value() == pytest.approx(np.log10(100 * asked[-1]), abs=0.02)
    curve._move(5.0)
    assert asked[-1] == 1.0, "no error above 100 % is asked for"


def test_the_point_in_use_has_a_square_and_is_named(curve: CostCurve) -> None:
    used = replace(POINTS[2], in_use=True, name="10 % (in use)")
    curve.show_points((*POINTS[:2], used, POINTS[3]), float(np.log10(3.0)))
    rings = {(round(spot["x"], 6), spot["symbol"]) for spot in curve.ring.data}
    assert rings == {(round(POINTS[1].x, 6), "o"), (round(used.x, 6), "s")}
    (name,) = (one for one in curve.names if one.toPlainText() == "10 % (in use)")
    words = name.mapRectToScene(name.boundingRect()).adjusted(MARGIN, MARGIN, -MARGIN, -MARGIN)
    at = curve.plot.vb.mapViewToScene(QPointF(used.x, used.y))
    square = QRectF(at.x() - RING / 2, at.y() - RING / 2, RING, RING)
    assert not words.intersects(square), "its first letter touched the square"
    assert [line.split(",")[2:5] for line in list(curve.table_lines(","))[2:4]] == [["1", "0", "1"], ["0", "1", "0"]]


def scene_area(item: Any) -> QRectF:
    return item.mapRectToScene(item.boundingRect())


def draw(curve: CostCurve, size: tuple[int, int], points: Sequence[ChartPoint], limit: float) -> None:
    curve.resize(*size)
    curve.show_points(tuple(points), limit)
    QApplication.processEvents()


def test_the_curve_does_not_cross_the_label_of_the_line(curve: CostCurve) -> None:
    ys = (1.0, 0.45, -0.5)
    for width, xs, words in (
        (400, (0.3, 0.9, 1.0), "tolerance 3.2 %"),
        (400, (0.0, 0.1, 1.0), "tolerance 3.2 %"),
        (250, (0.0, 0.1, 0.12), "3.2 %"),  # no room left or right of the curve
    ):
        points = [ChartPoint(x, y, True, False, False, "p", "p") for x, y in zip(xs, ys, strict=True)]
        draw(curve, (width, 400), points, 0.5)
        label, box = curve.limit.label, curve.plot.vb
        area = scene_area(label)
        for t in np.linspace(0, 2, 4000):
            place = QPointF(float(np.interp(t, range(3), xs)), float(np.interp(t, range(3), ys)))
            assert not area.contains(box.mapViewToScene(place))
        assert box.sceneBoundingRect().contains(area)
        assert label.toPlainText() == words


def test_points_and_limit_are_chosen_by_the_keyboard(curve: CostCurve, qtbot: QtBot) -> None:
    used: list[int] = []
    asked: list[float] = []
    curve.chosen.connect(used.append)
    curve.moved.connect(asked.append)
    qtbot.keyClick(curve, Qt.Key.Key_Return)
    assert not used, "no point was chosen yet"
    qtbot.keyClick(curve, Qt.Key.Key_Right)
    assert curve.status.text() == "10 %; more"
    qtbot.keyClick(curve, Qt.Key.Key_Left)
    qtbot.keyClick(curve, Qt.Key.Key_Left)
    qtbot.keyClick(curve, Qt.Key.Key_Left)
    qtbot.keyClick(curve, Qt.Key.Key_Return)
    assert used == [0], "there is none before the first"
    qtbot.keyClick(curve, Qt.Key.Key_Up)
    qtbot.keyClick(curve, Qt.Key.Key_Down)
    assert asked == [pytest.approx(0.034), pytest.approx(0.027)]


def crowd(used: int = 10) -> tuple[ChartPoint, ...]:
    """Return points close to a curve, two at the same place, of which the later is chosen."""
    front = [(0.1 * k, 1.5 - 0.2 * k + 0.008 * k**2) for k in range(12)]
    rest = [(x + 0.08, y + 0.05) for x, y in front]
    spots = [*((*at, True) for at in front), *((*at, False) for at in rest), (0.5, front[5][1], False)]
    return tuple(
        ChartPoint(x, y, efficient, k == len(spots) - 1, k == used, f"setting {k}, of many", "")
        for k, (x, y, efficient) in enumerate(spots)
    )


def test_names_cover_neither_points_nor_lines_nor_each_other(curve: CostCurve) -> None:
    few = [(POINTS, size, percent) for size in ((400, 400), (230, 260)) for percent in (1.4, 3.0, 12.0, 17.0, 20.0)]
    many = [(crowd(), size, 2.0) for size in ((1100, 700), (700, 500), (400, 400), (260, 300))]
    for points, size, percent in (*few, *many):
        draw(curve, size, points, float(np.log10(percent)))
        box, names = curve.plot.vb, [item.toPlainText() for item in curve.names]
        areas = [scene_area(item) for item in curve.names]
        pairs = combinations([*areas, scene_area(curve.limit.label)], 2)
        assert not any(one.intersects(other) for one, other in pairs), (size, percent)
        height = box.mapViewToScene(QPointF(0, curve.limit.value())).y()
        assert not any(area.top() < height < area.bottom() for area in areas)
        at = [box.mapViewToScene(QPointF(point.x, point.y)) for point in points]
        # the chosen and the used point have their name whatever else is there
        if points is POINTS:
            assert not any(area.contains(spot) for area in areas for spot in at)
            assert names[0] == "3 %, wave" and len(names) >= (3 if size[0] == 400 else 2)
            continue
        assert names[:2] == [points[-1].name, points[10].name]
        assert points[5].name not in names, "its place is named already"
        xs, ys = zip(*((p.x(), p.y()) for p, point in zip(at, points, strict=True) if point.efficient), strict=True)
        across = np.linspace(min(xs), max(xs), 5000)
        assert len(names) >= 4 or size[0] == 260
        for item, name in zip(curve.names[2:], names[2:], strict=True):
            area = scene_area(item).adjusted(4, 4, -4, -4)
            low, high = area.topLeft().toTuple(), area.bottomRight().toTuple()
            gaps = [np.hypot(*(np.clip(p.toTuple(), low, high) - p.toTuple())) for p in at]
            assert points[int(np.argmin(gaps))].name == name, "it is nearest to its own point"
            assert not any(map(area.contains, map(QPointF, across, np.interp(across, xs, ys))))


def test_of_thousands_of_points_only_the_chosen_and_the_used_one_are_named(curve: CostCurve) -> None:
    """Placing all names would stop the window for minutes."""
    rng = np.random.default_rng(0)
    every = [replace(POINTS[0], x=float(x), y=float(y), picked=False) for x, y in rng.random((2000, 2))]
    every[7] = replace(every[7], picked=True, name="chosen")
    every[9] = replace(every[9], in_use=True, name="used")
    curve.show_points(tuple(every), 0.3)
    assert sorted(item.toPlainText() for item in curve.names) == ["chosen", "used"]


def test_without_points_it_says_what_to_do(curve: CostCurve) -> None:
    curve.show_points((), 0.0)
    assert curve.blank.isVisible() and "Measure" in curve.blank.text() and not curve.names
    assert not curve.limit.isVisible()
    curve.show_status("", "")
    assert not curve.measure_button.isEnabled() and curve.measure_button.text() == "Measuring …"


def test_every_point_with_room_has_its_name(curve: CostCurve) -> None:
    """Areas that did not overlap added up to -7e-12 px², not to 0: the second of seven planes had no name."""
    found = ((1254, 45, 2), (1881, 23, 3), (3135, 13, 5), (5643, 3.95, 9), (10659, 3.7, 17), (20691, 1.4, 33))
    points = [
        ChartPoint(float(np.log10(cost)), float(np.log10(error)), True, False, False, f"{planes} planes", "")
        for cost, error, planes in found
    ]
    for wide in range(700, 960, 20):
        draw(curve, (wide, 600), points, -1.0)
        assert {item.toPlainText() for item in curve.names} == {point.name for point in points}
