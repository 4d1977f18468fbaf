from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication, QCheckBox, QFileDialog, QLineEdit, QWidget
from pytestqt.qtbot import QtBot

from lfcal.acquire import Options
from lfcal.acquire.recording.source import RecordingSource
from lfcal.acquire.session_file import SessionFile
from lfcal.camera import preset
from lfcal.psf import open_psf
from lfcal_gui.context import Context
from lfcal_gui.models import Symbols
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_folder import folder_state
from lfcal_gui.pages.acquire.model_recorder import picture_of
from lfcal_gui.pages.acquire.page import Page
from lfcal_gui.pages.acquire.step import step
from lfcal_gui.theme import DARK, LIGHT, apply_theme, canvas_fair
from tests.acquire.rigs import small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle

PLAN = small_plan((3, 4), 2, settle_s=0.0)


@pytest.fixture
def state() -> ProjectState:
    # the quick pattern suits a period of three by four, which no lenslet array has
    quick = AcquireSettings(device_options=(("optics", "pattern"),))
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": quick.to_dict()})


@pytest.fixture
def page(open_page: OpenPage, qtbot: QtBot) -> Page:
    made: Page = open_page("acquire")
    made.entered()
    qtbot.waitUntil(lambda: made.panel.setup.devices.backend.count() > 0, timeout=GUARD_MS)
    made.panel.recording.open()
    return made


def connect(page: Page, qtbot: QtBot) -> None:
    page.panel.setup.connect_buttons[-1].click()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)


def test_without_a_plan_it_says_what_is_missing(context: Context, open_page: OpenPage) -> None:
    context.project.update("none", plan=None)
    page = open_page("acquire")
    assert page.empty is not None and "scan plan" in page.empty.label.text()
    went: list[str] = []
    context.go.connect(lambda key, _: went.append(key))
    context.project.update("plan", plan=PLAN)
    assert page.empty is None and went == []


def test_backends_say_why_they_are_absent(page: Page, qtbot: QtBot, context: Context) -> None:
    devices = page.panel.setup.devices
    names = [devices.backend.itemData(k) for k in range(devices.backend.count())]
    assert {"sim", "micromanager", "aravis", "gentl", "folder"} <= set(names)
    for k in range(devices.backend.count()):
        assert devices.backend.itemData(k, Qt.ItemDataRole.ToolTipRole)
    devices.set_backends(
        [type("F", (), {"name": "gone", "title": "gone", "version": "", "reason": "gone: not installed; install it"})],
        {"gone": {}},
        {"gone": False},
    )
    devices.set_choice("gone", {}, "")
    assert "not installed" in devices.reason.text() and not devices.button.isEnabled()


def test_device_options_go_into_the_project_and_back(page: Page, context: Context) -> None:
    devices = page.panel.setup.devices
    editor = devices.options.editor("optics")
    assert isinstance(editor, QLineEdit) and editor.accessibleName() == "optics"
    editor.setText("geometric")
    editor.editingFinished.emit()
    assert AcquireSettings.of(context.state).device_options == (("optics", "geometric"),)
    context.project.undo()
    assert editor.text() == "pattern"


def test_a_wrong_option_is_said_in_words(page: Page, context: Context, qtbot: QtBot) -> None:
    page.setup._devices_edited("sim", (("optics", "pattern"), ("velocity", "fast")), "")
    page.setup.connect_devices()
    qtbot.waitUntil(lambda: "velocity" in page.panel.setup.devices.reason.text(), timeout=GUARD_MS)
    assert page.setup.station is None and page.panel.setup.devices.button.isEnabled()


