"""The scene editor as a person uses it: magnitudes, their influence, files of them, frames."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLineEdit
from pytestqt.qtbot import QtBot

from lfcal.base import StorageError
from lfcal.camera import Marks
from lfcal.frames import open_frames
from lfcal.psf import open_psf
from lfcal.simulate.effects import Coma
from lfcal.simulate.sensor import session
from lfcal.tasks import simulate
from lfcal_gui.context import Context
from lfcal_gui.jobs import JobState
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.simulate.model import SimulateSettings
from tests.gui.conftest import OpenPage
from tests.gui.pages.simulate.test_model import small_plan
from tests.gui.waiting import GUARD_MS, idle

RAYS = SimulateSettings(0.3, "geometric")


@pytest.fixture
def state() -> ProjectState:
    plan = small_plan()
    plan = replace(plan, depths_um=plan.depths_um[:1], exposure_s=plan.exposures[0])
    return ProjectState(camera=plan.camera, plan=plan, settings={"simulate": RAYS.to_dict()})


@pytest.fixture
def page(open_page: OpenPage, context: Context, qtbot: QtBot) -> Any:
    made = open_page("simulate", 640)
    idle(context.jobs, qtbot)
    return made


def given(page: Any) -> SimulateSettings:
    return SimulateSettings.of(page.context.state)


def choose(page: Any, name: str, qtbot: QtBot) -> dict[str, Any]:
    """Select an effect; return its editors by field."""
    page.panel.table.select(name)
    idle(page.context.jobs, qtbot)
    editors: dict[str, Any] = page.panel.effect.form.editors
    return editors


def type_into(edit: QLineEdit, text: str, qtbot: QtBot) -> None:
    edit.setFocus()
    edit.selectAll()
    qtbot.keyClicks(edit, text)
    qtbot.keyClick(edit, Qt.Key.Key_Return)


def test_coma_of_0_3_waves_at_40_degrees(page: Any, qtbot: QtBot, tmp_path: Path) -> None:
    context, table = page.context, page.panel.table
    editors = choose(page, "coma", qtbot)
    assert not page.verdict.row("coma").on and table._items["coma"].parent() is table.groups["unknown"]
    assert editors["waves"].source.currentText() == "typical" and editors["waves"].edit.text() == "0.25"
    type_into(editors["waves"].edit, "0.3", qtbot)
    type_into(editors["angle_rad"].edit, "40", qtbot)
    idle(context.jobs, qtbot)
    assert given(page).effects() == (Coma(0.3, math.radians(40)),)
    row = page.verdict.row("coma")
    assert row.on and row.verdict_text().startswith("on: 0.3 waves")
    assert table._items["coma"].parent() is table.groups["on"] and table.selected == "coma"
    assert row.verdict_text() in table._items["coma"].toolTip(0)
    assert editors["waves"].source.currentData() == "stated" and editors["angle_rad"].edit.text() == "40"
    source = editors["waves"].source
    source.setCurrentIndex(source.findData("measured"))
    source.activated.emit(source.currentIndex())
    idle(context.jobs, qtbot)
    assert given(page).given("coma")["waves"] == (0.3, "measured")
    with qtbot.waitSignal(context.jobs.finished, timeout=GUARD_MS) as end:
        page.simulate(str(tmp_path / "H.h5"))
    assert end.args[0].state is JobState.DONE, end.args[0].error
    with open_psf(tmp_path / "H.h5") as H:
        (coma,) = [one for one in H.provenance["simulated"]["effects"] if one["name"] == "coma"]
        assert (coma["waves"], coma["angle_rad"]) == (0.3, pytest.approx(math.radians(40)))
        assert H.provenance["effect_sources"]["coma"] == {"waves": "measured", "angle_rad": "stated"}
    type_into(editors["waves"].edit, " ", qtbot)
    idle(context.jobs, qtbot)
    assert given(page).given("coma").keys() == {"angle_rad"} and editors["waves"].edit.text() == "0.25"
    page.panel.reset_button.click()
    idle(context.jobs, qtbot)
    assert not page.verdict.row("coma").on and given(page) == RAYS


REFUSED = (
    ("coma", "waves", "large", "a number, with waves or no unit"),
    ("coma", "waves", "0,3", "decimal point"),
    ("crosstalk", "share", "30", "expected 0 to 25 %, got 30 %"),
    ("iris_shape", "blades", "2", "0 for a circular iris"),
    ("colour_filter", "cfa", "QQQQ", "letters"),
)


@pytest.fixture
def full_after(monkeypatch: pytest.MonkeyPatch) -> Callable[[int | None], list[Path]]:
    """Return a function that fills the disk after some frames, or frees it, and returns what is written."""
    real, written, limit = session._write_png, list[Path](), list[int | None]([None])

    def write(path: Path, frame: Any) -> None:
        if limit[0] is not None and len(written) >= limit[0]:
            raise StorageError(f"{path}: the disk is full; make room")
        real(path, frame)
        written.append(path)

    def fill(count: int | None) -> list[Path]:
        limit[0] = count
        return written

    monkeypatch.setattr(session, "_write_png", write)
    return fill


@pytest.mark.long
def test_frames_of_a_session_that_is_stopped_are_kept_and_it_continues_to_the_same(
    page: Any, qtbot: QtBot, tmp_path: Path, full_after: Callable[[int | None], list[Path]]
) -> None:
    context, folder, written = page.context, tmp_path / "session", full_after(3)
    page.simulate_frames(str(folder))
    idle(context.jobs, qtbot)
    job = context.jobs.jobs()[0]
    assert job.state is JobState.FAILED and job.kept == f"3 of {context.state.plan.n_positions} frames"
    full_after(None)
    context.jobs.go_on(job.number)
    idle(context.jobs, qtbot)
    assert len(written) == len(set(written)), "no frame is made twice"
    page.simulate_frames(str(tmp_path / "whole"))
    idle(context.jobs, qtbot)

    def contents(of: Path) -> dict[str, bytes]:
        return {str(path.relative_to(of)): path.read_bytes() for path in of.rglob("*") if path.is_file()}

    assert contents(folder) == contents(tmp_path / "whole") and not (folder / session.UNFINISHED).exists()


def test_frames_of_a_session_that_failed_are_discarded_and_those_of_another_are_not_continued(
    page: Any, qtbot: QtBot, tmp_path: Path, full_after: Callable[[int | None], list[Path]]
) -> None:
    jobs, third = page.context.jobs, tmp_path / "third"
    full_after(1)
    page.simulate_frames(str(third))
    idle(jobs, qtbot)
    job = jobs.jobs()[0]
    assert job.kept == f"1 of {page.context.state.plan.n_positions} frames"
    jobs.discard(job.number)
    idle(jobs, qtbot)
    assert not list(third.iterdir())
    page.simulate_frames(str(third))
    idle(jobs, qtbot)
    assert not jobs.jobs()[0].kept and not list(third.iterdir()), "nothing was written"
    (third / session.UNFINISHED).write_text('{"frames": 5}')
    page.simulate_frames(str(third))
    idle(jobs, qtbot)
    assert jobs.jobs()[0].state is JobState.FAILED and "frames of the same session" in jobs.jobs()[0].error


def test_effects_on_frames_make_one_frame_or_those_of_the_plan(page: Any, qtbot: QtBot, tmp_path: Path) -> None:
    editors = choose(page, "read_noise", qtbot)
    effect, panel, folder = page.panel.effect, page.panel, tmp_path / "session"
    assert "affects sensor frames, not H" in effect.title.text()
    assert "samples differ" in effect.influence.words.text()
    assert "sensor column" in effect.influence.pictures[0].toolTip()
    noisy = effect.influence.influence
    assert noisy.difference.std() > 0
    panel.show_frame_tab()
    panel.frame.make_button.click()
    idle(page.context.jobs, qtbot)
    frame = panel.frame.frame
    assert panel.tabs.currentWidget() is panel.frame and frame is not None
    assert frame.samples.shape == page.context.state.camera.sensor.shape and frame.samples.dtype == np.uint16
    assert np.array_equal(frame.cutout()[0], noisy.with_it), "the same seed gives the same frame"
    for name in ("frame.tif", "frame.png"):
        panel.frame.save(str(tmp_path / name))
        assert np.array_equal(cv2.imread(str(tmp_path / name), cv2.IMREAD_UNCHANGED), frame.samples)
    assert "not rounded" not in panel.frame.words.text()
    type_into(editors["rms_e"].edit, "30", qtbot)
    page.simulate_frames(str(folder))
    idle(page.context.jobs, qtbot)
    job = page.context.jobs.jobs()[0]
    assert job.state is JobState.DONE, job.error
    assert {"name": "read_noise", "rms_e": 30} in json.loads((folder / "truth.json").read_text())["effects"]
    assert len(open_frames(folder / "frames")) == page.context.state.plan.n_positions
    page.simulate_frames(str(folder))
    assert "new or empty folder" in page.notice.label.text()


@pytest.mark.long
def test_a_bad_value_is_refused_beside_its_field(page: Any, qtbot: QtBot) -> None:
    for effect, field, text, words in REFUSED:
        editor = choose(page, effect, qtbot)[field]
        type_into(editor.edit, text, qtbot)
        assert words in editor.error.text() and editor.error.isVisible() and "\n" not in editor.error.text()
        assert editor.edit.property("invalid") and given(page).magnitudes == ()
        page._set("tolerance", given(page).tolerance * 0.9)
        idle(page.context.jobs, qtbot)
        assert editor.edit.text() == text and editor.error.isVisible(), "what is being corrected stays"
        editor.source.setCurrentIndex(0)
        editor.source.activated.emit(0)
        idle(page.context.jobs, qtbot)
        assert editor.error.isHidden() and editor.edit.text() == editor.magnitude.text(editor.magnitude.counts)


def test_values_of_the_camera_bear_its_marks(page: Any, context: Context, qtbot: QtBot) -> None:
    editor = choose(page, "read_noise", qtbot)["rms_e"]
    assert editor.source.currentText() == "camera: stated"
    assert float(editor.edit.text()) == context.state.camera.sensor.read_noise_e
    camera = replace(context.state.camera, marks=Marks.of({"sensor.read_noise_e": "assumed"}))
    assert context.state.plan is not None
    context.project.update("camera", camera=camera, plan=replace(context.state.plan, camera=camera))
    idle(context.jobs, qtbot)
    assert editor.source.currentText() == "camera: assumed"
    type_into(editor.edit, "3", qtbot)
    idle(context.jobs, qtbot)
    assert editor.source.currentText() == "stated" and editor.source.itemText(0) == "camera: assumed"


def test_a_measured_wavefront_is_a_table_of_terms(page: Any, qtbot: QtBot) -> None:
    table = choose(page, "zernike", qtbot)["terms"].table
    editor = page.panel.effect.form.editors["terms"]
    page.panel.table.ask_next("zernike")
    idle(page.context.jobs, qtbot)
    assert "has no terms" in page.panel.effect.why.text() and not page.verdict.row("zernike").on
    table.add_button.click()
    for column, text in enumerate(("4", "1", "0.1")):
        table.cells.item(0, column).setText(text)
    assert "row 1: Zernike term" in editor.error.text() and given(page).given("zernike") == {}
    table.cells.item(0, 1).setText("0")
    idle(page.context.jobs, qtbot)
    assert editor.error.isHidden() and given(page).given("zernike") == {"terms": (((4, 0, 0.1),), "stated")}
    assert page.verdict.row("zernike").on and "has no terms" not in page.panel.effect.why.text()
    table.add_button.click()
    assert table.cells.rowCount() == 2, "an empty row is no term yet"
    table.cells.setCurrentCell(0, 0)
    table.cells.setFocus()
    QTest.keyClick(table.cells, Qt.Key.Key_Delete)
    idle(page.context.jobs, qtbot)
    assert given(page).given("zernike") == {} and not page.verdict.row("zernike").on


def test_the_influence_of_an_effect_on_h(page: Any, qtbot: QtBot) -> None:
    page.panel.edited.emit("level", "wave")  # rays know no aberration
    choose(page, "coma", qtbot)
    view = page.panel.effect.influence
    plan = page.context.state.plan
    typical = view.influence
    assert typical.without.shape == plan.cutout
    assert "At a typical size" in view.words.text() and "% of the light differs" in view.words.text()
    changed = np.abs(typical.difference).sum() / np.abs(typical.with_it).sum()
    assert changed > 0.02 and f"{100 * changed:.2g} % of the light differs" in view.words.text()
    assert typical.with_it.sum() == pytest.approx(typical.without.sum(), rel=0.05)
    assert "column s" in view.pictures[0].toolTip()
    page.panel.place.row_box.setValue(0)
    idle(page.context.jobs, qtbot)
    moved = view.influence
    assert moved is not typical and "position (0, 1)" in view.words.text()
    page.panel.place.row_box.setValue(1)
    assert view.influence is typical, "what was computed is kept"
    choose(page, "crosstalk", qtbot)
    light = view.influence
    # 1 % to each of four neighbours, of two lines: the middle keeps 0.98 squared
    assert light.with_it.sum() == pytest.approx(light.without.sum(), rel=1e-3)
    assert light.with_it.max() < light.without.max()


def test_waiting_for_the_influence_can_be_stopped(page: Any, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def endless(question: Any, stopped: Callable[[], bool]) -> None:
        asked.append(question)
        while not stopped():
            pass

    monkeypatch.setattr(page.influences, "answer", endless)
    page.panel.table.select("coma")
    qtbot.waitUntil(lambda: len(asked) == 1, timeout=GUARD_MS)
    page.panel.effect.stop_button.click()
    idle(page.context.jobs, qtbot)
    assert "Stopped" in page.panel.effect.influence.words.text() and page.panel.effect.influence.influence is None
    page.panel.table.select("spherical")
    page.panel.table.select("crosstalk")
    qtbot.waitUntil(lambda: len(asked) > 1, timeout=GUARD_MS)
    page._stop_influence()
    monkeypatch.undo()
    page.panel.table.select("finite_source")
    idle(page.context.jobs, qtbot)
    assert page.panel.effect.influence.influence is not None, "the newest question is answered"


def test_magnitudes_go_to_a_file_and_come_back(page: Any, qtbot: QtBot, tmp_path: Path) -> None:
    path = tmp_path / "effects.json"
    type_into(choose(page, "coma", qtbot)["waves"].edit, "0.3", qtbot)
    page.panel.table.choice_asked.emit("bandwidth", "off")
    page.export_magnitudes(str(path))
    before = given(page)
    page.panel.reset_button.click()
    assert given(page) == RAYS
    page.import_magnitudes(str(path))
    idle(page.context.jobs, qtbot)
    assert given(page) == before and page.verdict.row("coma").on
    path.write_text('[{"name": "coma", "waves": "large"}]')
    page.import_magnitudes(str(path))
    idle(page.context.jobs, qtbot)
    assert "a number" in page.notice.label.text() and given(page) == before


def test_a_simulation_in_passes_that_is_stopped_keeps_the_last_whole_h(
    page: Any, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    context, second, go_on = page.context, threading.Event(), threading.Event()
    passes: list[str] = []

    def held(words: str) -> None:
        passes.extend([words] if "complete with errors" in words else [])
        if len(passes) == 2:
            second.set()
            assert go_on.wait(GUARD_MS / 1000)

    monkeypatch.setattr(simulate, "note", held)
    said: list[str] = []
    context.message.connect(said.append)
    settings = SimulateSettings(0.05)
    context.project.update("settings", settings=settings.into(context.state))
    page.panel.forms[1].editor("progressive").click()
    assert given(page).progressive and not page.panel.forms[1].editor("store_tolerance").isEnabled()
    idle(context.jobs, qtbot)
    out = tmp_path / "H.h5"
    page.simulate(str(out))
    qtbot.waitUntil(second.is_set, timeout=GUARD_MS)
    (job,) = [job for job in context.jobs.jobs() if job.active]
    context.jobs.cancel(job.number)
    go_on.set()
    idle(context.jobs, qtbot)
    assert any(words.startswith(f"kept {out}, all planes within") for words in said)
    assert context.state.reference == str(out)
    with open_psf(out) as kept:
        assert float(np.max(kept.facts.known()["error"])) <= 1 / 6
        assert kept.provenance["simulated"]["tolerance"] == pytest.approx(1 / 6)
    context.matrices.forget(str(out))
    kept_words = context.jobs.jobs()[0].kept
    assert kept_words.endswith(" of pass 3 of 3") and context.jobs.jobs()[0].number == job.number
    context.jobs.go_on(job.number)
    idle(context.jobs, qtbot)
    assert context.jobs.jobs()[0].state is JobState.DONE and [path.name for path in tmp_path.iterdir()] == ["H.h5"]
    stages = [line.words for line in context.jobs.log(job.number).lines() if line.kind == "stage"]
    assert sum(line.startswith("pass 2 of 3, join planes") for line in stages) == 1, "what was whole is not made again"
    with open_psf(out) as done:
        assert float(np.max(done.facts.known()["error"])) <= 0.05
