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
from lfcal_gui.models import ProjectState
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
    page: Any = window.page("setup")
    window.go("setup")
    form = page.panel.inspector.values
    keys = [key for key in form.fields if not form.editor(key).isHidden()]

    def asks() -> bool:
        parts = (page.panel, *page.panel.segments, page.panel.overlay)
        assert page.hint.text() == "", "no plan yet"
        return page.empty is not None and page.empty.isVisible() and not any(one.isVisible() for one in parts)

    assert asks() and page.empty.title.text() == "Which camera is it?"
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
    window.jobs.cancel_all()


def test_the_form_shows_and_takes_every_preset(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    form, presets = page.panel.inspector.values, page.panel.inspector.presets
    for name in PRESETS:
        camera = preset(name)
        presets.setCurrentIndex(presets.findData(name))
        presets.activated.emit(presets.currentIndex())
        assert context.state.camera == camera
        lens = isinstance(camera.optics, MainLens)
        assert form.editor("optics.f_number").isHidden() == (not lens)
        assert form.editor("optics.magnification").isHidden() == lens
        if camera.has_lattice:
            assert form.editor("lattice.pitch_um").text() == f"{camera.lattice.pitch_um:.10g}"
        else:
            assert form.editor("lattice.pitch_um").isHidden()
            assert form.editor("lattice.lens_centres_um").text().startswith("0, 0; 2500, 0")
        assert "px" in page.panel.facts.text() and not page.panel.optics.grab().isNull()


def test_another_camera_says_that_the_plan_went_with_the_old_one(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    context.project.update("plan", plan=ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,)))
    before = context.state
    page._set(preset("lfm_20x05"), "preset lfm_20x05")
    assert context.state.plan is None
    assert page.notice.isVisible() and "plan" in page.notice.label.text() and page.notice.button.text() == "Undo"
    page.notice.button.click()
    assert context.state == before
    page._set(preset("lfm_20x05"), "preset lfm_20x05")
    context.project.update("name", name="other")
    page.notice.button.click()
    assert context.state.name == "other" and "step by step" in page.notice.label.text()