def test_live_view_moves_and_numbers(page: Page, qtbot: QtBot, context: Context) -> None:
    panel = page.panel.setup
    assert "No camera connected" in panel.view.blank.text()
    connect(page, qtbot)
    panel.exposure.setValue(1.0)
    qtbot.waitUntil(lambda: "median" in panel.numbers.text(), timeout=GUARD_MS)  # the live view starts automatically
    qtbot.waitUntil(lambda: "frames/s   1 ms" in panel.view.shot.readout, timeout=GUARD_MS)
    assert "% of range   0 saturated" in panel.view.shot.readout and "centroid" in panel.spot.text()
    assert "Waiting" not in panel.predicted.blank.text(), "a frame is there, with a pattern to expect or without"
    before = panel.stage.fields[0].text()
    panel.stage.step.setValue(50.0)
    for _ in range(3):
        qtbot.keyClick(panel.stage.fields[0], Qt.Key.Key_Up)
    station = page.setup.station
    assert station is not None
    qtbot.waitUntil(lambda: abs(station.position()[0] - 150) < 0.5, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: panel.stage.fields[0].text() != before, timeout=GUARD_MS)
    panel.exposure.setValue(5000.0)
    qtbot.waitUntil(lambda: "% saturated" in panel.view.shot.readout, timeout=GUARD_MS)
    assert "5.0 s" in panel.view.shot.readout
    panel.view.readout_clicked.emit()
    assert panel.exposure.hasFocus()
    page.panel.devices.open()
    qtbot.mouseClick(panel.devices.button, Qt.MouseButton.LeftButton)
    assert page.setup.station is None and panel.view.values is None and panel.view.note == ("", "")


class Slow:
    """A stage that is on its way until it is stopped, 1 µm further whenever it is read."""

    def __init__(self, stage: Any) -> None:
        self._stage, self._z, self._stopped = stage, 0.0, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stage, name)

    def move(self, target: Any) -> None:
        self._stage.move((0.0, 0.0, 50.0))

    def moving(self) -> bool:
        threading.Event().wait(0.005)
        return not self._stopped

    def stop(self) -> None:
        self._stopped = True

    def position(self) -> tuple[float, float, float]:
        self._z += 1.0
        return (0.0, 0.0, 50.0 if self._stopped else self._z)


def test_a_move_is_followed_and_a_frame_of_the_old_place_says_so(page: Page, qtbot: QtBot, context: Context) -> None:
    """Coordinates stood still and then jumped, over a frame of the old depth."""
    panel = page.panel.setup
    connect(page, qtbot)
    qtbot.waitUntil(lambda: panel.view.note[0].endswith("s old"), timeout=GUARD_MS)
    station = page.setup.station
    assert station is not None
    with station._lock:  # between two frames
        station._stop_live()
        station.rig = replace(station.rig, stage=Slow(station.rig.stage))
    page.setup.moves.go_to(", , 50")
    assert panel.stage.motion.text() == "waiting for the current frame …"
    qtbot.waitUntil(lambda: panel.stage.motion.text() == "moving …", timeout=GUARD_MS)
    seen: set[str] = set()

    def several() -> bool:
        seen.add(panel.stage.fields[2].text())
        return len(seen) > 2

    qtbot.waitUntil(several, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: panel.view.note[1] == canvas_fair(), timeout=GUARD_MS)
    assert "from x 0.0, y 0.0, z " in panel.view.note[0]
    qtbot.mouseClick(panel.stage.stop, Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: panel.stage.motion.text() == "at rest" and panel.stage.stop.isHidden(), timeout=GUARD_MS)
    qtbot.waitUntil(lambda: panel.view.note[1] == "" and panel.stage.fields[2].value() == 50.0, timeout=GUARD_MS)


def test_overlays_are_switched_without_another_frame(page: Page, qtbot: QtBot, context: Context) -> None:
    panel = page.panel.setup
    connect(page, qtbot)
    qtbot.waitUntil(lambda: panel.view.values is not None, timeout=GUARD_MS)
    page.setup.reserved = True  # no further frame
    idle(context.jobs, qtbot)
    assert len(panel.view.overlays) == 2
    panel.overlays["cutout"].setChecked(False)
    assert not panel.view.overlays and panel.arrows.isHidden()
    panel.overlays["axes"].setChecked(True)
    assert panel.arrows.isVisible()
    panel.overlays["lattice"].setChecked(True)
    qtbot.waitUntil(lambda: any(isinstance(one, Symbols) and len(one.points) for one in panel.view.overlays))


