"""Pictures: values, overlays and captions of one moment; large ones; the pointer, keys, menu and measurements."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from PySide6.QtCore import QEvent, QPoint, QPointF, QRectF, Qt
from PySide6.QtGui import QImage, QPainter
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMenu, QSplitter, QWidget
from pytestqt.qtbot import QtBot

from lfcal_gui.jobs import Jobs
from lfcal_gui.models.display import SCALES, DisplaySettings, colour_table, depth_colours, to_uint8
from lfcal_gui.models.shot import Label, Outline, Shot, Symbols, Tint, cutout_of, scale_bar
from lfcal_gui.pages.simulate._effect_panel import InfluenceView
from lfcal_gui.pages.simulate.model_frames import InfluencePictures
from lfcal_gui.theme import LIGHT, NIGHT, apply_theme
from lfcal_gui.widgets import picture as module
from lfcal_gui.widgets.axis_arrows import MIDDLE, STAGE, AxisArrows
from lfcal_gui.widgets.colours import ramp
from lfcal_gui.widgets.picture import LARGE, Picture, link, share_contrast
from lfcal_gui.widgets.plots import LinePlot
from tests.gui.waiting import GUARD_MS, idle

SIDE = math.isqrt(LARGE) + 1
"""Side of a picture that is drawn in the background (px)."""


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


def screen(widget: QWidget) -> np.ndarray:
    """Return the colours of a widget as it is drawn, ``(rows, columns, 3)``."""
    image = widget.grab().toImage().convertToFormat(QImage.Format.Format_RGB888)
    rows = np.frombuffer(image.constBits(), np.uint8).reshape(image.height(), image.bytesPerLine())
    return rows[:, : 3 * image.width()].reshape(image.height(), image.width(), 3).astype(int)


def test_a_change_is_painted_once(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second of two pictures in a window was painted twice, and a mark that did not move once."""
    window = QSplitter()
    views = [Picture(parent=window), Picture(parent=window)]
    shown(qtbot, window, (500, 260))
    painted: list[int] = []
    paint_over = Picture.paint_over

    def counted(view: Picture, painter: QPainter) -> None:
        painted.append(views.index(view))
        paint_over(view, painter)

    monkeypatch.setattr(Picture, "paint_over", counted)
    for k in range(3):
        qtbot.wait(50)
        painted.clear()
        for view in views:
            view.set_shot(frame(k))
            view.set_cross(1, 2)
    qtbot.waitUntil(lambda: len(painted) >= 2, timeout=GUARD_MS)
    qtbot.wait(50)
    assert sorted(painted) == [0, 1]
    views[0].set_cross(1, 2)
    qtbot.wait(50)
    assert sorted(painted) == [0, 1]
    views[0].set_cross(1, 3)
    qtbot.waitUntil(lambda: sorted(painted) == [0, 0, 1], timeout=GUARD_MS)


# -- colours and legend ------------------------------------------------------------------------------------
def test_another_scaling_keeps_the_scale_that_pictures_share(view: Picture) -> None:
    view.set_shot(Shot(np.full((3, 3), 5.0), levels=(-20.0, 2437.0)))
    for display in (DisplaySettings("log"), DisplaySettings("gamma"), DisplaySettings(colour_map="viridis")):
        view.set_display(display)
        assert view.levels == (-20.0, 2437.0)


