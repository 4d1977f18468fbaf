"""Use > Reconstruct: a light field is opened or made, reconstructed, judged and saved."""

from __future__ import annotations

import csv
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QComboBox, QFileDialog
from pytestqt.qtbot import QtBot

from lfcal.accuracy import CostPoint, Curve
from lfcal.psf import PSFMatrix, save
from lfcal.reconstruct import SolverChoice, load_volume, save_volume
from lfcal.reconstruct.projectors.device import ArrayDevice
from lfcal.reconstruct.volumes import load_labels
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState, subject_of
from lfcal_gui.pages.reconstruct import model
from lfcal_gui.pages.reconstruct.model import NO_DEVICE, ReconstructSettings, device_reason
from lfcal_gui.pages.reconstruct.page import Page
from tests.frames.test_containers import write_zarr
from tests.gui.conftest import OpenPage
from tests.gui.pages.reconstruct.test_model import matrix_file
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def state(tmp_path: Path) -> ProjectState:
    return ProjectState(psf=matrix_file(tmp_path / "H.h5"))


@pytest.fixture
def page(open_page: OpenPage) -> Page:
    made: Page = open_page("reconstruct")
    return made


def make(page: Page, qtbot: QtBot, path: Path, name: str = "vesicle") -> None:
    qtbot.waitUntil(lambda: page.context.matrix(page.context.state.psf) is not None, timeout=GUARD_MS)
    page.make_light_field(name, str(path), (24, 28))
    qtbot.waitUntil(lambda: page.image is not None and page._opened == str(path), timeout=GUARD_MS)


def test_empty_states_say_what_comes_next(page: Page, context: Context, qtbot: QtBot) -> None:
    idle(context.jobs, qtbot)
    empty = page.panel.view.empty
    assert empty.title.text() == "No light field open" and empty.isVisibleTo(page) and not page.panel.go.isEnabled()
    assert not page.panel.view.light_field.isVisibleTo(page) and page.panel.export.isVisibleTo(page)
    assert page.panel.misfit.blank.isVisibleTo(page) and "Reconstruct" in page.panel.misfit.blank.text()
    context.project.update("none", psf="")
    assert "need an H" in page.empty.label.text()


