from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QFileDialog, QPushButton
from pytestqt.qtbot import QtBot

from lfcal.camera import (
    PRESETS,
    Camera,
    LensletLattice,
    LensType,
    MainLens,
    Marks,
    ScanPlan,
    Sensor,
    import_camera,
    preset,
)
from lfcal_gui.context import Context
from lfcal_gui.models.project import Hold, ProjectState
from lfcal_gui.pages.setup._check_dialog import OFF_BY, SIZE
from lfcal_gui.window import MainWindow
from tests.camera.importers.files import OLAF
from tests.camera.importers.test_raytrix_xml import xml
from tests.gui.conftest import OpenPage
from tests.gui.waiting import idle
from tests.lattice.white_frames import barrel, draw_white


def mark(page: Any, key: str) -> str:
    found: str = page.panel.inspector.values.mark(key).property("mark")
    return found


def confirm(page: Any, key: str) -> None:
    """Click the word beside a field."""
    page.panel.inspector.values.mark(key).click()


def choice(page: Any, text: str) -> QPushButton:
    """Return a button of the question that an empty project begins with."""
    found: QPushButton = next(one for one in page.empty.findChildren(QPushButton) if one.text() == text)
    return found


def test_an_empty_project_asks_which_camera_it_is(window: MainWindow, monkeypatch: pytest.MonkeyPatch) -> None:
    """It showed lattice and values of a camera that was never described."""
    page: Any = window.page("setup")
    window.go("setup")
    form = page.panel.inspector.values
    keys = [key for key in form.fields if not form.editor(key).isHidden()]

    def asks() -> bool:
        parts = (page.panel, *page.panel.segments, page.panel.overlay)
        assert page.hint.text() == "", "no plan yet"
        return page.empty is not None and page.empty.isVisible() and not any(one.isVisible() for one in parts)

    assert asks() and page.empty.label.text().startswith("Which camera is it?")
    choices = {one.text(): one.text() for one in choice(page, "Choose a preset").menu().actions()}
    assert list(choices) == list(PRESETS)
    choice(page, "Choose a preset").menu().actions()[list(PRESETS).index("bench")].trigger()
    assert not asks() and page.panel.isVisible() and form.head.words == "all known"
    assert {mark(page, key) for key in keys} <= {"stated", "derived"}
    window.project.undo()
    assert asks()
    choice(page, "Describe the camera").click()
    assert not asks() and {mark(page, key) for key in keys} == {"assumed"}
    page._edited("optics.f_number", 5.6)
    assert mark(page, "optics.f_number") == "stated"
    window.project.start(ProjectState())
    assert asks()
    page.make_default()
    assert page.panel.isVisible() and page.hint.text() == page.spec.hint
    window.project.start(ProjectState())
    named: list[str] = []
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (named.append("asked") or "", ""))
    choice(page, "Import a camera file …").click()
    choice(page, "Open the sample").click()
    assert named and [job.kind for job in window.jobs.jobs()] == ["sample"]


@pytest.mark.parametrize("name", PRESETS)
def test_camera_shows_and_takes_presets(window: MainWindow, name: str) -> None:
    page: Any = window.page("setup")
    page.panel.inspector.presets.setCurrentIndex(page.panel.inspector.presets.findData(name))
    page.panel.inspector.presets.activated.emit(page.panel.inspector.presets.currentIndex())
    assert window.project.state.camera == preset(name)
    lens = isinstance(preset(name).optics, MainLens)
    form = page.panel.inspector.values
    assert form.editor("optics.f_number").isHidden() == (not lens)
    assert form.editor("optics.magnification").isHidden() == lens
    if preset(name).has_lattice:
        assert form.editor("lattice.pitch_um").text() == f"{preset(name).lattice.pitch_um:.10g}"
    else:
        assert form.editor("lattice.pitch_um").isHidden()
        assert form.editor("lattice.lens_centres_um").text().startswith("0, 0; 2500, 0")
    assert "px" in page.panel.facts.text()
    assert not page.panel.optics.grab().isNull()


def test_another_camera_says_that_the_plan_went_with_the_old_one(window: MainWindow) -> None:
    """A preset dropped planes, cutout and exposures without a word."""
    page: Any = window.page("setup")
    window.go("setup")
    window.project.update("plan", plan=ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,)))
    before = window.project.state
    page._set(preset("lfm_20x05"), "preset lfm_20x05")
    assert window.project.state.plan is None
    assert page.notice.isVisible() and "plan" in page.notice.label.text() and page.notice.button.text() == "Undo"
    page.notice.button.click()
    assert window.project.state == before
    page._set(preset("lfm_20x05"), "preset lfm_20x05")
    window.project.update("name", name="other")
    page.notice.button.click()
    assert window.project.state.name == "other" and "step by step" in page.notice.label.text()