def test_the_quantity_of_a_legend_is_whole(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    """Narrow pictures wrote "transmissio…" next to colours of full length, or "fraction …"."""
    drawn: list[str] = []

    class Painter(QPainter):
        def drawText(self, *given: Any) -> None:
            drawn.append(given[-1])
            super().drawText(*given)

    monkeypatch.setattr(module, "QPainter", Painter)
    for quantity, wide, words in (
        ("transmission (1)", 210, "transmission (1)"),
        ("transmission (1)", 400, "transmission (1)"),
        ("transmission (1)", 140, "(1)"),
        ("fraction of the light", 180, "1"),
    ):
        view = shown(qtbot, Picture(quantity), (wide, 200))
        view.set_shot(Shot(np.linspace(0, 1, 16).reshape(4, 4)))
        view.legend.grab()
        assert drawn[-1] == words and view.legend.toolTip() == quantity


def test_the_legend_has_the_colours_of_the_picture(view: Picture) -> None:
    levels = (-20.0, 980.0)
    for scale in ("linear", "gamma", "log"):
        view.set_display(DisplaySettings(scale))
        view.set_shot(Shot(np.linspace(*levels, 256)[None], levels=levels))
        seen = colour_table("magma")[view.item.image[0]]
        colours = ramp(view.display, levels, 256)
        legend = np.array([colours.pixelColor(k, 0).getRgb() for k in range(256)])
        assert np.abs(seen.astype(int) - legend).max() <= 4, scale


def test_signed_values_are_dark_at_zero_and_colours_are_unchanged(view: Picture) -> None:
    view.set_display(DisplaySettings("log", "viridis"))
    view.set_shot(Shot(np.array([[-2.0, 0.0, 1.0]]), signed=True))
    assert view.levels == (-2.0, 2.0) and view.display.scale == "linear"
    assert colour_table(view.display.colour_map)[view.item.image[0, 1]][:3].max() < 60
    view.set_shot(Shot(np.array([[0.0, 1.0]])))
    assert view.display == DisplaySettings("log", "viridis"), "the display of the user comes back"
    red = np.zeros((2, 3, 3))
    red[..., 0] = 1.0
    view.set_shot(Shot(red))
    assert view.item.image.shape == (2, 3, 3) and tuple(view.item.image[0, 0]) == (255, 0, 0)
    np.testing.assert_allclose(view.values, 1 / 3)


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


# -- large pictures ----------------------------------------------------------------------------------------


# -- large pictures ------------------------------------------------------------------------------------------
class Waiting:
    """Jobs that compute on request."""

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
    jobs = Waiting()
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


def test_a_frame_that_was_removed_is_not_drawn_late(jobs: Jobs, qtbot: QtBot) -> None:
    view = shown(qtbot, Picture(jobs=jobs))
    for following in (None, Shot(np.ones((3, 3)))):
        view.set_shot(frame(3))
        view.set_shot(following)
        idle(jobs, qtbot)
        assert view.values is (None if following is None else following.values)
        assert following is not None or view.item.image is None


def test_a_large_picture_draws_its_visible_part_and_keeps_point_sources(jobs: Jobs, qtbot: QtBot) -> None:
    values = np.zeros((4 * SIDE, 3 * SIDE), np.uint16)
    values[1234, 987] = 900
    view = shown(qtbot, Picture(jobs=jobs))
    view.set_shot(Shot(values, step=2.0, origin=(10.0, 20.0)))
    idle(jobs, qtbot)
    assert view.item.image.max() == 255 and view.item.image.size < values.size / 16
    view.show_part(10 + 2 * 1230, 20 + 2 * 980, 20, 20)
    qtbot.waitUntil(lambda: not view._timer.isActive(), timeout=GUARD_MS)
    idle(jobs, qtbot)
    row, column = np.unravel_index(np.argmax(view.item.image), view.item.image.shape)
    place = view.item.mapRectToParent(view.item.boundingRect())
    step = place.height() / view.item.image.shape[0]
    assert step == 2.0
    assert (place.top() + (row + 0.5) * step, place.left() + (column + 0.5) * step) == (10 + 2 * 1234, 20 + 2 * 987)


def test_the_values_of_a_large_picture_are_saved_in_the_background(
    jobs: Jobs, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "LARGE", 100)
    view, threads = shown(qtbot, Picture(jobs=jobs)), set[threading.Thread]()
    written = np.savetxt

    def watched(*given: Any, **options: Any) -> None:
        threads.add(threading.current_thread())
        written(*given, **options)

    monkeypatch.setattr(np, "savetxt", watched)
    values = np.random.default_rng(5).random((130, 7), np.float32)
    view.set_shot(Shot(values))
    idle(jobs, qtbot)
    for name in ("a.npy", "a.csv", "nowhere/a.csv"):
        view.save_data(str(tmp_path / name))
    (tmp_path / "file").write_text("")
    view.save_data(str(tmp_path / "file" / "a.csv"))
    idle(jobs, qtbot)
    assert threads and threading.main_thread() not in threads
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), values)
    np.testing.assert_allclose(np.loadtxt(tmp_path / "a.csv", delimiter=","), values, rtol=1e-6)
    assert [job.title for job in jobs.jobs() if job.error] == ["Save a.csv"]