def test_typing_states_and_confirming_keeps_the_plan(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    marks = dict.fromkeys(("lattice.types", "sensor.shape", "optics.f_number"), "assumed")
    camera = replace(preset("bench"), marks=Marks.of(marks))
    context.project.update("made", camera=camera, plan=ScanPlan.for_camera(camera, virtual_depths=(3.0,)))
    confirm(page, "optics.f_number")
    plan = context.project.state.plan
    assert plan.camera.marks["optics.f_number"] == "stated"
    QTest.keyClicks(page.panel.inspector.values.editor("sensor.rows"), "0")
    assert context.project.state.camera.marks.paths("assumed") == ("lattice.types",)
    assert mark(page, "sensor.columns") == "stated"


def with_white(page: Any, folder: Path, qtbot: QtBot, frame: np.ndarray, pitch: float = 16.0) -> Camera:
    """Describe a camera with square lenslets of a pitch (px), and check it against a white image; return it."""
    rows, columns = frame.shape
    lattice = LensletLattice("square", pitch * 5, 400.0, (LensType(400.0),))
    camera = Camera("c", MainLens(), lattice, Sensor((rows, columns), 5.0))
    page.context.project.update("made", camera=camera)
    tifffile.imwrite(folder / "white.tif", frame)
    page.check_white(str(folder / "white.tif"))
    idle(page.context.jobs, qtbot)
    return camera


def test_camera_files(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page, before = open_page("setup"), context.state
    page.save_file(str(tmp_path / "c.json"))
    assert Camera.from_json((tmp_path / "c.json").read_text()) == before.camera
    (tmp_path / "bad.json").write_text("{}")
    page.import_file(str(tmp_path / "bad.json"))
    idle(context.jobs, qtbot)
    assert "camera description" in page.notice.label.text() and page.notice.isVisibleTo(page)
    assert context.state == before


def test_assumed_values_are_confirmed(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
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


def test_check_against_a_white_image(open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")
    white = draw_white((220, 260), pitch=16.0, kind="square", rotation=0.004).frame
    camera = with_white(page, tmp_path, qtbot, white, 16.1)
    panel, inspector = page.check, page.panel.inspector
    verdicts = {panel.table.item(k, 0).text(): panel.table.item(k, 1).text() for k in range(panel.table.rowCount())}
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
    with_white(page, tmp_path, qtbot, np.full((220, 260), 7, np.uint16))
    assert page.notice.isVisibleTo(page) and inspector.check_card.isHidden()


def test_a_bent_lattice_and_its_residuals_are_drawn(open_page: OpenPage, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")
    reach = float(np.hypot(240, 320))
    bend = barrel(2.0, reach)
    with_white(
        page, tmp_path, qtbot, draw_white((480, 640), pitch=16.0, kind="square", rotation=0.004, bend=bend).frame
    )
    view, inspector = page.check, page.panel.inspector
    assert "radial" in view.about.text() and "px rms" in view.about.text()
    view.choice.setCurrentIndex(view.choice.findData("distortion"))
    # the fit may give part of a barrel to pitch and origin; what bends grows outwards from the middle
    shown = view.map.values
    assert shown.shape == (18, 24) and shown[0, 0] > 1.0 > 10 * shown[9, 12]
    lines = np.stack([line.points for line in view.map.overlays])  # the shaft and both barbs of each arrow
    tails, tips = lines[::3, 0, ::-1].T, lines[::3, 1, ::-1].T
    middle = np.array([[319.5], [239.5]])
    outward = ((tips - tails) * (tails - middle)).sum(0)
    assert np.all(outward[np.hypot(*(tails - middle)) > reach / 2] > 0), "they point to where micro-images are seen"
    assert "arrows magnified" in view.legend.text() and "px" in view.legend.text()
    view.choice.setCurrentIndex(view.choice.findData("residuals"))
    assert float(np.nanmax(view.map.values)) < 0.3
    inspector.buttons["take"].click()
    assert page.context.project.state.camera.lattice.distortion is not None
    assert mark(page, "lattice.distortion") == "measured"
    assert inspector.values.editor("lattice.distortion").text().startswith("radial, ")


def test_a_specimen_is_refused_in_one_line(open_page: OpenPage, qtbot: QtBot, tmp_path: Path) -> None:
    page = open_page("setup")

    def cells(x: Any, y: Any) -> Any:
        return 0.15 + np.cos(6 * x + 1) ** 2 * np.cos(5 * y) ** 2

    camera = with_white(page, tmp_path, qtbot, draw_white((300, 400), pitch=16.0, kind="square", light=cells).frame)
    said = page.notice.label.text()
    assert page.notice.isVisibleTo(page) and "evenly lit image" in said and "\n" not in said
    assert page.context.state.camera == camera and page.panel.inspector.check_card.isHidden()
    with_white(page, tmp_path, qtbot, draw_white((300, 400), pitch=16.0, kind="square").frame)
    assert not page.notice.isVisibleTo(page) and not page.panel.inspector.buttons["details"].isHidden()


def test_typing_is_one_step_and_keeps_the_plan_if_possible(open_page: OpenPage, context: Context) -> None:
    page = open_page("setup")
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(3.0,), exposure_s=0.003, frames_averaged=4)
    context.project.update("made", plan=plan)

    def typed(key: str, *texts: str) -> str:
        editor = page.panel.inspector.values.editor(key)
        for text in texts:
            editor.setText(text)
            editor.textEdited.emit(text)
        return page.notice.label.text() if page.notice.isVisibleTo(page) else ""

    assert typed("optics.working_distance_um", "3", "31", "310", "310.") == ""
    state = context.state
    assert state.camera.optics.working_distance_um == 310e3
    assert (state.plan.depths_um, state.plan.frames_averaged) == (plan.depths_um, 4)
    assert state.plan.camera == state.camera
    context.project.undo()
    assert context.state.plan == plan and context.state.camera == preset("bench")
    assert "Undo restores it" in typed("sensor.rows", "20") and context.state.plan is None
    context.project.undo()
    assert context.state.plan == plan


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
