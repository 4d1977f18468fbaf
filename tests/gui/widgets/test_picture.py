"""The one view: values, what is drawn over them and words are of the same moment, and values follow the pointer."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPoint, QPointF, QRectF, Qt
from PySide6.QtGui import QPainter
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from lfcal_gui.context import Context
from lfcal_gui.models.display import SCALES, DisplaySettings, colour_table, depth_colours, to_uint8
from lfcal_gui.models.shot import Label, Outline, Shot, Symbols, Tint, cutout_of, scale_bar
from lfcal_gui.pages.reconstruct._volume_view import VolumeView
from lfcal_gui.pages.simulate._effect_panel import InfluenceView
from lfcal_gui.pages.simulate.model_frames import InfluencePictures
from lfcal_gui.theme import LIGHT, NIGHT, apply_theme
from lfcal_gui.widgets import picture as module
from lfcal_gui.widgets.colours import ramp
from lfcal_gui.widgets.picture import LARGE, Picture, link, share_contrast
from tests.gui.waiting import GUARD_MS, idle

SIDE = math.isqrt(LARGE) + 1
"""Side of a picture that is drawn in the background."""


def shown(qtbot: QtBot, picture: Any, size: tuple[int, int] = (300, 260)) -> Any:
    qtbot.addWidget(picture)
    picture.resize(*size)
    picture.show()
    qtbot.waitExposed(picture, timeout=GUARD_MS)
    return picture


@pytest.fixture
def view(qtbot: QtBot) -> Picture:
    made: Picture = shown(qtbot, Picture())
    return made


@pytest.mark.parametrize(
    "display", [DisplaySettings("log"), DisplaySettings("gamma"), DisplaySettings(colour_map="viridis")]
)
def test_another_scaling_keeps_the_scale_that_pictures_share(view: Picture, display: DisplaySettings) -> None:
    view.set_shot(Shot(np.full((3, 3), 5.0), levels=(-20.0, 2437.0)))
    view.set_display(display)
    assert view.levels == (-20.0, 2437.0)


@pytest.mark.parametrize(
    ("quantity", "wide", "words"),
    [
        ("transmission (1)", 210, "transmission (1)"),
        ("transmission (1)", 400, "transmission (1)"),
        ("transmission (1)", 140, "(1)"),
        ("fraction of the light", 180, "1"),
    ],
)
def test_the_quantity_of_a_legend_is_whole(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, quantity: str, wide: int, words: str
) -> None:
    """Narrow pictures wrote "transmissio…" next to colours of full length, or "fraction …"."""
    said: list[str] = []

    class Painter(QPainter):
        def drawText(self, *given: Any) -> None:
            said.append(given[-1])
            super().drawText(*given)

    view = shown(qtbot, Picture(quantity))
    view.resize(wide, 200)
    view.set_shot(Shot(np.linspace(0, 1, 16).reshape(4, 4)))
    monkeypatch.setattr(module, "QPainter", Painter)
    assert view.legend is not None
    view.legend.grab()
    assert said[-1] == words and view.legend.toolTip() == quantity


@pytest.mark.parametrize("scale", ["linear", "gamma", "log"])
def test_the_legend_has_the_colours_of_the_picture(view: Picture, scale: str) -> None:
    levels = (-20.0, 980.0)
    view.set_display(DisplaySettings(scale))
    view.set_shot(Shot(np.linspace(*levels, 256)[None], levels=levels))
    seen = colour_table("magma")[view.item.image[0]]
    colours = ramp(view.display, levels, 256)
    told = np.array([colours.pixelColor(k, 0).getRgb() for k in range(256)])
    assert np.abs(seen.astype(int) - told).max() <= 4


def test_signed_values_are_dark_at_zero_and_leave_the_display_alone(view: Picture) -> None:
    view.set_display(DisplaySettings("log", "viridis"))
    view.set_shot(Shot(np.array([[-2.0, 0.0, 1.0]]), signed=True))
    assert view.levels == (-2.0, 2.0) and view.display.scale == "linear"
    middle = colour_table(view.display.colour_map)[view.item.image[0, 1]][:3]
    assert middle.max() < 60
    view.set_shot(Shot(np.array([[0.0, 1.0]])))
    assert view.display == DisplaySettings("log", "viridis")


def test_colours_are_shown_as_they_look(view: Picture) -> None:
    red = np.zeros((2, 3, 3))
    red[..., 0] = 1.0
    view.set_shot(Shot(red))
    assert view.item.image.shape == (2, 3, 3) and tuple(view.item.image[0, 0]) == (255, 0, 0)
    np.testing.assert_allclose(view.values, 1 / 3)


def middle(view: Picture) -> QPointF:
    """Return the place of pixel (1, 1) in the scene."""
    return view.box.mapViewToScene(QPointF(1.0, 1.0))


def test_a_resting_pointer_tells_the_value_of_the_new_picture(view: Picture) -> None:
    told: list[tuple[int, int, float]] = []
    view.set_shot(Shot(np.zeros((3, 3))))
    view.hovered.connect(lambda *found: told.append(found))
    view._point_at(middle(view))
    view.set_shot(Shot(np.full((3, 3), 7.0)))
    assert told == [(1, 1, 0.0), (1, 1, 7.0)]
    view.set_shot(None)
    assert told[-1][0] == -1
    view.leaveEvent(QEvent(QEvent.Type.Leave))
    seen = len(told)
    view.set_shot(Shot(np.ones((3, 3))))
    assert len(told) == seen and math.isnan(told[-1][2])


# -- large pictures ------------------------------------------------------------------------------------------
class Held:
    """Computes when it is asked to."""

    def __init__(self) -> None:
        self.asked: list[tuple[Callable[[], Any], Callable[[Any], None]]] = []

    def compute(self, _: str, work: Callable[[], Any], done: Callable[[Any], None], *others: Any) -> None:
        self.asked.append((work, done))

    def answer(self) -> None:
        work, done = self.asked.pop(0)
        done(work())


def frame(row: int) -> Shot:
    """Return a large frame with one bright row, whose caption and cutout name it."""
    values = np.zeros((SIDE, SIDE), np.uint16)
    values[row] = 100
    return Shot(values, f"row {row}", levels=(0, 100), overlays=cutout_of(row, 5, (1, 1)))


def test_cutout_caption_and_frame_are_of_the_same_moment(qtbot: QtBot) -> None:
    """Frames came faster than they were drawn: the cutout of one lay over the light of another."""
    jobs = Held()
    view = shown(qtbot, Picture(jobs=jobs))  # type: ignore[arg-type]
    rows = (0, SIDE // 3, 2 * SIDE // 3)
    for row in rows:
        view.set_shot(frame(row))
    drawn = []
    view.changed.connect(lambda: drawn.append((brightest(view), caption_row(view), cutout_row(view))))
    while jobs.asked:
        jobs.answer()
    assert drawn == [(rows[0],) * 3, (rows[2],) * 3], "a late picture with its own cutout, then the newest"


def brightest(view: Picture) -> int:
    place = view.item.mapRectToParent(view.item.boundingRect())
    row = int(np.argmax(view.item.image.max(axis=1)))
    found = place.top() + (row + 0.5) * place.height() / view.item.image.shape[0]
    return round(min((0, SIDE // 3, 2 * SIDE // 3), key=lambda row: abs(row - found)))


def caption_row(view: Picture) -> int:
    return int(view.shot.caption.split()[1])


def cutout_row(view: Picture) -> int:
    (border,) = view.overlays
    return round(float(border.points[:, 0].mean()))


def test_a_frame_that_is_taken_away_is_not_drawn_late(context: Context, qtbot: QtBot) -> None:
    view = shown(qtbot, Picture(jobs=context.jobs))
    for following in (None, Shot(np.ones((3, 3)))):
        view.set_shot(frame(3))
        view.set_shot(following)
        idle(context.jobs, qtbot)
        assert view.values is (None if following is None else following.values)
        assert following is not None or view.item.image is None


def test_a_large_picture_shows_what_is_seen_of_it_and_keeps_point_sources(context: Context, qtbot: QtBot) -> None:
    values = np.zeros((4 * SIDE, 3 * SIDE), np.uint16)
    values[1234, 987] = 900
    view = shown(qtbot, Picture(jobs=context.jobs))
    view.set_shot(Shot(values, step=2.0, origin=(10.0, 20.0)))
    idle(context.jobs, qtbot)
    assert view.item.image.max() == 255 and view.item.image.size < values.size / 16
    view.show_part(10 + 2 * 1230, 20 + 2 * 980, 20, 20)
    qtbot.waitUntil(lambda: not view._timer.isActive(), timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    row, column = np.unravel_index(np.argmax(view.item.image), view.item.image.shape)
    place = view.item.mapRectToParent(view.item.boundingRect())
    step = place.height() / view.item.image.shape[0]
    assert step == 2.0
    assert (place.top() + (row + 0.5) * step, place.left() + (column + 0.5) * step) == (10 + 2 * 1234, 20 + 2 * 987)


# -- what is drawn over it -----------------------------------------------------------------------------------
def test_overlays_lie_on_their_pixels(qtbot: QtBot) -> None:
    view = shown(qtbot, Picture(legend=False))
    overlays = (
        Outline(np.array([(1.5, 1.5), (1.5, 6.5), (6.5, 6.5), (6.5, 1.5)]), "#00ff00", width=2),
        Symbols(np.array([(8.0, 8.0)]), "s", "#0000ff", 8, filled=True),
    )
    view.set_shot(Shot(np.zeros((10, 10)), overlays=overlays, cross=(8, 2)))
    QApplication.processEvents()
    image = view.grab().toImage()

    def colour(row: float, column: float) -> tuple[int, ...]:
        at = view.graphics.mapFromScene(view.box.mapViewToScene(QPointF(column, row)))
        return image.pixelColor(view.graphics.mapTo(view, at)).getRgb()[:3]

    assert colour(4.0, 1.5)[1] > 150 > colour(4.0, 1.5)[0], "the line of the outline"
    assert max(colour(4.0, 4.0)) < 40, "it is not filled"
    assert colour(8.0, 8.0)[2] > 150, "the mark"
    assert min(colour(8.0, 1.5)) > 120, "the square about the pixel that is pointed out"
    view.set_cross(None)
    view.set_overlays()
    view.set_shot(replace(view.shot, overlays=()))
    QApplication.processEvents()
    image = view.grab().toImage()
    assert max(colour(8.0, 8.0)) < 40 > max(colour(8.0, 1.5))


def test_rimmed_lines_and_labels_are_seen_on_bright_pixels(qtbot: QtBot) -> None:
    """White axes of a volume disappeared on bright voxels."""
    view = shown(qtbot, Picture(legend=False))
    drawn = Outline(np.array([(2.0, 1.0), (2.0, 8.0)]), closed=False, rimmed=True), Label(np.array([(7.0, 5.0)]), "x")
    for overlay in drawn:
        view.set_shot(Shot(np.ones((10, 10)), levels=(0.0, 1.0), overlays=(overlay,)))
        view.set_display(DisplaySettings(colour_map="gray"))
        QApplication.processEvents()
        inside = view.box.mapViewToScene(QRectF(0.5, 0.5, 8, 8)).boundingRect()
        image = view.graphics.grab(view.graphics.mapFromScene(inside).boundingRect()).toImage()
        pixels = [image.pixelColor(x, y) for x in range(image.width()) for y in range(image.height())]
        assert sum(pixel.lightness() < 160 for pixel in pixels) > 20, overlay


def test_a_caption_is_read_on_the_picture_and_is_red_in_a_dark_lab(qapp: QApplication, qtbot: QtBot) -> None:
    try:
        for theme, red in ((LIGHT, False), (NIGHT, True)):
            apply_theme(qapp, theme)
            view = shown(qtbot, Picture(legend=False))
            view.set_shot(Shot(np.zeros((20, 20)), "H, position y 3, x 4", pixel_um=5.5, cross=(3, 3)))
            QApplication.processEvents()
            image = view.grab().toImage()
            pixels = [image.pixelColor(x, y) for x in range(image.width()) for y in range(image.height())]
            bright = [one for one in pixels if max(one.getRgb()[:3]) > 150]
            assert bright and all((one.blue() < 0.7 * one.red()) is red for one in bright)
    finally:
        apply_theme(qapp, LIGHT)


@pytest.mark.parametrize(("pixel_um", "pixels", "words"), [(5.5, 0.1, "50 µm"), (5.5, 10, "5 mm"), (0.2, 0.05, "1 µm")])
def test_a_scale_bar_is_a_round_length(pixel_um: float, pixels: float, words: str) -> None:
    length, told = scale_bar(pixel_um, pixels, 140)
    assert told == words and 140 / 2.5 <= length <= 140
    number, unit = told.split()
    assert length * pixels * pixel_um == pytest.approx(float(number) * {"µm": 1, "mm": 1e3}[unit])


def test_there_is_no_number_of_what_is_not_there(qtbot: QtBot) -> None:
    view = shown(qtbot, Picture(axes=("column (px)", "row (px)")))
    view.set_shot(Shot(np.eye(5)))
    assert view.plot is not None and view.plot.getAxis("left").span == (0.0, 4.0)
    assert shown(qtbot, Picture()).plot is None, "axes are drawn where they are asked for"


# -- several pictures ----------------------------------------------------------------------------------------
def test_moving_one_moves_the_other(qtbot: QtBot) -> None:
    views = [shown(qtbot, Picture()) for _ in range(2)]
    for one in views:
        one.set_shot(Shot(np.eye(50)))
    link(*views)
    first, second = (one.box for one in views)
    first.setRange(xRange=(10, 20), yRange=(10, 20), padding=0)
    first.sigRangeChangedManually.emit(first.mouseEnabled())
    assert second.viewRect().center().x() == pytest.approx(15) == second.viewRect().center().y()
    assert second.viewRect().width() == pytest.approx(first.viewRect().width(), rel=0.05)
    views[1].show_all()
    assert first.viewRect().width() >= 50


def test_a_contrast_that_is_shared_holds_for_all(qtbot: QtBot) -> None:
    first, second, other = (shown(qtbot, Picture()) for _ in range(3))
    share_contrast(first, second)
    for one in (first, second, other):
        one.set_shot(Shot(np.arange(9.0).reshape(3, 3)))
    second.set_contrast((2.0, 3.0))
    assert first.levels == second.levels == (2.0, 3.0) and other.levels == (0.0, 8.0)
    first.set_shot(Shot(np.full((3, 3), 100.0)))
    assert first.levels == (2.0, 3.0), "it stays with the next picture"
    first.set_contrast(None)
    assert second.levels == (0.0, 8.0)


def test_slices_of_a_volume_are_measured_and_steered(qtbot: QtBot, tmp_path: Path) -> None:
    """A right click offered copying and saving of the whole view only."""
    view = shown(qtbot, VolumeView(), (600, 500))
    volume = np.random.default_rng(0).random((3, 20, 30)).astype(np.float32)
    view.segments[1].click()
    assert not view.pictures["xy"].entries(), "there is nothing to measure yet"
    view.set_volume(volume)
    view.set_cross(z=1, y=5, x=7)
    for name, wanted in (("xy", volume[1]), ("xz", volume[:, 5]), ("yz", volume[:, :, 7].T)):
        picture = view.pictures[name]
        np.testing.assert_array_equal(picture.values, wanted)
        offered = dict(picture.entries())
        assert list(offered) == ["Contrast, profile, region …", "Copy values", "Save data …"]
        offered["Copy values"]()
        assert len(QApplication.clipboard().text().splitlines()) == wanted.shape[0]
    view.pictures["xy"].save_data(str(tmp_path / "slice.npy"))
    np.testing.assert_array_equal(np.load(tmp_path / "slice.npy"), volume[1])
    view.pictures["xy"].set_contrast((0.25, 0.5))
    view.set_cross(z=2)
    assert view.pictures["xy"].levels == (0.25, 0.5) == view.pictures["yz"].levels, (
        "contrast stays with the next slice, for all three"
    )
    view.pictures["xz"].steered_to.emit(0, 11)
    assert (view.intent.z, view.intent.x) == (0, 11)
    view.pictures["yz"].steered_to.emit(6, 2)
    assert (view.intent.z, view.intent.y) == (2, 6)
    lines = {tuple(line.points.mean(0)) for line in view.pictures["xy"].overlays if isinstance(line, Outline)}
    assert lines == {(9.5, 11.0), (6.0, 14.5)}
    view.set_volume(None)
    assert view.pictures["xy"].values is None


def test_colours_of_depth_have_the_brightness_of_values(view: Picture) -> None:
    """Levels, logarithm and root are those of every other picture; where all is red there are none of depth."""
    values = np.linspace(0, 100, 60).reshape(6, 10).astype(np.float32)
    values[0, 0] = np.nan
    tint = np.tile(np.linspace(0, 1, 10), (6, 1))
    colours = depth_colours()[np.rint(255 * tint).astype(int), :3].astype(float)
    for scale in SCALES:
        for levels in (None, (20.0, 60.0)):
            view.set_display(DisplaySettings(scale, "viridis"))
            view.set_contrast(levels)
            view.set_shot(Shot(values, tint=Tint(tint, ("1 mm", "2 mm"))))
            grey = to_uint8(values, view.display, view.levels)
            assert view.display.colour_map == "gray" and view.levels == (levels or (float(np.nanmin(values)), 100.0))
            np.testing.assert_allclose(view.item.image, colours * grey[..., None] / 255, atol=1.5)
    view.set_shot(Shot(values))
    assert view.display.colour_map == "viridis" and view.item.image.ndim == 2


def test_a_part_of_a_picture_keeps_pan_and_zoom_and_shows_all_of_it(view: Picture) -> None:
    whole = (-10.0, -10.0, 20.0, 20.0)
    view.set_shot(Shot(np.ones((4, 4)), whole=whole))
    seen = view.box.viewRect()
    assert seen.contains(QRectF(-10, -10, 20, 20).adjusted(0.1, 0.1, -0.1, -0.1))
    view.show_part(0, 0, 5, 5)
    zoomed = view.box.viewRect()
    view.set_shot(Shot(np.ones((9, 7)), origin=(1.0, 2.0), step=0.5, whole=whole))
    assert view.box.viewRect() == zoomed
    view.show_all()
    assert view.box.viewRect() == seen


def test_pictures_of_an_effect_have_one_contrast(qtbot: QtBot) -> None:
    view = shown(qtbot, InfluenceView())
    rng = np.random.default_rng(1)
    first, second = (rng.random((9, 11)).astype(np.float32) for _ in range(2))
    view.show_influence(
        InfluencePictures(first, second, (-4, -5), ("column s", "row t"), "share of the light", "computed")
    )
    without, with_it, difference = view.pictures
    np.testing.assert_array_equal(with_it.values, second)
    assert with_it.shot.origin == (-4, -5)
    assert without.levels == with_it.levels
    without.set_contrast((0.1, 0.2))
    assert with_it.levels == (0.1, 0.2)
    assert difference.levels[1] == pytest.approx(-difference.levels[0])
    view.show_influence(None, "nothing")
    assert not difference.entries()


# -- pointer and keys ----------------------------------------------------------------------------------------
def test_a_steered_picture_tells_the_nearest_pixel_while_it_is_held(qtbot: QtBot) -> None:
    view = shown(qtbot, Picture(steered=True))
    view.set_shot(Shot(np.zeros((4, 6)), origin=(10.0, 0.0)))
    told: list[tuple[int, int]] = []
    view.steered_to.connect(lambda *place: told.append(place))
    port = view.graphics.viewport()

    def at(row: float, column: float) -> QPoint:
        return view.graphics.mapFromScene(view.box.mapViewToScene(QPointF(column, row)))

    QTest.mousePress(port, Qt.MouseButton.LeftButton, pos=at(11, 2))
    QTest.mouseMove(port, at(12, 5))
    QTest.mouseMove(port, at(12, 60))
    QTest.mouseRelease(port, Qt.MouseButton.LeftButton, pos=at(12, 60))
    QTest.mouseMove(port, at(10, 0))
    assert told[0] == (1, 2) and told[-1] == (2, 5) and (0, 0) not in told


def test_a_grip_is_dragged_by_whole_pixels_and_by_keys(view: Picture) -> None:
    view.set_shot(Shot(np.zeros((20, 20))))
    view.set_grip((8, 8, 4, 4))
    view.show_part(0, 0, 19, 19, padding=0)
    told: list[tuple[int, int]] = []
    view.dragged.connect(lambda *way: told.append(way))

    def at(row: float, column: float) -> QPoint:
        return view.graphics.mapFromScene(view.box.mapViewToScene(QPointF(column, row)))

    port, before = view.graphics.viewport(), view.box.viewRect()
    QTest.mousePress(port, Qt.MouseButton.LeftButton, pos=at(9, 9))
    QTest.mouseMove(port, at(9.4, 9.4))
    QTest.mouseMove(port, at(12.2, 10.3))
    QTest.mouseMove(port, at(9.1, 10.3))
    QTest.mouseRelease(port, Qt.MouseButton.LeftButton, pos=at(9.1, 10.3))
    assert np.sum(told, axis=0).tolist() == [0, 1] and view.box.viewRect() == before
    told.clear()
    QTest.mousePress(port, Qt.MouseButton.LeftButton, pos=at(2, 2))
    QTest.mouseMove(port, at(6, 6))
    QTest.mouseRelease(port, Qt.MouseButton.LeftButton, pos=at(6, 6))
    assert not told, "what begins elsewhere moves the picture"
    for key in (Qt.Key.Key_Up, Qt.Key.Key_Right):
        QTest.keyClick(view, key)
    assert told == [(-1, 0), (0, 1)]
    view.set_grip(None)
    QTest.keyClick(view, Qt.Key.Key_Up)
    assert len(told) == 2


def test_keys_copy_values_and_picture(view: Picture, qtbot: QtBot) -> None:
    view.set_shot(Shot(np.array([[1.5, 2.0], [3.0, 4.0]])))
    QTest.keyClick(view, Qt.Key.Key_C)
    assert QApplication.clipboard().text() == "1.5\t2\n3\t4"
    QTest.keyClick(view, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    assert not QApplication.clipboard().pixmap().isNull()


def test_the_menu_follows_what_is_shown_and_what_was_chosen(view: Picture) -> None:
    def titles() -> list[str]:
        return [text for text, _ in view.entries()]

    assert titles() == []
    view.set_shot(Shot(np.arange(12.0).reshape(3, 4)))
    first, last = "Contrast, profile, region …", "Save data …"
    assert titles() == [first, "Copy values", last]
    view.set_contrast((1.0, 2.0))
    assert titles() == [first, "Automatic contrast", "Copy values", last]
    dict(view.entries())["Automatic contrast"]()
    assert view.contrast is None and titles() == [first, "Copy values", last]
    view.set_shot(Shot(np.zeros((SIDE, SIDE), np.uint8)))
    assert titles() == [first, last], "a whole frame is too much for a spreadsheet"


@pytest.mark.parametrize("pixels", [300, 450, 611, 1400])
def test_fine_patterns_of_a_shrunk_picture_do_not_beat(qtbot: QtBot, pixels: int) -> None:
    """A pattern of alternate columns has one brightness where each pixel of the screen covers several of them."""
    view = shown(qtbot, Picture(legend=False, colour_map="gray"), (300, 300))
    stripes = np.tile(np.arange(pixels) % 2, (pixels, 1)).astype(np.float32)
    view.set_shot(Shot(stripes, levels=(0.0, 1.0)))
    view.show_part(-0.5, -0.5, pixels, pixels, padding=0)
    image = view.graphics.grab().toImage()
    grey = np.array([image.pixelColor(x, 150).red() for x in range(20, 280)], float)
    if pixels > 300:
        # blocks of ten columns: what the eye sees of the beat
        assert np.ptp(grey.reshape(-1, 10).mean(1)) < 40
    else:
        assert set(grey) == {0.0, 255.0}, "pixels that are not shrunk stay sharp"