def test_fine_patterns_of_a_shrunk_picture_do_not_beat(qtbot: QtBot) -> None:
    """A pattern of alternate columns has one brightness where each pixel of the screen covers several of them."""
    view = shown(qtbot, Picture(legend=False, colour_map="gray"), (300, 300))
    for pixels in (300, 450, 611, 1400):
        stripes = np.tile(np.arange(pixels) % 2, (pixels, 1)).astype(np.float32)
        view.set_shot(Shot(stripes, levels=(0.0, 1.0)))
        view.show_part(-0.5, -0.5, pixels, pixels, padding=0)
        grey = screen(view.graphics)[150, 20:280, 0]
        if pixels > 300:
            # blocks of ten columns, in which the eye sees the beat
            assert np.ptp(grey.reshape(-1, 10).mean(1)) < 40, pixels
        else:
            assert set(grey) == {0, 255}, "pixels that are not shrunk stay sharp"


# -- what is drawn over it -----------------------------------------------------------------------------------


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


def test_overlays_and_captions_are_visible(qapp: QApplication, qtbot: QtBot) -> None:
    """White axes of a volume disappeared on bright voxels; in night, all captions are red."""
    view = shown(qtbot, Picture(legend=False))
    drawn = Outline(np.array([(2.0, 1.0), (2.0, 8.0)]), closed=False, rimmed=True), Label(np.array([(7.0, 5.0)]), "x")
    for overlay in drawn:
        view.set_shot(Shot(np.ones((10, 10)), levels=(0.0, 1.0), overlays=(overlay,)))
        view.set_display(DisplaySettings(colour_map="gray"))
        QApplication.processEvents()
        inside = view.graphics.mapFromScene(
            view.box.mapViewToScene(QRectF(0.5, 0.5, 8, 8)).boundingRect()
        ).boundingRect()
        seen = screen(view.graphics)[inside.top() : inside.bottom(), inside.left() : inside.right()]
        lightness = (seen.max(-1) + seen.min(-1)) / 2
        assert (lightness < 160).sum() > 20, overlay
    for theme, red in ((LIGHT, False), (NIGHT, True)):
        apply_theme(qapp, theme)
        view = shown(qtbot, Picture(legend=False))
        view.set_shot(Shot(np.zeros((20, 20)), "H, position y 3, x 4", pixel_um=5.5, cross=(3, 3)))
        QApplication.processEvents()
        seen = screen(view).reshape(-1, 3)
        bright = seen[seen.max(-1) > 150]
        assert len(bright) and ((bright[:, 2] < 0.7 * bright[:, 0]) == red).all()


def test_a_scale_bar_is_a_round_length() -> None:
    for pixel_um, pixels, words in ((5.5, 0.1, "50 µm"), (5.5, 10, "5 mm"), (0.2, 0.05, "1 µm")):
        length, text = scale_bar(pixel_um, pixels, 140)
        number, unit = text.split()
        assert text == words and 140 / 2.5 <= length <= 140
        assert length * pixels * pixel_um == pytest.approx(float(number) * {"µm": 1, "mm": 1e3}[unit])


def test_a_low_picture_has_no_scale_bar(qtbot: QtBot) -> None:
    view = Picture()
    qtbot.addWidget(view)
    for height, drawn in ((300, True), (90, False)):
        view.resize(300, height)
        view.show()
        seen = []
        for pixel_um in (None, 5.5):
            view.set_shot(Shot(np.ones((20, 20)), levels=(0.0, 2.0), pixel_um=pixel_um))
            seen.append(view.grab().toImage())
        assert (seen[0] != seen[1]) is drawn


