"""Camera, Plan, PSF and Simulate, both ways: from the session to the widgets and back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from gui.app import make_window, parse
from gui.jobs import JobState
from gui.pages.plan.model import default_plan
from gui.pages.simulate.model import preview, tolerance_of, tolerance_step
from gui.window import MainWindow
from lfcal.camera import PRESETS, Camera, MainLens, ScanPlan, preset
from lfcal.psf import PSFMatrix, open_psf, save


@pytest.fixture
def window(qapp: QApplication, place: Path, qtbot: QtBot) -> Iterator[MainWindow]:
    made = make_window(qapp, parse([]), folder=place)
    made.show()
    yield made
    made.shut_down()
    made.close()
    made.deleteLater()


def idle(window: MainWindow, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: not window.jobs.busy, timeout=60_000)


@pytest.mark.parametrize("name", PRESETS)
def test_camera_shows_and_takes_presets(window: MainWindow, name: str) -> None:
    page: Any = window.page("camera")
    page.presets.setCurrentIndex(page.presets.findData(name))
    page.presets.activated.emit(page.presets.currentIndex())
    assert window.session.state.camera == preset(name)
    lens = isinstance(preset(name).optics, MainLens)
    assert page.forms["MainLens"].isVisibleTo(page) == lens
    assert page.forms["lattice"].editor("lattice.pitch_um").text() == f"{preset(name).lattice.pitch_um:.10g}"
    assert "px" in page.facts.text()
    assert not page.view.grab().isNull()


def test_camera_files(window: MainWindow, tmp_path: Path) -> None:
    page: Any = window.page("camera")
    page.save_file(str(tmp_path / "c.json"))
    assert Camera.from_json((tmp_path / "c.json").read_text()) == window.session.state.camera
    (tmp_path / "bad.json").write_text("{}")
    before = window.session.state
    page.import_file(str(tmp_path / "bad.json"))
    assert window.session.state == before and "camera description" in window.log_view.toPlainText()


def test_plan_both_ways(window: MainWindow, tmp_path: Path) -> None:
    window.go("plan")
    page: Any = window.page("plan")
    assert page._empty is not None, "no plan yet: the page says what to do"
    page.make_default()
    plan = window.session.state.plan
    assert plan is not None and page._empty is None
    editor = page.form.editor("cutout_rows")
    assert editor.text() == str(plan.cutout[0])
    editor.setText("41")
    editor.textEdited.emit("41")
    changed = window.session.state.plan
    assert changed is not None and changed.cutout == (41, plan.cutout[1])
    before = page.forecast.text()
    editor.setText("40")
    editor.textEdited.emit("40")
    assert "odd" in page.form.error and window.session.state.plan == changed
    window.session.update("planes", plan=replace(changed, depths_um=changed.depths_um[:2], exposure_s=0.01))
    assert page.forecast.text() != before
    page.save_file(str(tmp_path / "plan.json"))
    assert ScanPlan.from_json((tmp_path / "plan.json").read_text()) == window.session.state.plan
    window.session.update("camera", camera=preset("r29"), plan=None)
    assert page._empty is not None
    page.open_file(str(tmp_path / "plan.json"))
    assert window.session.state.camera == preset("bench")


def test_psf_controls_follow_the_intent_and_back(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    values = np.random.default_rng(0).random((3, 4, 5, 9, 11)).astype(np.float32)
    save(PSFMatrix(values, depths=[-10, 0, 10]), tmp_path / "H.h5")
    save(PSFMatrix(values * 3, depths=[-10, 0, 10]), tmp_path / "R.h5")
    window.session.update("open", psf=str(tmp_path / "H.h5"), reference=str(tmp_path / "R.h5"))
    window.go("psf")
    page: Any = window.page("psf")
    idle(window, qtbot)
    assert (page.intent.z, page.intent.y, page.intent.x) == (1, 2, 2)
    page.map.chosen.emit(3, 4)
    np.testing.assert_array_equal(page.main_view.image, values[1, 3, 4])
    page.plane_slider.setValue(2)
    idle(window, qtbot)
    np.testing.assert_array_equal(page.main_view.image, values[2, 3, 4])
    page.strip.setCurrentRow(0)
    idle(window, qtbot)
    assert page.intent.z == 0 and page.plane_slider.value() == 0
    page.ht_button.click()
    np.testing.assert_array_equal(page.main_view.image, page.matrix.T[0, 3, 4])
    page.main_view.hovered.emit(2, 3, 0.0)
    assert page.linked_view.cursor.isVisible()
    page.main_view.hovered.emit(-1, -1, float("nan"))
    assert not page.linked_view.cursor.isVisible()
    page.show_box.setCurrentIndex(page.show_box.findData("difference"))
    assert page.main_view.signed and np.abs(page.main_view.image).max() < 1e-5
    page.scale_box.setCurrentIndex(page.scale_box.findData("log"))
    page.show_box.setCurrentIndex(page.show_box.findData("measured"))
    assert not page.main_view.signed
    page.main_view.save_picture(str(tmp_path / "p.png"))
    page.main_view.save_data(str(tmp_path / "p.csv"))
    page.profile.save_data(str(tmp_path / "q.csv"))
    np.testing.assert_allclose(np.loadtxt(tmp_path / "p.csv", delimiter=","), page.main_view.image, rtol=1e-6)
    assert (tmp_path / "p.png").stat().st_size > 1000 and (tmp_path / "q.csv").read_text().startswith("#")


def test_a_damaged_h_says_so(window: MainWindow, tmp_path: Path) -> None:
    (tmp_path / "H.h5").write_bytes(b"no hdf5")
    window.session.update("open", psf=str(tmp_path / "H.h5"))
    page: Any = window.page("psf")
    assert page.matrix is None and page._empty is not None
    assert "HDF5" in window.log_view.toPlainText()


def test_simulate_both_ways(window: MainWindow, qtbot: QtBot, tmp_path: Path) -> None:
    camera = preset("bench")
    plan = ScanPlan.for_camera(camera, virtual_depths=[2.5, 3.0], cutout=41)
    small = replace(plan, period=(3, 4))
    window.session.update("plan", plan=small)
    window.go("simulate")
    page: Any = window.page("simulate")
    idle(window, qtbot)
    assert page.table.rowCount() == len(page.verdict.rows) > 20
    assert page.view.image is not None and page.view.image.shape == (41, 41)
    names = [row.name for row in page.verdict.rows]
    row = names.index("bandwidth")
    box = page.table.cellWidget(row, 1)
    box.setCurrentIndex(box.findData("on"))
    box.activated.emit(box.currentIndex())
    assert window.session.state.simulate.override("bandwidth") == "on"
    idle(window, qtbot)
    assert page.verdict.rows[row].on and page.table.cellWidget(row, 1).currentData() == "on"
    page.table.selectRow(row)
    assert "bandwidth" in page.why.text()
    window.session.undo()
    idle(window, qtbot)
    assert not page.verdict.rows[row].on
    page.tolerance_slider.setValue(page.tolerance_slider.minimum())
    assert window.session.state.simulate.tolerance == tolerance_of(0)
    page.tolerance_slider.setValue(page.tolerance_slider.maximum())
    idle(window, qtbot)
    page.level_box.setCurrentIndex(page.level_box.findData("geometric"))
    page.level_box.currentIndexChanged.emit(page.level_box.currentIndex())
    idle(window, qtbot)
    with qtbot.waitSignal(window.jobs.finished, timeout=60_000) as end:
        page.simulate(str(tmp_path / "sim.h5"))
    assert end.args[0].state is JobState.DONE, end.args[0].error
    assert window.session.state.psf == str(tmp_path / "sim.h5")
    with open_psf(tmp_path / "sim.h5") as H:
        assert H.shape == small.shape


def test_tolerance_steps_and_previews() -> None:
    for step in (0, 17, 60):
        assert tolerance_step(tolerance_of(step)) == step
    plan = default_plan(preset("bench"))
    for z in (plan.depths_um[0], plan.depths_um[-1], -plan.depths_um[0]):
        image = preview(plan, z, (), "geometric", 0.05)
        assert image.shape == plan.cutout and np.isfinite(image).all()