def test_the_stage_goes_to_a_typed_position(page: Page, qtbot: QtBot, context: Context) -> None:
    """There were steps and planes only."""
    stage = page.panel.setup.stage
    assert not stage.fields[0].isEnabled() and [field.text() for field in stage.fields] == ["–"] * 3
    connect(page, qtbot)
    station = page.setup.station
    assert station is not None
    qtbot.waitUntil(lambda: [field.text() for field in stage.fields] == ["0.00 µm"] * 3, timeout=GUARD_MS)
    page.panel.setCurrentWidget(page.panel.record)
    qtbot.keyClick(page, Qt.Key.Key_G, Qt.KeyboardModifier.ControlModifier)
    assert stage.fields[0].hasFocus()

    def go(axis: int, words: str) -> None:
        stage.fields[axis].setFocus()
        stage.fields[axis].selectAll()
        qtbot.keyClicks(stage.fields[axis], words)

    go(0, "120")
    go(1, "-80")
    assert stage.fields[0].value() == 0.0, "what is not asked for by Return is forgotten"
    qtbot.keyClick(stage.fields[1], Qt.Key.Key_Return)
    qtbot.waitUntil(lambda: np.allclose(station.position(), (0, -80, 0), atol=0.5), timeout=GUARD_MS)
    go(0, "900000000")
    qtbot.keyClick(stage.fields[0], Qt.Key.Key_Return)
    assert stage.refusal.isVisible() and "nothing was moved" in stage.refusal.text()
    assert "stage axis x: expected" in page.panel.setup.readout.text()
    for axis, words in enumerate(("10", "20", "30")):
        go(axis, words)
        qtbot.keyClick(stage.fields[axis], Qt.Key.Key_Return)
    assert not stage.refusal.isVisible()
    qtbot.waitUntil(lambda: np.allclose(station.position(), (10, 20, 30), atol=0.5), timeout=GUARD_MS)
    page.setFocus()
    stage.step.setValue(50.0)
    for key, modifier in (
        (Qt.Key.Key_Right, Qt.KeyboardModifier.ControlModifier),
        (Qt.Key.Key_Down, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier),
    ):
        qtbot.keyClick(page, key, modifier)
    qtbot.waitUntil(lambda: np.allclose(station.position(), (60, 20, -20), atol=0.5), timeout=GUARD_MS)
    page.setup.disconnect_devices()
    idle(context.jobs, qtbot)
    assert [field.text() for field in stage.fields] == ["–"] * 3, "the position of a released stage is unknown"


def test_a_wrong_sign_is_caught_in_red_and_corrected(page: Page, qtbot: QtBot, context: Context) -> None:
    page.setup._devices_edited("sim", (("optics", "pattern"), ("axes", "-x,+y,+z")), "")
    connect(page, qtbot)
    seen: list[tuple[str, bool]] = []
    context.attention.connect(lambda key, flag: seen.append((key, flag)))

    def measure() -> str:
        page.setup.measuring.find("stage")
        assert not page.panel.setup.find_buttons["stage"].isEnabled(), "the devices are at work"
        qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
        return page.panel.setup.results["stage"].text()

    words = measure()
    assert LIGHT.bad in words and "wrong direction" in words and seen[-1] == ("acquire", False)
    assert "The plan now uses these values" in words
    plan = context.state.plan
    assert plan is not None and (plan.stage.right, plan.stage.down) == ("-x", "+y")
    words = measure()
    assert LIGHT.bad not in words and "moves the image as planned" in words and seen[-1] == ("acquire", False)


def test_exposures_are_found_and_used(page: Page, qtbot: QtBot, context: Context) -> None:
    connect(page, qtbot)
    page.setup.measuring.find("exposure")
    qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
    plan = context.state.plan
    assert plan is not None and plan.exposures == page.setup.measuring.found["exposure"] != PLAN.exposures
    page.setup.measuring.find("axis")
    qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
    assert "Optical axis" in page.panel.setup.results["axis"].text() or "magnification" in (
        page.panel.setup.results["axis"].text()
    )


def test_form_and_project_follow_each_other(page: Page, context: Context) -> None:
    form = page.panel.record.form
    darks = form.editor("darks")
    assert isinstance(darks, QLineEdit)
    darks.setText("4")
    darks.textEdited.emit("4")
    assert AcquireSettings.of(context.state).darks == 4
    context.project.undo()
    assert darks.text() == "" and darks.placeholderText() == str(Options().darks)
    darks.textEdited.emit("-3")
    darks.setText("-3")
    darks.textEdited.emit("-3")
    assert form.error and AcquireSettings.of(context.state).darks is None
    order: Any = form.editor("order")
    order.setCurrentIndex(order.findData("raster"))
    assert context.state.plan is not None and context.state.plan.order == "raster"
    order.setCurrentIndex(order.findData("coarse"))
    assert AcquireSettings.of(context.state).order == "coarse" and context.state.plan.order == "raster"


