"""The volume turned, sliced and projected, by mouse and keyboard."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PySide6.QtCore import QPoint, QPointF, QRectF, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.jobs import Jobs
from lfcal_gui.models import BEGIN, COLOUR_MAPS, DisplaySettings, Label, Outline, depth_colours, to_uint8
from lfcal_gui.pages.reconstruct._solid_picture import STEP, Newest, SolidPicture
from lfcal_gui.pages.reconstruct._volume_view import VolumeView
from lfcal_gui.theme import LIGHT, NIGHT, apply_theme
from lfcal_gui.widgets.picture import Picture
from tests.gui.waiting import GUARD_MS, idle

DEPTHS = np.array([3e3, 2e3, 1.5e3, 1e3])
"""Uneven, and running downwards."""


def volume() -> NDArray[np.float32]:
    values = np.random.default_rng(0).random((4, 20, 30)).astype(np.float32)
    values[2, 4, 21] = 3.0
    return values


@pytest.fixture
def view(qtbot: QtBot) -> VolumeView:
    return shown(qtbot, VolumeView())


def shown(qtbot: QtBot, view: VolumeView) -> VolumeView:
    qtbot.addWidget(view)
    view.resize(640, 560)
    view.show()
    qtbot.waitExposed(view, timeout=GUARD_MS)
    view.set_volume(volume(), DEPTHS, (60.0, 60.0))
    return view


def lines_in(picture: Picture) -> set[float]:
    """Return where the lines over a slice are."""
    found = set()
    for line in picture.overlays:
        fixed = np.ptp(line.points, axis=0) == 0
        found.add(round(float(line.points[0, fixed][0]), 6))
    return found


def on_screen(picture: SolidPicture, place: NDArray[np.float64], turn: NDArray[np.float64]) -> QPoint:
    right, down, _ = turn @ place
    return picture.graphics.mapFromScene(picture.box.mapViewToScene(QPointF(right, down)))


def test_it_starts_in_3_d_with_the_brightest_voxel_in_view(view: VolumeView) -> None:
    assert view.segments[0].isChecked() and (view.intent.z, view.intent.y, view.intent.x) == (2, 4, 21)
    prepared, picture = view.prepared, view.solid
    at = on_screen(picture, prepared.solid.place_of(2, 4, 21), view.turn)
    assert picture.graphics.rect().contains(at)
    assert picture.values is not None and np.nanmax(picture.values) > 2
    assert picture.shot.pixel_um == picture.shot.step, "it has a scale bar"
    assert picture.shot.tint.ends == ("1 mm", "3 mm")
    assert {one.words for one in picture.overlays if isinstance(one, Label)} == {"x", "y", "z"}


def test_contrast_and_scaling_are_those_of_every_picture(view: VolumeView) -> None:
    """The levels are those of the volume, the handles act on the turned picture, and both views share them."""
    assert view.solid.levels == (0.0, 3.0)
    view.contrasts[0].set_levels((0.5, 2.0))
    view.contrasts[0]._choose(scale="gamma", colour_map=COLOUR_MAPS[1])
    picture = view.solid
    assert picture.levels == (0.5, 2.0)
    assert picture.values is not None and picture.shot.tint is not None
    grey = to_uint8(picture.values, DisplaySettings("gamma"), (0.5, 2.0))
    tint = np.nan_to_num(picture.shot.tint.values)
    wanted = depth_colours()[np.rint(255 * tint.clip(0, 1)).astype(int), :3] * (grey[..., None] / 255)
    np.testing.assert_allclose(picture.item.image, wanted, atol=1.5)
    view.ticks["by_depth"].trigger()
    assert picture.shot.tint is None and picture.display.colour_map == COLOUR_MAPS[1]
    np.testing.assert_array_equal(picture.item.image, grey)
    view.segments[1].click()
    assert view.pictures["xy"].levels == (0.5, 2.0) and view.pictures["xy"].display.scale == "gamma"
    assert view.contrasts[1].isVisible() and not view.contrasts[0].isVisible()


def test_pictures_that_are_made_later_have_the_contrast_of_the_others(view: VolumeView) -> None:
    view.contrasts[0].set_levels((0.5, 2.0))
    view.set_volume(volume(), DEPTHS, (60.0, 60.0), 2 * volume())
    assert not view.pictures and view.looks[1].solid.levels == (0.5, 2.0)
    view.segments[1].click()
    assert view.pictures is view.looks[0].pictures
    shown = [picture for look in view.looks for picture in look.pictures.values()]
    assert len(shown) == 6 and {picture.levels for picture in shown} == {(0.5, 2.0)}
    assert all(picture.accessibleName() and picture.isVisible() for picture in shown)
    view.contrasts[1].set_levels((0.25, 1.0))
    assert view.solid.levels == view.looks[1].pictures["xz"].levels == (0.25, 1.0)


def test_mouse_and_arrows_turn_it_and_home_shows_the_first_view(view: VolumeView) -> None:
    picture, viewport = view.solid, view.solid.graphics.viewport()
    before = np.array(picture.values)
    QTest.mousePress(viewport, Qt.MouseButton.LeftButton, pos=QPoint(200, 200))
    QTest.mouseMove(viewport, QPoint(260, 220))
    QTest.mouseRelease(viewport, Qt.MouseButton.LeftButton, pos=QPoint(260, 220))
    assert not np.allclose(view.turn, BEGIN) and not np.array_equal(picture.values, before, equal_nan=True)
    near = np.array([0.0, 0.0, -1.0]) @ BEGIN  # the point that faces you
    assert (view.turn @ near)[0] > 0 and (view.turn @ near)[1] > 0, "it moves with the mouse"
    assert picture.hasFocus()
    seen = picture.box.viewRect()
    QTest.keyClick(picture, Qt.Key.Key_Plus)
    assert picture.box.viewRect().width() < seen.width()
    QTest.keyClick(picture, Qt.Key.Key_Home)
    np.testing.assert_array_equal(view.turn, BEGIN)
    assert picture.box.viewRect() == seen
    for key in (Qt.Key.Key_Left, Qt.Key.Key_Up, Qt.Key.Key_Right, Qt.Key.Key_Down):
        QTest.keyClick(picture, key)
        assert np.degrees(np.arccos((np.trace(view.turn @ BEGIN.T) - 1) / 2)) < 2 * np.degrees(STEP) + 1
        assert not np.allclose(view.turn, BEGIN)
    view.first_view.trigger()
    np.testing.assert_array_equal(view.turn, BEGIN)


def test_a_click_puts_the_cross_on_the_voxel_behind_it(view: VolumeView) -> None:
    view.set_cross(z=0, y=0, x=0)
    at = on_screen(view.solid, view.prepared.solid.place_of(2, 4, 21), view.turn)
    QTest.mouseClick(view.solid.graphics.viewport(), Qt.MouseButton.LeftButton, pos=at)
    assert (view.intent.z, view.intent.y, view.intent.x) == (2, 4, 21)
    assert view.strip.currentRow() == 2 and "plane 2 (1.5 mm), y 4, x 21: 3 counts" in view.readout
    view.set_cross(z=0)
    view.brightest.trigger()
    assert view.intent.z == 2


def test_a_known_truth_is_turned_with_it_and_can_be_hidden(view: VolumeView) -> None:
    truth = 2 * volume()
    view.set_volume(volume(), DEPTHS, (60.0, 60.0))
    assert len(view.looks) == 1 and not view.ticks["truth"].isEnabled()
    view.set_volume(volume(), DEPTHS, (60.0, 60.0), truth)
    other = view.looks[1].solid
    assert other.isVisible() and other.levels == view.solid.levels == (0.0, 6.0), "both share one scale"
    view._turn(0.4, 0.2)
    for one in (other, view.solid):
        np.testing.assert_array_equal(one._drawn[0].turn, view.turn)
    assert np.nanmax(other.values) == pytest.approx(2 * np.nanmax(view.solid.values), rel=0.05)
    view.solid.box.scaleBy((0.5, 0.5))
    view.solid.moved.emit()
    assert other.box.viewRect().width() == pytest.approx(view.solid.box.viewRect().width(), rel=0.01)
    view.segments[1].click()
    np.testing.assert_array_equal(view.looks[1].pictures["xy"].values, truth[2])
    slices = [look.pictures["xy"] for look in view.looks]
    slices[1].box.scaleBy((0.5, 0.5))
    slices[1].moved.emit()
    assert slices[0].box.viewRect().width() == pytest.approx(slices[1].box.viewRect().width(), rel=0.01)
    view.ticks["truth"].trigger()
    assert not view.looks[1].isVisible()


def test_the_cross_links_slices_and_projections(qtbot: QtBot) -> None:
    view = VolumeView()
    qtbot.addWidget(view)
    values = np.random.default_rng(0).random((3, 20, 30)).astype(np.float32)
    places: list[tuple[int, int, int]] = []
    view.moved.connect(lambda *place: places.append(place))
    view.set_volume(values, np.array([1e3, 2e3, 3e3]), (500.0, 500.0))
    for mode in (1, 2):
        view.segments[mode].click()
        view.set_cross(z=1, y=10, x=15)
        view.pictures["xy"].steered_to.emit(10, 22)
        assert places[-1] == (1, 10, 22) and lines_in(view.pictures["xz"]) == {22 * 500, 2e3}
        view.pictures["yz"].steered_to.emit(10, 5)
        assert (
            view.strip.currentRow() == 2 and lines_in(view.pictures["xz"]) == {22 * 500, 3e3} and "3 mm" in view.readout
        )
        wanted = values[:, :, 22] if mode == 1 else values.max(2)
        np.testing.assert_array_equal(view.pictures["yz"].values[:, ::2], wanted.T)
        assert view.pictures["xy"].shot.pixel_um == 500 and view.pictures["xz"].shot.step == 500
    view.strip.setCurrentRow(0)
    assert places[-1] == (0, 10, 22)
    view.ticks["cross"].trigger()
    assert not view.pictures["xy"].overlays
    view.segments[1].click()
    view.ticks["own_scale"].trigger()
    assert view.pictures["xy"].levels == (values[0].min(), values[0].max()) != view.pictures["xz"].levels
    view.set_volume(values[:1])
    assert view.intent.z == 0 and view.strip.count() == 1
    view.set_volume(None)
    view.set_cross(z=1)
    assert view.volume is None and view.readout == ""


def test_views_from_three_sides_have_one_scale_with_one_bar(view: VolumeView) -> None:
    view.segments[1].click()

    def scales() -> set[float]:
        return {round(one.box.viewRect().width() / one.box.width(), 3) for one in view.pictures.values()}

    for size in ((640, 560), (500, 900), (1000, 500)):
        view.resize(*size)
        QApplication.processEvents()
        (scale,) = scales()
        room, cells = view.looks[0].sides, [one.geometry() for one in view.pictures.values()]
        assert sum(one.width() * one.height() for one in cells) > 0.6 * room.width() * room.height()
        for one in view.pictures.values():
            row, column, height, width = one.shot.extent
            assert one.box.viewRect().adjusted(-30, -30, 30, 30).contains(QRectF(column, row, width, height))
    assert [one.shot.pixel_um for one in view.pictures.values()] == [60, None, None]
    moved = view.pictures["xz"]
    moved.box.scaleBy((0.5, 0.5))
    moved.box.translateBy(x=200.0, y=0.0)
    moved.moved.emit()
    (half,) = scales()
    assert half == pytest.approx(scale / 2, rel=0.01)
    assert view.pictures["xy"].box.viewRect().center().x() == pytest.approx(moved.box.viewRect().center().x())
    moved.show_all()
    assert scales() == {scale}


def test_slice_and_strip_follow_the_cross(view: VolumeView) -> None:
    """In 3-D the slice through the cross is at the right; the strip shows each plane with its share of the light."""
    assert view.slice.isVisible() and "1.5 mm" in view.slice.shot.caption
    assert view.solid.shot.caption.splitlines() == ["Volume", "30 × 20 × 4 voxels"], "one line was cut"
    np.testing.assert_array_equal(view.slice.values, volume()[2])
    assert [round(tile.depth_um) for tile in view.strip.tiles] == DEPTHS.tolist()
    shares = [float(part) for part in volume().sum((1, 2)) / volume().sum()]
    assert f"{shares[1] * 100:.0f} % of the light" in view.strip.item(1).toolTip()
    view.strip.chosen.emit(0)
    assert view.intent.z == 0 and "3 mm" in view.slice.shot.caption
    view.slice.steered_to.emit(7, 9)
    assert (view.intent.y, view.intent.x) == (7, 9) and lines_in(view.slice) == {7 * 60, 9 * 60}
    view.segments[1].click()
    assert not view.slice.isVisible()


def drag(picture: Picture, *places: tuple[float, float]) -> None:
    """Drag the pointer through ``places`` (row, column in the units of the picture) with the left button."""
    port = picture.graphics.viewport()
    points = [picture.graphics.mapFromScene(picture.box.mapViewToScene(QPointF(x, y))) for y, x in places]
    QTest.mousePress(port, Qt.MouseButton.LeftButton, pos=points[0])
    for point in points:
        QTest.mouseMove(port, point)
    QTest.mouseRelease(port, Qt.MouseButton.LeftButton, pos=points[-1])


def test_regions_are_drawn_in_one_slice_and_get_their_third_extent_in_another(view: VolumeView) -> None:
    """Voxels are 60 µm wide; planes are at 3, 2, 1.5 and 1 mm, so that plane 1 reaches from 1.75 to 2.5 mm."""
    view.drawing.trigger()
    view.set_cross(z=2, y=6, x=10)
    drag(view.slice, (4 * 60, 8 * 60), (9 * 60, 2 * 60))
    assert view.intent.regions.boxes == (((2, 3), (4, 10), (2, 9)),)
    assert (view.intent.y, view.intent.x) == (6, 10), "the cross stays"
    outline = next(one for one in view.slice.overlays if isinstance(one, Outline) and one.closed)
    assert outline.points.min(0).tolist() == [210, 90] and outline.points.max(0).tolist() == [570, 510]
    view.set_cross(z=1)
    assert not [one for one in view.slice.overlays if isinstance(one, Label)], "this slice does not cut the region"
    view.segments[1].click()
    view.set_cross(z=2, x=5)
    QApplication.processEvents()
    drag(view.pictures["xz"], (1900, 4 * 60), (1400, 6 * 60))
    assert view.intent.regions.boxes == (((1, 3), (4, 10), (4, 7)),)
    (outline,) = (one for one in view.pictures["yz"].overlays if isinstance(one, Outline) and one.closed)
    assert sorted(np.ptp(outline.points, axis=0).tolist()) == [360, 1250]
    view.segments[2].click()
    QApplication.processEvents()
    drag(view.pictures["xy"], (12 * 60, 20 * 60), (14 * 60, 25 * 60))
    drag(view.pictures["xy"], (0, 0), (0, 0))
    assert view.intent.regions.boxes[1:] == (((0, 4), (12, 15), (20, 26)), ((0, 4), (0, 1), (0, 1)))
    assert {one.words for one in view.pictures["xz"].overlays if isinstance(one, Label)} == {"1", "2", "3"}
    drawn = view.drawn_labels()
    assert drawn is not None and drawn.depths_um is not None and drawn.depths_um.tolist() == DEPTHS.tolist()
    counts = np.bincount(drawn.labels.ravel())[1:].tolist()
    assert counts == [2 * 6 * 3, 4 * 3 * 6, 4] and (drawn.labels[1:3, 4:10, 4:7] == 1).all()
    view.set_volume(volume() * 2, DEPTHS, (60.0, 60.0))
    assert len(view.intent.regions.boxes) == 3, "another volume of the same shape"
    view.drawing.trigger()
    drag(view.pictures["xy"], (5 * 60, 5 * 60))
    assert view.intent.y == 5, "drags move the cross again"
    view.no_regions.trigger()
    assert view.drawn_labels() is None
    view.drawing.trigger()
    drag(view.pictures["xy"], (5 * 60, 5 * 60))
    view.set_volume(volume()[:2])
    assert not view.intent.regions.boxes, "a volume of another shape"


@pytest.fixture
def jobs() -> Iterator[Jobs]:
    made = Jobs()
    yield made
    made.close()


def test_in_the_background_the_newest_is_drawn_and_nothing_of_a_volume_that_is_gone(qtbot: QtBot, jobs: Jobs) -> None:
    view = shown(qtbot, VolumeView(jobs))
    idle(jobs, qtbot)
    for _ in range(30):
        view._turn(0.05, 0.0)
    idle(jobs, qtbot)
    qtbot.waitUntil(lambda: not view.solid._rest.isActive() and not jobs.busy, timeout=GUARD_MS)
    drawn = view.solid._drawn
    np.testing.assert_array_equal(drawn[0].turn, view.turn)
    view.set_volume(2 * volume(), DEPTHS, (60.0, 60.0))
    view.set_volume(None)
    idle(jobs, qtbot)
    assert view.prepared is None and view.solid.values is None


def test_work_that_fails_does_not_stop_what_follows(qtbot: QtBot, jobs: Jobs) -> None:
    newest, taken, said = Newest(jobs, "some"), list[Any](), list[str]()
    jobs.trouble.connect(said.append)
    newest.ask(lambda: 1 / 0, taken.append)
    for k in range(5):
        newest.ask(lambda k=k: k, taken.append)
    idle(jobs, qtbot)
    assert taken == [4] and said


def test_a_volume_is_red_where_all_is_red(qapp: QApplication, view: VolumeView) -> None:
    try:
        apply_theme(qapp, NIGHT)
        view.apply_theme()
        assert view.solid.item.image.ndim == 2
        view.segments[1].click()
        for item in (view.solid.item, *(one.item for one in view.pictures.values())):
            assert not item.lut[:, 1:3].any() and item.lut[:, 0].any()
    finally:
        apply_theme(qapp, LIGHT)
    view.apply_theme()
    view.segments[0].click()
    assert view.solid.item.image.ndim == 3


def test_volume_and_truth_keep_one_zoom_wherever_there_is_more_room(view: VolumeView) -> None:
    view.set_volume(volume(), DEPTHS, (60.0, 60.0), volume())
    view.show_all()
    for size, below in (((900, 600), False), ((500, 900), True), ((1000, 900), None), ((1000, 300), None)):
        view.resize(*size)
        QApplication.processEvents()
        boxes = [look.solid.box.viewRect() for look in view.looks]
        assert boxes[0].getRect() == pytest.approx(boxes[1].getRect(), rel=0.01), "one may be a pixel wider"
        first, second = (look.geometry() for look in view.looks)
        if below is not None:
            assert (second.top() > first.bottom()) is below and (second.left() > first.right()) is not below


def test_it_is_sharp_at_rest_and_when_zoomed(view: VolumeView, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    view.solid.box.scaleBy((0.2, 0.2))
    qtbot.waitUntil(lambda: not view.solid._rest.isActive(), timeout=GUARD_MS)
    seen, extent = view.solid.box.viewRect(), view.solid.shot.extent
    assert extent[3] == pytest.approx(seen.width(), rel=0.02) and extent[0] == pytest.approx(seen.top(), rel=0.05)
    monkeypatch.setattr("lfcal_gui.pages.reconstruct._solid_picture.QUICK_PIXELS", 1e3)
    view._turn(0.1, 0.0)
    coarse = view.solid.shot.step
    qtbot.waitUntil(lambda: view.solid.shot.step < coarse / 4, timeout=GUARD_MS)


def test_volumes_without_light_or_depth_are_shown(view: VolumeView) -> None:
    for values in (np.zeros((1, 1, 1)), np.full((3, 4, 5), np.nan), np.full((1, 6, 7), 2.0)):
        view.set_volume(values)
        for k in range(3):
            view.segments[k].click()
        outlines = [one for one in view.solid.overlays if isinstance(one, Outline)]
        assert view.solid.values is not None and all(np.isfinite(one.points).all() for one in outlines)