def test_camera_files(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    page: Any = window.page("setup")
    page.save_file(str(tmp_path / "c.json"))
    assert Camera.from_json((tmp_path / "c.json").read_text()) == window.project.state.camera
    (tmp_path / "bad.json").write_text("{}")
    before = window.project.state
    page.import_file(str(tmp_path / "bad.json"))
    idle(window.jobs, qtbot)
    assert "camera description" in page.notice.label.text() and page.notice.isVisibleTo(page)
    assert window.project.state == before and "camera description" in window.log_view.toPlainText()


def test_a_maker_s_file_shows_what_is_assumed_and_confirming_states_it(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    page = open_page("setup")
    (tmp_path / "c.xml").write_text(xml())
    page.import_file(str(tmp_path / "c.xml"))
    idle(context.jobs, qtbot)
    camera = context.project.state.camera
    assert camera == import_camera(tmp_path / "c.xml").camera
    inspector = page.panel.inspector
    assert mark(page, "sensor.pixel_um") == "assumed" and mark(page, "lattice.pitch_um") == "derived"
    assert inspector.values.editor("sensor.pixel_um").accessibleDescription()
    assert inspector.values.head.isChecked() and "assumed" in inspector.values.head.words
    assert "not applied" in page.notice.label.text() and "≈" in page.panel.facts.text()
    confirm(page, "sensor.pixel_um")
    assert context.project.state.camera.marks["sensor.pixel_um"] == "stated"
    assert mark(page, "sensor.pixel_um") == "stated"
    context.project.undo()
    assert mark(page, "sensor.pixel_um") == "assumed"
    inspector.buttons["confirm"].click()
    assert context.project.state.camera.marks.paths("assumed") == ()
    assert "assumed" not in inspector.values.head.words and "≈" not in page.panel.facts.text()
    assert context.project.unsaved and not inspector.buttons["confirm"].isEnabled()


def test_confirming_keeps_the_plan(open_page: OpenPage, context: Context, qtbot: QtBot) -> None:
    page = open_page("setup")
    camera = replace(preset("bench"), marks=Marks.of({"optics.f_number": "assumed"}))
    context.project.update("made", camera=camera, plan=ScanPlan.for_camera(camera, virtual_depths=(3.0,)))
    confirm(page, "optics.f_number")
    plan = context.project.state.plan
    assert plan is not None and plan.camera.marks["optics.f_number"] == "stated"


def test_typing_states_a_value(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    camera = replace(preset("bench"), marks=Marks.of({"lattice.types": "assumed", "sensor.shape": "assumed"}))
    context.project.update("made", camera=camera)
    QTest.keyClicks(page.panel.inspector.values.editor("sensor.rows"), "0")
    assert context.project.state.camera.marks.paths("assumed") == ("lattice.types",)
    assert mark(page, "sensor.columns") == "stated"


def test_check_against_a_white_image(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")
    white = draw_white((220, 260), pitch=16.0, kind="square", rotation=0.004)
    tifffile.imwrite(tmp_path / "white.tif", white.frame)
    lattice = LensletLattice("square", 16.1 * 5, 400.0, (LensType(400.0),))
    camera = Camera("c", MainLens(), lattice, Sensor((220, 260), 5.0))
    context.project.update("made", camera=camera)
    page.check_white(str(tmp_path / "white.tif"))
    idle(context.jobs, qtbot)
    panel, inspector = page.check, page.panel.inspector
    verdicts = {
        panel.table.item(row, 0).text(): panel.table.item(row, 1).text() for row in range(panel.table.rowCount())
    }
    assert verdicts["Pitch"] == "differs" and verdicts["Sensor"] == "fits"
    for width in (SIZE[0], 1300):
        panel.resize(width, SIZE[1])
        panel.show()
        qtbot.waitUntil(lambda: panel.table.horizontalHeader().length() <= panel.table.viewport().width())
        assert panel.table.isColumnHidden(OFF_BY) == (width == SIZE[0])
    assert all(len(marks.points) > 100 for marks in panel.image.overlays)
    inspector.buttons["take"].click()
    measured = context.project.state.camera
    assert measured.pitch_px == pytest.approx(16.0, abs=0.01) and measured.marks["lattice.pitch_um"] == "measured"
    assert inspector.buttons["take"].isHidden()
    context.project.update("made", camera=camera)
    assert "changed since" in inspector.check_card.sentence.text() and inspector.buttons["details"].isHidden()
    tifffile.imwrite(tmp_path / "flat.tif", np.full((220, 260), 7, np.uint16))
    page.check_white(str(tmp_path / "flat.tif"))
    idle(context.jobs, qtbot)
    assert page.notice.isVisibleTo(page) and inspector.check_card.isHidden()


def test_a_bent_lattice_and_its_residuals_are_drawn(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    page = open_page("setup")
    reach = float(np.hypot(240, 320))
    white = draw_white((480, 640), pitch=16.0, kind="square", rotation=0.004, bend=barrel(2.0, reach))
    tifffile.imwrite(tmp_path / "white.tif", white.frame)
    lattice = LensletLattice("square", 16.0 * 5, 400.0, (LensType(400.0),))
    context.project.update("made", camera=Camera("c", MainLens(), lattice, Sensor((480, 640), 5.0)))
    page.check_white(str(tmp_path / "white.tif"))
    idle(context.jobs, qtbot)
    panel, inspector = page.check, page.panel.inspector
    assert "radial" in panel.about.text() and "px rms" in panel.about.text()
    view = panel
    view.choice.setCurrentIndex(view.choice.findData("distortion"))
    # the fit may give part of a barrel to pitch and origin; what bends grows outwards from the middle
    shown = view.map.values
    assert shown.shape == (18, 24) and shown[0, 0] > 1.0 > 10 * shown[9, 12]
    lines = np.stack([line.points for line in view.map.overlays])  # the shaft and both barbs of each arrow
    tails, tips = lines[::3, 0, ::-1].T, lines[::3, 1, ::-1].T
    middle = np.array([[319.5], [239.5]])
    outward = ((tips - tails) * (tails - middle)).sum(0)
    far = np.hypot(*(tails - middle)) > reach / 2
    assert np.all(outward[far] > 0), "arrows point to where micro-images are seen"
    assert "arrows magnified" in view.legend.text() and "px" in view.legend.text()
    view.choice.setCurrentIndex(view.choice.findData("residuals"))
    assert float(np.nanmax(view.map.values)) < 0.3
    inspector.buttons["take"].click()
    taken = context.project.state.camera
    form = inspector.values
    assert taken.lattice.distortion is not None and mark(page, "lattice.distortion") == "measured"
    assert form.editor("lattice.distortion").text().startswith("radial, ")


def test_a_specimen_is_refused_in_one_line(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")

    def cells(x: Any, y: Any) -> Any:
        return 0.15 + np.cos(6 * x + 1) ** 2 * np.cos(5 * y) ** 2

    white = draw_white((300, 400), pitch=16.0, kind="square", light=cells)
    tifffile.imwrite(tmp_path / "cells.tif", white.frame)
    lattice = LensletLattice("square", 16.0 * 5, 400.0, (LensType(400.0),))
    context.project.update("made", camera=Camera("c", MainLens(), lattice, Sensor((300, 400), 5.0)))
    before = context.state
    page.check_white(str(tmp_path / "cells.tif"))
    idle(context.jobs, qtbot)
    said = page.notice.label.text()
    assert page.notice.isVisibleTo(page) and "evenly lit image" in said and "\n" not in said
    assert context.state == before and page.panel.inspector.check_card.isHidden()
    tifffile.imwrite(tmp_path / "white.tif", draw_white((300, 400), pitch=16.0, kind="square").frame)
    page.check_white(str(tmp_path / "white.tif"))
    idle(context.jobs, qtbot)
    assert not page.notice.isVisibleTo(page) and not page.panel.inspector.buttons["details"].isHidden()


def test_dropped_files(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    page: Any = window.page("setup")
    (tmp_path / "c.json").write_text(preset("r29").to_json())
    (tmp_path / "o.yaml").write_text(OLAF)
    window.go("setup")
    window.take_files([str(tmp_path / "c.json")])
    idle(window.jobs, qtbot)
    assert window.project.state.camera == preset("r29")
    window.go("frames")
    assert not page.accept_drop([str(tmp_path / "c.json")])
    window.take_files([str(tmp_path / "o.yaml")])
    idle(window.jobs, qtbot)
    assert window.project.state.camera.name == "o"


def test_typing_a_number_is_one_step_and_keeps_the_plan(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,), exposure_s=0.003, frames_averaged=4)
    context.project.update("made", plan=plan)
    editor = page.panel.inspector.values.editor("optics.working_distance_um")
    said: list[str] = []
    for text in ("3", "31", "310", "310."):
        editor.setText(text)
        editor.textEdited.emit(text)
        said.append(page.notice.label.text() if page.notice.isVisibleTo(page) else "")
    state = context.state
    assert state.camera.optics.working_distance_um == 310e3
    assert state.plan is not None and (state.plan.depths_um, state.plan.frames_averaged) == (plan.depths_um, 4)
    assert state.plan.camera == state.camera and said[-1] == ""
    context.project.undo()
    assert context.state.plan == plan and context.state.camera == preset("bench")


def test_a_camera_that_cannot_scan_the_plan_says_that_it_is_let_go(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,))
    context.project.update("made", plan=plan)
    editor = page.panel.inspector.values.editor("sensor.rows")
    editor.setText("20")
    editor.textEdited.emit("20")
    assert context.state.plan is None and "Undo restores it" in page.notice.label.text()
    context.project.undo()
    assert context.state.plan == plan


def test_nothing_of_the_camera_changes_while_it_records(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    context.project.update("made", plan=ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,)))
    before = context.state
    context.project.hold(Hold("a session is being recorded", ("camera", "plan")))
    for key, form in (("optics.f_number", page.panel.inspector.values), ("cutout", page.panel.inspector.scan)):
        form.editor(key).setText("5")
        form.editor(key).textEdited.emit("5")
        assert form.error == "a session is being recorded"
    context.project.undo()
    assert context.state == before
