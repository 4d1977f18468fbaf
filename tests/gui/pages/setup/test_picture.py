"""The picture of Set up: what is drawn lies where frames will have it; the drawing of the optics."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PySide6.QtCore import QRectF
from PySide6.QtGui import QImage, QPainter
from pytestqt.qtbot import QtBot

from lfcal.camera import PRESETS, Camera, LensletLattice, LensType, MainLens, ScanPlan, Sensor, preset
from lfcal_gui.context import Context
from lfcal_gui.models import lattice_points, with_described
from lfcal_gui.pages.setup._optics_view import OpticsView
from lfcal_gui.pages.setup.model_picture import DARK, LIT, ScanCosts, ScanScene, numbers_of
from lfcal_gui.pages.setup.model_scan import default_plan, scan_path
from lfcal_gui.pages.setup.model_target import PlanSettings
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle
from tests.lattice.white_frames import draw_white


def scene_of(name: str) -> ScanScene:
    return ScanScene(preset(name), default_plan(preset(name)))


def test_every_cutout_of_the_scan_is_within_the_dashed_border() -> None:
    for name in PRESETS:
        scene = scene_of(name)
        plan = scene.plan
        assert plan is not None and scene.cutout is not None and scene.counted is not None
        points, size = scan_path(plan), np.array(plan.cutout)
        first, last = (at(axis=0) - (size - 1) // 2 for at in (points.min, points.max))
        row, column, height, width = scene.counted
        assert tuple(first) == (row, column) and tuple(last + size) == (row + height, column + width), name
        middle = scene.cutout
        assert row <= middle[0] and middle[0] + middle[2] <= row + height, name


def test_lenslets_are_bright_at_their_centres_and_dark_between() -> None:
    for camera in (preset(name) for name in PRESETS if preset(name).has_lattice):
        view = (100.0, 120.0, 6 * camera.pitch_px, 8 * camera.pitch_px)
        shot = ScanScene(camera).shot(view)
        centres, _ = lattice_points(camera, (view[0], view[0] + view[2]), (view[1], view[1] + view[3]))
        seen = [pixel for centre in centres if (pixel := shot.pixel_at(*centre)) is not None]
        assert len(seen) > 20 and all(shot.value_at(pixel) == pytest.approx(LIT, abs=0.01) for pixel in seen)
        gaps = not camera.lattice.gapless and camera.lattice.kind != "square"
        assert (shot.values.min() == pytest.approx(DARK)) == gaps, camera.name
    lattice = replace(preset("bench").lattice, clear_um=1e-30)
    points = ScanScene(replace(preset("bench"), lattice=lattice)).shot((100.0, 120.0, 80.0, 90.0))
    assert points.values is not None and np.isfinite(points.values).all(), "apertures of a point"


def test_words_of_the_optics_are_whole_and_do_not_meet(qtbot: QtBot) -> None:
    for name in PRESETS:
        view = OpticsView()
        qtbot.addWidget(view)
        view.set_camera(preset(name))
        view.resize(view.minimumSize())
        image = QImage(view.size(), QImage.Format.Format_RGB32)
        painter = Listening(image)
        view._draw_camera(painter, QRectF(8, 8, view.width() * 0.58 - 24, view.height() - 16))
        painter.end()
        assert painter.texts
        for k, (rect, text) in enumerate(painter.texts):
            assert rect.left() >= 0 and rect.top() >= 0 and rect.right() <= view.width(), text
            assert not [other for at, other in painter.texts[:k] if at.intersects(rect) and text and other], text


def test_single_lenslets_are_drawn_at_their_places_on_the_sensor() -> None:
    camera = preset("flfm_20x05")
    scene = ScanScene(camera)
    shot = scene.shot(scene.area())
    assert shot.values.min() == pytest.approx(DARK)
    rows, columns = camera.sensor.shape
    centres, _ = lattice_points(camera, (0.0, float(rows)), (0.0, float(columns)))
    assert len(centres) == 7
    for centre in centres:
        assert shot.value_at(shot.pixel_at(*centre)) == pytest.approx(LIT, abs=0.01)
    shot = ScanScene(preset("bench")).shot((-10.0, -20.0, 40.0, 60.0))
    assert shot.values is not None and np.isfinite(shot.values).all()
    assert all(-0.5 <= first < -0.5 + shot.step for first in shot.origin)
    far = ScanScene(preset("bench")).shot((-100.0, -200.0, 40.0, 60.0)).values
    assert far.shape == (1, 1)


def test_numbers_say_time_disk_and_lattice() -> None:
    costs = ScanCosts.of(default_plan(preset("bench")), PlanSettings(), None, None)
    time, disk, noise, lattice = numbers_of(costs, None)
    assert (time.value, time.unit, time.words) == ("4", "min 19 s", "2,508 positions")
    assert (disk.value, disk.unit, disk.words) == ("513.6", "MB", "frames; H 45.0 MB")
    assert (noise.value, noise.unit, noise.words) == ("…", "noise of H", "computing")
    assert (lattice.value, lattice.unit) == ("0.05", "px")
    assert numbers_of(None, None) == ()


def test_several_changes_are_drawn_once_in_a_later_turn(
    open_page: OpenPage, context: Context, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The picture was drawn three times for a first plan, twice in vain."""
    page, plan, drawn = open_page("setup"), default_plan(preset("bench")), list[int]()
    context.project.update("made", plan=plan)
    idle(context.jobs, qtbot)
    show = page.panel.picture.set_overlays
    monkeypatch.setattr(page.panel.picture, "set_overlays", lambda *marks: (drawn.append(len(marks)), show(*marks)))
    for k in range(3):
        context.project.update("moved", plan=replace(plan, anchor=(plan.anchor[0] + k + 1, plan.anchor[1])))
    page.resize(page.width() + 200, page.height())
    assert not drawn
    idle(context.jobs, qtbot)
    assert len(drawn) == 1
    page.panel.overlays["Cutout"].setChecked(False)
    assert len(drawn) == 2 and drawn[1] < drawn[0], "what the user chooses is drawn at once"