def test_missing_positions_of_h_and_the_scale_of_a_saved_volume_are_said(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    recorded = np.ones((2, 4, 4), int)
    recorded[1, 2, 3] = 0
    path = str(save(PSFMatrix(np.ones((2, 4, 4, 5, 5), np.float32), recorded=recorded), tmp_path / "gaps.h5"))
    context.project.update("open", psf=path)
    qtbot.waitUntil(lambda: context.matrix(path) is not None, timeout=GUARD_MS)
    assert "1 of 32 positions is missing, the first at (z, y, x) = (1, 2, 3)" in page.hint.text()
    save_volume(tmp_path / "v.tif", np.ones((2, 4, 5)), depths_um=[30.0, 10.0], voxel_um=(2.5, 3.0))
    context.project.update("open", volume=str(tmp_path / "v.tif"))
    idle(context.jobs, qtbot)
    prepared = page.panel.view.prepared
    assert prepared.solid.measured
    np.testing.assert_allclose(prepared.solid.sides, (2.5, 3.0), rtol=1e-5)
    assert prepared.solid.given.tolist() == [30.0, 10.0]


VOLUME = np.random.default_rng(3).random((2, 4, 5)).astype(np.float32)


@pytest.mark.parametrize("name", ["v.ome.zarr", "other.zarr", "v.h5", "v.tif", "v.npy"])
def test_a_dropped_volume_is_shown(page: Page, context: Context, qtbot: QtBot, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "other.zarr":  # of another program
        write_zarr(path, VOLUME, "zyx", "0.5")
    else:
        pytest.importorskip("zarr" if path.suffix == ".zarr" else "numpy")
        save_volume(path, VOLUME, depths_um=None if path.suffix == ".npy" else [10.0, 30.0])
    make(page, qtbot, tmp_path / "light.tif")
    page.start()
    ended(page, qtbot)
    assert page.solving is not None
    assert page.accept_drop([str(path)])
    qtbot.waitUntil(lambda: page.saved is not None and page.panel.view.prepared is not None, timeout=GUARD_MS)
    np.testing.assert_array_equal(page.saved, VOLUME)
    assert context.state.volume == str(path) and context.state.light_field == str(tmp_path / "light.tif")
    assert page.panel.view.prepared.solid.values.shape == VOLUME.shape and page.solving is None
    context.project.update("no H", psf="")
    assert page.empty is None and page.panel.area.isHidden(), "a volume is shown without H"
    assert page.hint.text().startswith("plane")
    context.project.update("no volume", volume="")
    assert page.empty is not None and page.hint.text() == page.spec.hint and not page.panel.area.isHidden()


def test_a_light_field_and_h_are_dropped_as_before(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    write_zarr(tmp_path / "one.zarr", VOLUME[0], "yx", "0.5")
    assert page.accept_drop([str(tmp_path / "one.zarr")])
    qtbot.waitUntil(lambda: page.image is not None, timeout=GUARD_MS)
    np.testing.assert_array_equal(page.image, VOLUME[0])
    offered: list[object] = []
    context.go.connect(lambda key, _: offered.append(key))
    context.files_offered.connect(offered.append)
    assert page.accept_drop([context.state.psf])
    idle(context.jobs, qtbot)
    assert offered == ["h", [context.state.psf]] and context.state.volume == ""
    page.hide()
    assert not page.accept_drop([context.state.psf]), "H opens it"


def test_a_volume_is_chosen_from_the_menu(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("zarr")
    file, folder = tmp_path / "v.tif", tmp_path / "v.ome.zarr"
    for path in (file, folder):
        save_volume(path, VOLUME)
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: (str(file), ""))
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: str(folder))
    for action, path in zip(page.panel.open_volume.menu().actions(), (file, folder), strict=True):
        action.trigger()
        idle(context.jobs, qtbot)
        assert context.state.volume == str(path) and page.saved is not None
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: str(tmp_path))
    action.trigger()
    idle(context.jobs, qtbot)
    assert context.state.volume == str(folder) and page.notice.isVisible(), "a folder without a volume replaces nothing"


def test_no_light_field_without_h(
    page: Page, context: Context, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    said: list[str] = []
    context.message.connect(said.append)
    monkeypatch.setattr(context.matrices, "get", lambda _: None)
    page.make_light_field("vesicle", str(tmp_path / "v.tif"))
    assert any("H is being opened" in words for words in said)


def test_a_light_field_is_reconstructed(
    page: Page, context: Context, open_page: OpenPage, qtbot: QtBot, tmp_path: Path
) -> None:
    make(page, qtbot, tmp_path / "v.tif")
    assert context.state.light_field.endswith("v.tif") and "28 × 24 px" in page.panel.file.text()
    qtbot.waitUntil(lambda: "Memory" in page.panel.forecast.text(), timeout=GUARD_MS)
    context.project.update("n", settings=ReconstructSettings(iterations=5).into(context.state))
    assert page.panel.go.text() == "Reconstruct"
    qtbot.mouseClick(page.panel.go, Qt.MouseButton.LeftButton)
    assert not page.panel.form.isEnabled() and page.panel.go.text() == "Stop" and page.panel.go.isEnabled()
    ended(page, qtbot)
    words = page.panel.status.text()
    assert "5 iterations" in words and "misfit" in words and "NRMSE" in words
    assert page.panel.view.volume.shape == (2, 24, 28)
    first = page.solving
    assert len(first.history) == 5
    assert page.panel.go.text() == "Run 5 more" and page.panel.took.text().startswith("done in")
    qtbot.mouseClick(page.panel.go, Qt.MouseButton.LeftButton)
    ended(page, qtbot)
    assert [r.iteration for r in first.history] == list(range(1, 11)) and page.solving is first
    x, y = page.panel.misfit._curves["misfit"].getData()
    # an accelerated method may overshoot by a little
    assert len(x) == 10 and y[-1] < y[0] / 20 and (y < 1.1 * np.minimum.accumulate(y)).all()
    _, errors = page.panel.misfit._curves["error relative to the truth"].getData()
    assert len(errors) == 10 and errors[-1] == pytest.approx(100 * first.errors[-1]) and errors[-1] < errors[0]
    key = page.panel.key
    assert not key.isHidden() and all(name in key.text() for name in page.panel.misfit._curves), "which curve is which"
    idle(context.jobs, qtbot)
    truth = page.panel.view.looks[1]
    assert page.synthetic is not None and truth.isVisibleTo(page) and truth.prepared is not None
    np.testing.assert_array_equal(truth.prepared.volume, page.synthetic.truth)
    page.panel.view.ticks["truth"].trigger()
    assert not truth.isVisibleTo(page)

    for name in ("out.tif", "out.h5"):
        page.save(str(tmp_path / name))
        qtbot.waitUntil(lambda name=name: context.state.volume.endswith(name), timeout=GUARD_MS)
        assert first.state is not None
        np.testing.assert_allclose(load_volume(tmp_path / name), first.volume, rtol=1e-6)

    context.project.update("solver", settings=ReconstructSettings("isra").into(context.state))
    assert page.panel.go.text() == "Reconstruct", "another solver begins again"
    again = open_page("reconstruct")
    qtbot.waitUntil(lambda: again.saved is not None and again.image is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    assert "out.h5" in again.panel.view.solid.shot.caption or again.panel.view._title == "out.h5"
    assert again.panel.view.stack.currentWidget() is again.panel.view.looking


def test_stop_keeps_what_there_is(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    make(page, qtbot, tmp_path / "v.tif")
    context.project.update("n", settings=ReconstructSettings(iterations=100_000).into(context.state))
    page.start()
    solving = page.solving
    qtbot.waitUntil(lambda: len(solving.history) > 2, timeout=GUARD_MS)
    qtbot.mouseClick(page.panel.go, Qt.MouseButton.LeftButton)
    ended(page, qtbot)
    assert page.panel.go.text().startswith("Run") and page.panel.save.isVisible()
    assert page.panel.view.stack.currentWidget() is page.panel.view.looking
    page.panel.again.click()
    assert page.solving is not solving, "it starts again"
    qtbot.waitUntil(lambda: page.solving is not None and len(page.solving.history) > 2, timeout=GUARD_MS)
    context.jobs.cancel(page._job)  # the stop button of the status area
    ended(page, qtbot)
    assert "misfit" in page.panel.status.text()


def ended(page: Page, qtbot: QtBot) -> None:
    qtbot.waitUntil(lambda: page._job == 0, timeout=GUARD_MS)


def test_a_device_is_chosen_where_there_is_one_and_otherwise_refused_in_a_line(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    idle(context.jobs, qtbot)
    box = page.panel.more.editor("device")
    assert isinstance(box, QComboBox) and [box.itemData(k) for k in range(box.count())] == ["auto", "cpu", "cuda"]
    page._device_looked_for("")
    assert box.isEnabled() and "processor" in box.toolTip() and "Greyed" not in box.toolTip()
    box.setCurrentIndex(box.findData("cpu"))
    assert ReconstructSettings.of(context.state).device == "cpu"
    page._device_looked_for(NO_DEVICE)
    assert not box.isEnabled() and NO_DEVICE in box.toolTip() and box.accessibleDescription() == NO_DEVICE
    make(page, qtbot, tmp_path / "light.tif")
    monkeypatch.setattr("lfcal.reconstruct.projectors.device.device_count", lambda library: 0)
    for device, words in (("cuda", "device cuda"), ("cpu", "<b>processor</b>")):
        context.project.update("device", settings=ReconstructSettings(device=device).into(context.state))
        idle(context.jobs, qtbot)
        told = page.panel.forecast.text()
        assert words in told and (device == "cpu" or ("choose cpu" in told and "\n" not in told))
        assert device == "cpu" or (box.isEnabled() and box.currentData() == "cuda"), "it can be taken back"


def test_stop_answers_at_once_also_while_it_is_set_up(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import lfcal_gui.pages.reconstruct.model_solving as module

    make(page, qtbot, tmp_path / "v.tif")
    begun, go_on, really = threading.Event(), threading.Event(), module.projector_for

    def slow(*given: Any) -> Any:
        begun.set()
        go_on.wait(GUARD_MS / 1e3)
        return really(*given)

    page.panel.forecast.setText("")
    qtbot.waitUntil(lambda: not context.jobs.computing, timeout=GUARD_MS)
    monkeypatch.setattr(module, "projector_for", slow)
    page.start()
    solving, stop = page.solving, page.panel.go
    assert solving is not None and begun.wait(GUARD_MS / 1e3) and stop.isEnabled()
    stop.click()
    assert "stopping" in page.panel.status.text()
    go_on.set()
    ended(page, qtbot)
    assert solving.history == () and page.panel.status.text() == "stopped"
    monkeypatch.undo()
    page.start()
    page.panel.go.click()  # before its thread has come to anything
    ended(page, qtbot)
    assert len(page.solving.history) <= 1


def test_faults_come_in_words(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    make(page, qtbot, tmp_path / "v.tif")
    context.project.update("n", settings=ReconstructSettings(region=(0, 0, 99, 5)).into(context.state))
    qtbot.waitUntil(lambda: "region" in page.panel.forecast.text(), timeout=GUARD_MS)
    page.start()
    ended(page, qtbot)
    assert "region" in page.panel.status.text() and page.panel.status.property("role") == "error"
    bad = tmp_path / "bad.tif"
    bad.write_bytes(b"nothing")
    assert page.accept_drop([str(bad)])
    qtbot.waitUntil(lambda: "bad.tif" in page.notice.label.text() and page.notice.isVisible(), timeout=GUARD_MS)
    qtbot.waitUntil(lambda: "Dismiss" in page.notice.button.text(), timeout=GUARD_MS)
    assert context.state.light_field == str(tmp_path / "v.tif") and page.image is not None, "the good one stays"
    assert not page.accept_drop([str(tmp_path)])


def test_form_and_project_follow_each_other(page: Page, context: Context, qtbot: QtBot) -> None:
    idle(context.jobs, qtbot)  # the form is shown once H is open
    form = page.panel.form
    editor: Any = form.editor("iterations")
    editor.setText("7")
    editor.textEdited.emit("7")
    assert page.settings.iterations == 7
    context.project.undo()
    assert editor.text() == str(SolverChoice().iterations)
    editor.setText("0")
    editor.textEdited.emit("0")
    assert "iterations" in form.error and page.settings.iterations == SolverChoice().iterations == 15
    solver: Any = form.editor("solver")
    assert solver.currentData() == SolverChoice().name, "as the command"
    page.panel.more.open()
    solver.setCurrentIndex(solver.findData("rl-tv"))
    assert page.settings.solver == "rl-tv" and "total variation" in page.panel.solver_words.text()
    assert page.panel.more.editor("strength").isEnabled() and not page.panel.more.editor("subsets").isEnabled()
    stop: Any = page.panel.more.editor("stop")
    stop.setCurrentIndex(stop.findData("left-out"))
    assert page.settings.stop == "left-out" and not form.editor("iterations").isEnabled()
    assert page.panel.more.editor("gain").isHidden()
    stop.setCurrentIndex(stop.findData("discrepancy"))
    assert not form.editor("iterations").isEnabled() and not page.panel.more.editor("gain").isHidden()
    stop.setCurrentIndex(stop.findData(""))
    assert form.editor("iterations").isEnabled() and not form.editor("iterations").isHidden()
    assert page.panel.more.editor("gain").isHidden()
    for key, text, value in (("threshold", "2", 0.02), ("tolerance", "1e-4", 1e-4), ("memory", "2.5", 2.5)):
        folded: Any = page.panel.more.editor(key)
        folded.setText(text)
        folded.textEdited.emit(text)
        assert getattr(page.settings, key) == pytest.approx(value)
    page.panel.more.head.setChecked(False)
    assert page.panel.more.editor("memory").isHidden(), "what is rarely needed is folded"
    assert page.panel.more.head.words == "3 changed", "and its row says what differs"


def test_a_solver_that_cannot_end_as_asked_says_so(page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model, "used_by", lambda solver, key: key != "weights")
    panel = page.panel
    panel.show_solver(ReconstructSettings(stop="left-out"))
    assert "cannot hold out" in panel.solver_words.text() and panel.form.editor("iterations").isEnabled()
    for stop in ("", "discrepancy"):
        panel.show_solver(ReconstructSettings(stop=stop))
        assert "cannot hold out" not in panel.solver_words.text()


def test_no_library_is_loaded_where_there_is_no_driver(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal.reconstruct.projectors.find_device", lambda text: None)
    assert device_reason() == NO_DEVICE
    monkeypatch.setattr("lfcal.reconstruct.projectors.find_device", lambda text: ArrayDevice("torch", 0))
    assert device_reason() == ""


def test_the_forecast_reaches_the_next_step(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    make(page, qtbot, tmp_path / "light.tif")
    idle(context.jobs, qtbot)
    told = context.reported["reconstruct"]
    assert told["reconstruct_s"] > 0 and told["voxels"] == (2, 24, 28)
    seconds = []
    for iterations in (100, 100_000):
        context.project.update("n", settings=ReconstructSettings(iterations=iterations).into(context.state))
        idle(context.jobs, qtbot)
        seconds.append(context.reported["reconstruct"]["reconstruct_s"])
    assert seconds[1] > 10 * seconds[0]
    context.project.update("bad", settings=ReconstructSettings(region=(0, 0, 99, 5)).into(context.state))
    idle(context.jobs, qtbot)
    assert context.reported["reconstruct"]["reconstruct_s"] is None and page.panel.took.text() == ""


def test_a_measured_point_sets_solver_and_iterations(page: Page, context: Context, qtbot: QtBot) -> None:
    """The chart in the settings shows what this H costs, as page Accuracy measures it."""
    idle(context.jobs, qtbot)
    page.panel.more.open()
    assert page.panel.curve.measure_button.text() == "Measure"
    curve = Curve("solvers", "Solvers", "error", "seconds", "seconds")
    for solver, iterations, error, cost in (("isra", 4, 0.2, 1.0), ("rl", 30, 0.01, 9.0)):
        settings = {"solver": solver, "iterations": iterations}
        curve = curve.with_point(CostPoint(f"{solver}, {iterations}", settings, error, cost, "seconds"))
    context.curves.put(subject_of(context.state, "psf"), curve, 2.0)
    page.costing.show()
    assert "measured in" in page.panel.curve.status.text()
    page.panel.curve.chosen.emit(1)
    assert (page.settings.solver, page.settings.iterations) == ("rl", 30)
    assert [point.picked for point in page.panel.curve._points] == [False, True]
    context.project.undo()
    assert page.settings.solver == SolverChoice().name
    page.panel.part.setCurrentIndex(1)
    assert page.costing.part == "projection" and not page.panel.curve._points


def test_a_curve_is_measured_as_a_job(page: Page, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lfcal_gui.pages.reconstruct._costing.SECONDS", 0.2)
    idle(page.context.jobs, qtbot)
    page.panel.more.open()
    page.panel.curve.measure_button.click()
    assert not page.panel.curve.measure_button.isEnabled() and page.panel.go.text() == "Reconstruct"
    idle(page.context.jobs, qtbot)
    found = page.context.curves.of(subject_of(page.context.state, "psf"))["solvers"]
    assert found.points and len(page.panel.curve._points) == len(found.points)
    assert page.panel.curve.measure_button.text() == "Measure again"


def test_error_bars_are_computed_and_shown(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    """The window shows the maps of the files, hatches what is unknown, and lists the sums over regions."""
    make(page, qtbot, tmp_path / "light.tif")
    labels = np.zeros((24, 28), np.uint8)
    labels[6:12, 8:16], labels[14:20, 8:16] = 1, 2
    tifffile.imwrite(tmp_path / "labels.tif", labels)
    chosen = replace(page.settings, labels=str(tmp_path / "labels.tif"), replicates=3, margin=0, device="cpu")
    context.project.update("settings", settings=chosen.into(context.state))
    view, out = page.panel.view, tmp_path / "v.tif"
    assert page.panel.bars.isEnabled() and not view.quantity.isVisibleTo(page)
    page.bars(str(out))
    qtbot.waitUntil(lambda: page.saved is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    assert view.quantity.isVisibleTo(page)
    value, sigma, kappa = (load_volume(tmp_path / f"v{end}.tif") for end in ("", "_sigma", "_kappa"))
    shown = {}
    for name in ("Value", "Uncertainty", "Known"):
        view.quantity.setCurrentText(name)
        idle(context.jobs, qtbot)
        shown[name] = view.prepared.volume
    np.testing.assert_array_equal(shown["Value"], value)
    np.testing.assert_array_equal(shown["Uncertainty"], sigma)
    hatched = np.isnan(shown["Known"])
    assert not hatched[kappa <= 0.9].any() and hatched.any() == (kappa > 0.9).any()
    np.testing.assert_array_equal(shown["Known"][~hatched], value[~hatched])
    rows = list(csv.DictReader((tmp_path / "v_regions.csv").read_text().splitlines()))
    assert all(row[key] in page.panel.status.text() for row in rows for key in ("sum", "sigma", "sigma_noise"))


def test_sums_over_drawn_regions_get_error_bars(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    make(page, qtbot, tmp_path / "light.tif")
    chosen = replace(page.settings, replicates=3, margin=0, device="cpu", labels="other.tif")
    context.project.update("settings", settings=chosen.into(context.state))
    planes = len(context.matrix(context.state.psf))
    view, out = page.panel.view, tmp_path / "v.tif"
    view.set_volume(np.ones((planes, 24, 28), np.float32), np.arange(planes, 0.0, -1), (5.0, 5.0))
    idle(context.jobs, qtbot)
    view.drawing.trigger()
    view._press()
    view.slice.steered_to.emit(6, 8)
    view.slice.steered_to.emit(11, 15)
    z = view.intent.z
    page.bars(str(out))
    assert "no file, because regions are drawn" in page.notice.label.text()
    context.project.update("settings", settings=replace(chosen, labels="").into(context.state))
    page.bars(str(out))
    qtbot.waitUntil(lambda: page.saved is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    (row,) = csv.DictReader((tmp_path / "v_regions.csv").read_text().splitlines())
    value = load_volume(out)
    assert float(row["sum"]) == pytest.approx(value[z, 6:12, 8:16].sum(), rel=1e-4)
    assert int(row["voxels"]) == 48 and row["sum"] in page.panel.status.text()
    assert (load_labels(tmp_path / "v_regions.tif", np.arange(planes, 0.0, -1))[z, 6:12, 8:16] == 1).all()
    assert len(view.intent.regions.boxes) == 1, "they are still drawn over the new volume"
    page.let_go()
    assert not view.intent.regions.boxes


def test_regions_of_a_volume_of_another_size_are_refused(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    make(page, qtbot, tmp_path / "light.tif")
    view = page.panel.view
    view.set_volume(np.ones((2, 10, 12), np.float32))
    idle(context.jobs, qtbot)
    view.drawing.trigger()
    view._press()
    view.slice.steered_to.emit(6, 8)
    page.bars(str(tmp_path / "v.tif"))
    idle(context.jobs, qtbot)
    (job,) = (one for one in context.jobs.jobs() if one.kind == "bars")
    assert "labels of regions: expected shape" in job.error
    assert not [path for path in tmp_path.iterdir() if path.name.startswith("v")], "nothing is left"