def test_arrows_of_axes_are_on_their_side_named_and_do_not_take_the_mouse(qtbot: QtBot) -> None:
    parent = QWidget()
    qtbot.addWidget(parent)
    parent.resize(500, 300)
    parent.show()
    arrows = AxisArrows(parent)
    colour = STAGE.getRgb()[:3]
    ways = ((0.0, 1.0, "right"), (0.0, -1.0, "left"), (1.0, 0.0, "down"), (-1.0, 0.0, "up"))
    for name, (down, right, word) in product(("+x", "-y"), ways):
        arrows.set_arrows(((name, down, right),))
        seen = (screen(arrows) == colour).all(-1)
        rows, columns = np.nonzero(seen)
        assert len(rows) > 20
        assert (rows.mean() - MIDDLE.y()) * down + (columns.mean() - MIDDLE.x()) * right > 5, (name, word)
        assert not seen[:2].any() and not seen[-2:].any() and not seen[:, -4:].any() and not seen[:, :2].any()
        assert arrows.accessibleDescription() == f"stage {name} moves the image {word}"
    parent.resize(640, 300)
    qtbot.waitUntil(lambda: 600 < arrows.geometry().right() < 640)
    assert arrows.testAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)


# -- several pictures --------------------------------------------------------------------------------------


# -- several pictures ----------------------------------------------------------------------------------------
def test_linked_pictures_move_together(qtbot: QtBot) -> None:
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


def test_a_shared_contrast_applies_to_all_pictures(qtbot: QtBot) -> None:
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


# -- pointer, keys and menu --------------------------------------------------------------------------------


def place_of(view: Picture, row: float, column: float) -> QPoint:
    """Return where a pixel of a picture is in its graphics."""
    return view.graphics.mapFromScene(view.box.mapViewToScene(QPointF(column, row)))


def drag(view: Picture, *places: tuple[float, float]) -> None:
    port = view.graphics.viewport()
    QTest.mousePress(port, Qt.MouseButton.LeftButton, pos=place_of(view, *places[0]))
    for one in places[1:]:
        QTest.mouseMove(port, place_of(view, *one))
    QTest.mouseRelease(port, Qt.MouseButton.LeftButton, pos=place_of(view, *places[-1]))


def test_a_resting_pointer_reports_the_value_of_the_new_picture(view: Picture) -> None:
    reported: list[tuple[int, int, float]] = []
    view.set_shot(Shot(np.zeros((3, 3))))
    view.hovered.connect(lambda *found: reported.append(found))
    view._point_at(view.box.mapViewToScene(QPointF(1.0, 1.0)))
    view.set_shot(Shot(np.full((3, 3), 7.0)))
    assert reported == [(1, 1, 0.0), (1, 1, 7.0)]
    view.set_shot(None)
    assert reported[-1][0] == -1
    view.leaveEvent(QEvent(QEvent.Type.Leave))
    count = len(reported)
    view.set_shot(Shot(np.ones((3, 3))))
    assert len(reported) == count and math.isnan(reported[-1][2])


def test_a_steered_picture_reports_the_nearest_pixel_while_the_button_is_pressed(qtbot: QtBot) -> None:
    view = shown(qtbot, Picture(steered=True))
    view.set_shot(Shot(np.zeros((4, 6)), origin=(10.0, 0.0)))
    reported: list[tuple[int, int]] = []
    view.steered_to.connect(lambda *place: reported.append(place))
    drag(view, (11, 2), (12, 5), (12, 60))
    QTest.mouseMove(view.graphics.viewport(), place_of(view, 10, 0))
    assert reported[0] == (1, 2) and reported[-1] == (2, 5) and (0, 0) not in reported


def test_a_grip_is_dragged_by_whole_pixels_and_by_keys(view: Picture) -> None:
    view.set_shot(Shot(np.zeros((20, 20))))
    view.set_grip((8, 8, 4, 4))
    view.show_part(0, 0, 19, 19, padding=0)
    reported: list[tuple[int, int]] = []
    view.dragged.connect(lambda *way: reported.append(way))
    before = view.box.viewRect()
    drag(view, (9, 9), (9.4, 9.4), (12.2, 10.3), (9.1, 10.3))
    assert np.sum(reported, axis=0).tolist() == [0, 1] and view.box.viewRect() == before
    reported.clear()
    drag(view, (2, 2), (6, 6))
    assert not reported, "a drag that begins elsewhere moves the picture"
    for key in (Qt.Key.Key_Up, Qt.Key.Key_Right):
        QTest.keyClick(view, key)
    assert reported == [(-1, 0), (0, 1)]
    view.set_grip(None)
    QTest.keyClick(view, Qt.Key.Key_Up)
    assert len(reported) == 2