def test_dragging_the_cutout_moves_the_scan_as_one_step(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    plan = default_plan(preset("bench"))
    context.project.update("made", plan=plan)
    seen, rows = page.panel.picture.box.viewRect(), page.panel.forecast.text()
    for _ in range(3):
        page.panel.picture.dragged.emit(2, -1)
    moved = context.state.plan
    assert moved == replace(plan, anchor=(plan.anchor[0] + 6, plan.anchor[1] - 3))
    assert page.panel.inspector.scan.editor("anchor").text() == "156, 141"
    assert page.panel.picture.box.viewRect() == seen and page.panel.forecast.text() == rows
    page.panel.picture.dragged.emit(400, 0)
    assert context.state.plan == moved, "the scan stays on the sensor"
    context.project.undo()
    assert context.state.plan == plan


def test_the_strip_draws_the_aperture_of_a_plane(open_page: OpenPage, context: Context, qtbot: QtBot) -> None:
    page = open_page("setup")
    plan = default_plan(preset("bench"))
    context.project.update("made", plan=plan)
    idle(context.jobs, qtbot)
    strip, picture = page.panel.strip, page.panel.picture
    assert strip.count() == 4 and strip.currentRow() == 3

    def diameter() -> float:
        return float(np.ptp(picture.overlays[-1].points[:, 0]))

    large = diameter()
    middle = picture.overlays[-1].points.mean(axis=0)
    assert middle == pytest.approx((plan.anchor[0] + 9, plan.anchor[1] + 16), abs=0.5), "about the middle of the scan"
    strip.setCurrentRow(0)
    assert diameter() < large / 3
    context.project.update("moved", plan=replace(plan, anchor=(140.0, 144.0)))
    assert strip.currentRow() == 0
    page.panel.overlays["Cutout"].setChecked(False)
    assert not [one for one in picture.overlays if getattr(one, "dashed", False)]


def test_a_white_image_becomes_the_picture(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")
    lattice = LensletLattice("square", 16.0 * 5, 400.0, (LensType(400.0),))
    context.project.update("made", camera=Camera("c", MainLens(), lattice, Sensor((220, 260), 5.0)))
    # the place of a part of the sensor is not known
    for shape, caption in (((220, 260), "White image white.tif"), ((120, 160), "Lattice as described")):
        tifffile.imwrite(tmp_path / "white.tif", draw_white(shape, pitch=16.0, kind="square").frame)
        page.check_white(str(tmp_path / "white.tif"))
        idle(context.jobs, qtbot)
        assert page.panel.picture.shot.caption == caption
        assert page.panel.picture.values.shape == (220, 260) or shape == (120, 160)
    shown: Any = page.panel.inspector
    assert "220 × 260" in shown.check_card.sentence.text() and shown.check_card.property("merit") == "bad"


def test_dropped_plans_are_opened(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")
    plan = ScanPlan.for_camera(preset("r29"), virtual_depths=(3.0,))
    for name, text in (("plan", plan.to_json()), ("camera", preset("lfm_20x05").to_json())):
        (tmp_path / f"{name}.json").write_text(text)
    page.hide()
    assert not page.accept_drop([str(tmp_path / "camera.json")])
    assert page.accept_drop([str(tmp_path / "plan.json")])
    idle(context.jobs, qtbot)
    assert context.state.plan == plan
    page.show()
    assert page.accept_drop([str(tmp_path / "camera.json")])
    idle(context.jobs, qtbot)
    assert context.state.camera == preset("lfm_20x05") and context.state.plan is None


def test_a_dropped_white_image_is_compared_with_the_camera(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    page, path = open_page("setup"), str(tmp_path / "white.tif")
    tifffile.imwrite(path, draw_white((120, 160), pitch=16.0, kind="square").frame)
    assert page.accept_drop([path]) and "Choose the camera" in page.notice.label.text()
    context.project.update("camera", camera=preset("lfm_20x05"), settings=with_described(context.state))
    assert page.accept_drop([path])
    idle(context.jobs, qtbot)
    assert page.check.windowTitle() and page._checked.name == "white.tif"
    page.hide()
    assert not page.accept_drop([path]), "another place may show it"
    page.show()
    assert not page.accept_drop([str(tmp_path)]), "a folder is of frames"


class Listening(QPainter):
    """A painter that remembers where texts went."""

    def __init__(self, image: QImage) -> None:
        super().__init__(image)
        self.texts: list[tuple[QRectF, str]] = []

    def drawText(self, *args: Any) -> None:
        if isinstance(args[0], QRectF):
            self.texts.append((args[0], args[-1]))