def test_a_session_from_start_to_h(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    """Start, pause, stop, resume, open a plane, assemble, record again: all by the page's own buttons."""
    panel, buttons, folder = page.panel.record, page.panel.record.buttons, tmp_path / "session"
    options = AcquireSettings(darks=2, reference_every=6)
    context.project.update("settings", settings=options.into(context.state), recording=str(folder))
    threads: set[threading.Thread] = set()
    context.jobs.changed.connect(lambda _: threads.add(threading.current_thread()))
    page.panel.setCurrentWidget(panel)
    qtbot.mouseClick(buttons["start"], Qt.MouseButton.LeftButton)  # connects first
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    page.record.pause()
    recorder = page.record.recorder
    assert recorder is not None and buttons["pause"].text() == "Resume"
    assert not panel.form.isEnabled() and not buttons["assemble"].isEnabled()
    qtbot.waitUntil(lambda: recorder.control.held == "paused" or not page.record.recording, timeout=GUARD_MS)
    page.record.pause()
    qtbot.mouseClick(buttons["stop"], Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: not page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: page.record.folder.there is not None, timeout=GUARD_MS)
    if not page.record.folder.complete:
        assert buttons["start"].text() == "Resume session"
        qtbot.mouseClick(buttons["start"], Qt.MouseButton.LeftButton)
        qtbot.waitUntil(lambda: not page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: page.record.folder.complete, timeout=GUARD_MS)
    assert "Complete: 24 of 24" in panel.status.text()
    qtbot.waitUntil(lambda: panel.open_plane.isEnabled(), timeout=GUARD_MS)
    assert "complete" in panel.plane_label.text() and panel.pictures.depth_sum.values is not None
    assert threads == {threading.main_thread()}, "the recording thread never reaches the window"

    idle(context.jobs, qtbot)
    assert context.state.psf == str(folder / "H.h5"), "made without being asked for"
    went: list[str] = []
    context.made.connect(lambda key, _: went.append(key))
    page.record.after.open_plane(1)
    qtbot.waitUntil(lambda: context.state.psf.endswith("plane-01.h5"), timeout=GUARD_MS)
    page.record.after.assemble(str(folder / "H.h5"))
    qtbot.waitUntil(lambda: context.state.psf.endswith("H.h5"), timeout=GUARD_MS)
    assert went == ["h", "h"]
    with open_psf(folder / "H.h5") as H:
        assert H.shape == PLAN.shape and H.recorded.all()
        with open_psf(folder / "plane-01.h5") as one:
            np.testing.assert_allclose(one[0], H[1], rtol=1e-6)

    context.project.update("redo", redo=((0, 1, 2), (1, 0, 0)))
    assert buttons["redo"].text() == "Record again (2)" and buttons["redo"].isEnabled()
    qtbot.mouseClick(buttons["redo"], Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: context.state.redo == (), timeout=GUARD_MS)
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    with RecordingSource(folder) as source:
        assert len(source) == 24 and len(source.session.recordings) == 2
    page.record.after.pack()
    qtbot.waitUntil(lambda: not context.jobs.running_pages(), timeout=GUARD_MS)
    assert folder_state(str(folder)).complete


def test_a_fault_stops_safely_and_is_said(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    page.setup._devices_edited("sim", (("faults", "vanishes@42"),), "")
    connect(page, qtbot)
    exposure, seen = page.panel.setup.exposure, set[tuple[bool, bool]]()
    assert not exposure.isHidden()
    context.jobs.changed.connect(lambda _: seen.add((page.record.recording, exposure.isHidden())))
    context.project.update("folder", recording=str(tmp_path / "s"))
    page.record.start()
    qtbot.waitUntil(lambda: "fault" in page.panel.record.status.text(), timeout=GUARD_MS)
    assert (True, True) in seen and (True, False) not in seen, "recorded frames have the exposures of the plan"
    qtbot.waitUntil(lambda: page.record.folder.there is not None, timeout=GUARD_MS)
    # still shown after the folder was read, together with the next action
    assert "resume" in page.panel.record.detail.text()
    there = page.record.folder.there
    assert there is not None and 0 < there.sum() < 24


def test_a_camera_that_stays_automatic_is_named_and_recorded_once_that_is_allowed(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    page.setup._devices_edited("sim", (("optics", "pattern"), ("automatic", "GainAuto")), "")
    connect(page, qtbot)
    named = "The camera changes frames automatically: GainAuto = Continuous"
    assert named in page.panel.setup.devices.reason.text()
    context.project.update("folder", recording=str(tmp_path / "s"))
    record = page.panel.record
    assert record.why.text().startswith(named) and "tick Allow automatic" in record.why.text()
    page.record.start()
    qtbot.waitUntil(lambda: "Cannot start" in record.status.text(), timeout=GUARD_MS)
    assert "got GainAuto = Continuous; switch this off" in record.detail.text() and "--" not in record.detail.text()
    assert not (tmp_path / "s").exists()
    record.form.open()
    allow = record.form.editor("allow_automatic")
    assert isinstance(allow, QCheckBox) and not allow.isHidden()
    allow.setChecked(True)
    assert AcquireSettings.of(context.state).options().allow_automatic
    qtbot.waitUntil(lambda: named not in record.why.text(), timeout=GUARD_MS)
    assert "--allow-automatic" in step(context.state).arguments
    page.record.start()
    qtbot.waitUntil(lambda: page.record.folder.there is not None, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: not page.record.recording, timeout=GUARD_MS)
    assert SessionFile.read(tmp_path / "s").devices.automatic == ("GainAuto",)


def test_a_lens_is_covered_by_hand_or_dark_frames_are_skipped(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    record, cover = page.panel.record, page.panel.record.form.editor("cover")
    assert isinstance(cover, QCheckBox)
    cover.setChecked(True)
    page.record._field_edited("darks", 1)
    assert "--cover" in step(context.state).arguments
    connect(page, qtbot)
    assert page.setup.station is not None
    page.setup.station.rig = replace(page.setup.station.rig, light=None)
    seen = list[tuple[str, bool]]()
    context.attention.connect(lambda *found: seen.append(found))

    def answer(begins: str, button: str) -> None:
        qtbot.waitUntil(
            lambda: page.notice.label.text().startswith(begins) and page.notice.isVisible(), timeout=GUARD_MS
        )
        assert seen[-1] == ("acquire", True) and record.status.text() == page.notice.label.text()
        qtbot.mouseClick(getattr(page.notice, button), Qt.MouseButton.LeftButton)

    def begin(name: str) -> Path:
        context.project.update("folder", recording=str(tmp_path / name))
        qtbot.waitUntil(lambda: page.record.folder.there is None, timeout=GUARD_MS)
        page.record.start()
        return tmp_path / name

    def ended() -> None:
        qtbot.waitUntil(lambda: not page.record.recording and page.setup.station is not None, timeout=GUARD_MS)
        assert not page.notice.isVisible()

    folder = begin("covered")
    for begins in ("Dark frames need", "Cover the lens", "Uncover the lens"):
        answer(begins, "button")
        assert page.notice.leave.isHidden() or begins == "Dark frames need"
    ended()
    assert SessionFile.read(folder).options.darks == 1 and record.status.text().startswith("Complete")
    folder = begin("skipped")
    answer("Dark frames need", "leave")
    ended()
    assert SessionFile.read(folder).options.darks == 0 and record.status.text().startswith("Complete")
    folder = begin("stopped")
    answer("Dark frames need", "button")
    qtbot.waitUntil(lambda: page.notice.label.text().startswith("Cover"), timeout=GUARD_MS)
    context.jobs.cancel(page.record._job)
    ended()


def test_a_list_of_positions_is_chosen_by_its_button(
    page: Page, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    page.panel.record.form.open()
    editor = page.panel.record.form.editor("positions")
    assert isinstance(editor, QLineEdit)
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: ("half.json", ""))
    (browse,) = editor.actions()
    browse.trigger()
    assert AcquireSettings.of(context.state).positions == editor.text() == "half.json"
    page.panel.record.extent.setCurrentIndex(1)
    assert editor.isHidden() and not page.panel.record.form.editor("unknowns").isHidden()


def test_the_copied_command_leaves_the_check_of_the_stage_out_too(page: Page, context: Context) -> None:
    assert not any("check-stage" in word for word in step(context.state).arguments)
    page.record._field_edited("check_stage", False)
    assert "--no-check-stage" in step(context.state).arguments
    assert "check_stage=False" in step(context.state).python


def test_settings_that_have_no_effect_are_not_shown(page: Page, context: Context, qtbot: QtBot) -> None:
    page.panel.record.form.open()
    hidden = {key: page.panel.record.form.editor(key) for key in ("allow_automatic", "steady", "cover", "unknowns")}
    connect(page, qtbot)
    assert all(editor.isHidden() for editor in hidden.values())
    page.record._field_edited("suspend", "temperature=20:22")
    assert not hidden["steady"].isHidden()


def test_a_dropped_session_that_is_damaged_is_refused(
    page: Page, context: Context, tmp_path: Path, qtbot: QtBot
) -> None:
    assert not page.accept_drop([str(tmp_path)])
    (tmp_path / "session.json").write_text("{}")
    assert page.accept_drop([str(tmp_path)])
    qtbot.waitUntil(lambda: "session.json" in page.panel.record.detail.text(), timeout=GUARD_MS)
    assert context.state.recording == "", "the folder before stays"


def test_it_fits_small_screens_and_both_themes(page: Page, context: Context, qapp: QApplication) -> None:
    assert page.minimumSizeHint().width() <= 1280 - 85 and page.minimumSizeHint().height() <= 620
    apply_theme(qapp, DARK)
    context.theme_changed.emit()
    apply_theme(qapp, LIGHT)
    context.theme_changed.emit()


def test_dialogs_choose_folder_and_file(
    page: Page, context: Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot
) -> None:
    asked: list[Any] = []

    def answer(parent: Any, *_: Any) -> Any:
        assert isinstance(parent, QWidget)
        asked.append(parent)
        return ""

    monkeypatch.setattr(QFileDialog, "getExistingDirectory", answer)
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *a: (answer(*a), ""))
    page.record.start()
    assert len(asked) == 1 and not page.record.recording, "no folder chosen: nothing begins"
    page.panel.record.folder_asked.emit()
    page.record.after.assemble()
    assert len(asked) == 3 and context.state.recording == ""
    monkeypatch.setattr(QFileDialog, "getExistingDirectory", lambda *_: str(tmp_path / "chosen"))
    page.panel.record.folder_asked.emit()
    qtbot.waitUntil(lambda: context.state.recording == str(tmp_path / "chosen"), timeout=GUARD_MS)


@pytest.fixture
def recording(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> Iterator[Page]:
    """Return the page while it records, held."""
    context.project.update("folder", recording=str(tmp_path / "session"))
    page.record.start()
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    page.record.pause()
    yield page
    if page.record.recorder is not None:
        page.record.recorder.control.abort()
    context.jobs.close()  # the page is already closed, and nothing may report to it any more


def test_an_alarm_that_ends_no_longer_asks_for_attention(recording: Page, context: Context, qtbot: QtBot) -> None:
    """A complete session was still marked after the light had returned."""
    tab, seen = recording.record, list[tuple[str, bool]]()
    assert tab.recorder is not None
    control = tab.recorder.control
    qtbot.waitUntil(lambda: control.held == "paused", timeout=GUARD_MS)
    picture = picture_of(tab.recorder, 0, "energy", None)
    context.attention.connect(lambda *found: seen.append(found))
    for alarms in (("the light is gone",), ()):
        tab._show_picture(replace(picture, alarms=alarms), 0, PLAN.depths_um)
        assert seen[-1] == ("acquire", bool(alarms))


def test_a_recording_keeps_its_plan_and_its_buttons(recording: Page, context: Context, qtbot: QtBot) -> None:
    said: list[str] = []
    context.message.connect(said.append)
    before, buttons = context.state, recording.panel.record.buttons
    context.project.update("keystroke", camera=preset("r29"), plan=None)
    recording.setup._devices_edited("folder", (), "")
    context.project.undo()
    assert context.state == before and len([words for words in said if "being recorded" in words]) == 3
    context.project.start(ProjectState())  # another project, as the user may after being asked
    assert recording.empty is None and all(buttons[key].isEnabled() for key in ("pause", "stop", "abort"))
    qtbot.mouseClick(buttons["abort"], Qt.MouseButton.LeftButton)
    qtbot.waitUntil(lambda: not recording.record.recording, timeout=GUARD_MS)
    assert recording.empty is not None and recording.record.recorder is None
    context.project.update("plan", plan=PLAN)


def test_what_a_recording_is_asked_to_do_is_said_at_once(recording: Page, context: Context, qtbot: QtBot) -> None:
    """Stop greyed its button, and nothing else showed that it had been heard."""
    panel, recorder = recording.panel.record, recording.record.recorder
    assert recorder is not None
    assert panel.status.text().startswith("Pausing") or recorder.control.held
    qtbot.waitUntil(lambda: recorder.control.held == "paused", timeout=GUARD_MS)
    qtbot.waitUntil(lambda: panel.detail.text() == "paused", timeout=GUARD_MS)
    panel.buttons["stop"].click()
    assert panel.status.text().startswith("Stopping") and not panel.buttons["stop"].isEnabled()
    qtbot.waitUntil(lambda: not recording.record.recording, timeout=GUARD_MS)
    assert panel.status.text().startswith("Stopped")


def test_a_recording_stopped_in_the_dock_says_so_too(recording: Page, context: Context, qtbot: QtBot) -> None:
    panel, recorder = recording.panel.record, recording.record.recorder
    assert recorder is not None
    qtbot.waitUntil(lambda: recorder.control.held == "paused", timeout=GUARD_MS)
    context.jobs.cancel(recording.record._job)
    assert panel.status.text().startswith("Stopping")
    qtbot.waitUntil(lambda: not recording.record.recording, timeout=GUARD_MS)


@pytest.mark.long
def test_another_project_shows_nothing_of_the_recording_before(
    page: Page, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    page.setup._devices_edited("sim", (("faults", "vanishes@26"),), "")
    context.project.update("folder", recording=str(tmp_path / "s"))
    page.record.start()
    panel, seen = page.panel.record, list[tuple[str, bool]]()
    qtbot.waitUntil(lambda: "fault" in panel.status.text(), timeout=GUARD_MS)
    qtbot.waitUntil(lambda: panel.buttons["assemble"].isEnabled(), timeout=GUARD_MS)
    context.attention.connect(lambda *found: seen.append(found))
    context.project.start(ProjectState())
    context.project.update("plan", plan=PLAN, camera=PLAN.camera)
    qtbot.waitUntil(lambda: not context.jobs.busy, timeout=GUARD_MS)
    assert (
        panel.status.text() == ""
        and panel.progress.isHidden()
        and panel.detail.text() == ""
        and panel.folder_words.text() == ""
    )
    assert panel.buttons["start"].text() == "Start" and not panel.buttons["assemble"].isEnabled()
    assert page.panel.setup.view.item.image is None
    assert seen[-1] == ("acquire", False)


def test_an_opened_inspector_fits_its_width(page: Page, qtbot: QtBot) -> None:
    page.panel.resize(907, 480)  # in the smallest window
    for fold in (page.panel.devices, page.panel.adjust, page.panel.recording, page.panel.setup.faults.fold):
        fold.open()
    page.panel.setup.devices.options.head.setChecked(True)
    inner = page.panel.inspector.widget()
    assert inner.minimumSizeHint().width() <= page.panel.inspector.viewport().width()


def test_a_low_window_shows_the_sum_without_the_curves(page: Page) -> None:
    page.panel.setCurrentWidget(page.panel.record)
    pictures = page.panel.record.pictures
    pictures.resize(600, pictures.minimumSizeHint().height())
    assert pictures.minimumSizeHint().height() < 150
    assert [one.isHidden() for one in pictures.below] == [True] * 3
    pictures.resize(600, 220)
    pictures.layout().activate()
    assert pictures.upper.height() == 220, "no gap below it"
    pictures.resize(600, 500)
    assert [one.isHidden() for one in pictures.below] == [False] * 3