def test_the_menu_and_keys_copy_and_follow_what_is_shown(view: Picture) -> None:
    def titles() -> list[str]:
        return [text for text, _ in view.entries()]

    assert titles() == []
    view.set_shot(Shot(np.array([[1.5, 2.0], [3.0, 4.0]])))
    QTest.keyClick(view, Qt.Key.Key_C)
    assert QApplication.clipboard().text() == "1.5\t2\n3\t4"
    QTest.keyClick(view, Qt.Key.Key_C, Qt.KeyboardModifier.ControlModifier)
    assert not QApplication.clipboard().pixmap().isNull()
    first, last = "Contrast, profile, region …", "Save data …"
    assert titles() == [first, "Copy values", last]
    view.set_contrast((1.0, 2.0))
    assert titles() == [first, "Automatic contrast", "Copy values", last]
    dict(view.entries())["Automatic contrast"]()
    assert view.contrast is None and titles() == [first, "Copy values", last]
    view.set_shot(Shot(np.zeros((SIDE, SIDE), np.uint8)))
    assert titles() == [first, last], "a whole frame is too much for a spreadsheet"


# -- measurements ------------------------------------------------------------------------------------------
R, C = np.mgrid[:40, :60]
SPOT = (100 + 1000 * np.exp(-((R - 20) ** 2 + (C - 30) ** 2) / 32)).astype(np.float32)


def offered(widget: QWidget) -> dict[str, Any]:
    """Return the entries of the menu of a right click, by their text."""
    widget.customContextMenuRequested.emit(QPoint(5, 5))
    menu = widget.findChildren(QMenu)[-1]
    found = {action.text(): action for action in menu.actions()}
    menu.hide()
    return found


@pytest.mark.parametrize("size", ["small", "large"])
def test_levels_line_and_region_are_measured(qtbot: QtBot, jobs: Jobs, size: str) -> None:
    """Of small pictures, which are drawn at once, and of large ones, which are drawn in the background."""
    view = shown(qtbot, Picture(jobs=jobs))
    values = SPOT if size == "small" else np.pad(SPOT, ((0, 600), (0, LARGE // 600)), constant_values=100)
    view.set_shot(Shot(values, levels=(0.0, 2000.0)))
    idle(jobs, qtbot)
    window = view.measure()
    assert window.contrast.levels == (0.0, 2000.0), "the handles begin at the scale of the page"
    window.contrast.set_levels((200.0, 700.0))
    idle(jobs, qtbot)
    assert view.levels == (200.0, 700.0)
    assert view.item.image.max() == 255 and view.item.image.min() == 0, "values beyond the handles are cut off"
    view.set_shot(Shot(view.values + 1, levels=(0.0, 2000.0)))
    idle(jobs, qtbot)
    assert view.levels == (200.0, 700.0), "chosen levels stay with the next picture"
    offered(view)["Automatic contrast"].trigger()
    idle(jobs, qtbot)
    assert view.levels == (0.0, 2000.0) == window.contrast.levels
    assert "Automatic contrast" not in offered(view)
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
    assert len(view.box.addedItems) == before - 2, "line and rectangle are removed with their window"
    idle(jobs, qtbot)


def test_a_picture_in_other_units_is_measured_in_its_pixels(view: Picture) -> None:
    view.set_shot(Shot(SPOT, origin=(-20.0, -30.0)))
    window = view.measure()
    window.region.setPos((-2.5, -2.5))
    window.region.setSize((5, 5))
    window.measure()
    assert "centroid row 20.00, column 30.00" in window.region_words.text()
    view.set_shot(None)
    window.measure()
    assert window.profile_words.text() == "no image"


def test_every_picture_and_plot_is_copied_and_saved(view: Picture, qtbot: QtBot, tmp_path: Path) -> None:
    view.set_shot(Shot(SPOT))
    plot = shown(qtbot, LinePlot("x (px)", "y (counts)"))
    plot.set_curve("line", [1, 2, 3], [4, 5, 7])
    for widget in (view, plot):
        assert {"Copy image", "Save image …", "Save data …", "Show all"} <= set(offered(widget))
    offered(plot)["Copy values"].trigger()
    assert QApplication.clipboard().text().splitlines()[1:] == ["1\t4", "2\t5", "3\t7"]
    offered(plot)["Copy image"].trigger()
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
