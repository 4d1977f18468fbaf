"""The devices of Record > Rig: connected, seen live, moved, measured and released."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLineEdit
from pytestqt.qtbot import QtBot

from lfcal.acquire import LiveFrame, still_files
from lfcal.base import InputError
from lfcal.camera import MainLens
from lfcal.devices import Roi, StageError, simulated_rig
from lfcal.devices.simulated.backend import inject
from lfcal.devices.simulated.faults import FAULTS, DeviceFault
from lfcal.frames import Position
from lfcal_gui.context import Context
from lfcal_gui.models import Outline, ProjectState, Symbols
from lfcal_gui.pages.acquire._devices import COUNTED, KINDS, fault_words
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_live import Pace
from lfcal_gui.pages.acquire.model_recorder import Recorder
from lfcal_gui.pages.acquire.page import Page
from lfcal_gui.theme import LIGHT, canvas_fair
from tests.acquire.rigs import small_plan
from tests.gui.pages.acquire._building import PLAN, connect
from tests.gui.waiting import GUARD_MS, idle


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


def test_device_options_go_into_the_project_and_wrong_ones_are_said(page: Page, context: Context, qtbot: QtBot) -> None:
    devices = page.panel.setup.devices
    editor = devices.options.editor("optics")
    assert isinstance(editor, QLineEdit) and editor.accessibleName() == "optics"
    editor.setText("geometric")
    editor.editingFinished.emit()
    assert AcquireSettings.of(context.state).device_options == (("optics", "geometric"),)
    context.project.undo()
    assert editor.text() == "pattern"
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


def test_the_stage_goes_to_a_typed_position(page: Page, qtbot: QtBot, context: Context) -> None:
    stage = page.panel.setup.stage
    assert not stage.fields[0].isEnabled() and [field.text() for field in stage.fields] == ["–"] * 3
    connect(page, qtbot)
    station = page.setup.station
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
    assert (plan.stage.right, plan.stage.down) == ("-x", "+y")
    words = measure()
    assert LIGHT.bad not in words and "moves the image as planned" in words and seen[-1] == ("acquire", False)


class Camera:
    """Frames of a recording at 150 positions/s: the value of every pixel says which position it is."""

    def __init__(self, recorder: Recorder) -> None:
        self.positions = [Position(*place) for place in PLAN.order_indices().tolist()]
        self.recorder, self.put, self.enough = recorder, 0, threading.Event()
        self.thread = threading.Thread(target=self._run)

    def _run(self) -> None:
        while not self.enough.wait(1 / 150):
            number = self.put % len(self.positions)
            where = self.positions[number]
            data = np.full((30, 40), 100 + number, np.uint16)
            cutout = Roi(20 + number, 10, 5, 6)
            self.recorder.preview.put(LiveFrame(data, Roi(10, 5, 30, 40), cutout, where, 0, "position"))
            self.put += 1


def test_frame_and_numbers_are_of_one_position(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    task = AcquireSettings(darks=0).task("", str(tmp_path))
    recorder = Recorder(task, PLAN, AcquireSettings(darks=0).options())
    camera, view, seen = Camera(recorder), page.panel.setup.view, list[tuple[int, str, float, str]]()

    def drawn() -> None:
        border = next(one for one in view.overlays if isinstance(one, Outline))
        seen.append((int(view.values[0, 0]) - 100, view.shot.caption, border.points[0, 0], view.shot.readout))

    view.changed.connect(drawn)
    page.record.recorder = recorder
    page.record.frame_timer.start()
    camera.thread.start()
    qtbot.waitUntil(lambda: len(seen) > 5 and camera.put > 2 * len(camera.positions), timeout=GUARD_MS)
    camera.enough.set()
    camera.thread.join()
    idle(context.jobs, qtbot)
    page.record.frame_timer.stop()
    page.record.recorder = None
    for number, caption, top, readout in seen:
        where = camera.positions[number]
        peak = (100 + number - 64) / (4095 - 64)
        assert caption == f"plane {where.z}, position y {where.y}, x {where.x}"
        assert top == 20 + number - 10 - 0.5 and f"peak {100 * peak:.0f} % of range" in readout


def test_the_rate_is_that_of_the_last_frames() -> None:
    pace = Pace()
    assert np.isnan(pace.rate) and pace.due_s(0.5) == 1.5
    for k in range(40):
        pace.add(0.1 * k)
    assert pace.rate == pytest.approx(10.0) and pace.due_s(0.5) == 1.5
    pace.add(100.0)
    assert np.isnan(pace.rate), "after a break it begins again"
    pace.add(102.0)
    assert pace.due_s(0.0) == pytest.approx(6.0)


def test_where_no_plane_is_near_it_leads_to_one(live: Page, qtbot: QtBot) -> None:
    panel, station = live.panel.setup, live.setup.station
    qtbot.waitUntil(lambda: not panel.go.isHidden(), timeout=GUARD_MS)
    assert panel.near_words.text().startswith("No plane of the plan is near this depth")
    panel.go.click()
    qtbot.waitUntil(lambda: panel.go.isHidden(), timeout=GUARD_MS)
    depth = float(PLAN.stage.to_object(np.array(station.position()))[2])
    assert np.abs(np.array(PLAN.depths_um) - depth).min() < 1.0
    qtbot.waitUntil(lambda: "correlation" in panel.correlation.text(), timeout=GUARD_MS)


def test_a_camera_that_fails_is_asked_again(live: Page, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    panel, station, said, failing = live.panel.setup, live.setup.station, list[str](), [True]
    monkeypatch.setattr("lfcal_gui.pages.acquire.setup_tab.AGAIN_MS", 1)
    live.context.message.connect(said.append)
    look = station.look

    def failed(*asked: Any) -> Any:
        if failing[0]:
            raise OSError("the cable is loose")
        return look(*asked)

    monkeypatch.setattr(station, "look", failed)
    qtbot.waitUntil(lambda: "the cable is loose" in panel.readout.text(), timeout=GUARD_MS)
    before = panel.view.shot
    failing[0] = False
    qtbot.waitUntil(lambda: panel.view.shot is not before, timeout=GUARD_MS)
    assert len([words for words in said if "cable" in words]) == 1


def find(page: Page, qtbot: QtBot, key: str) -> None:
    page.setup.measuring.find(key)
    qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
    assert key in page.setup.measuring.found


def test_what_is_connected_for_an_earlier_project_begins_nothing(page: Page, context: Context, qtbot: QtBot) -> None:
    begun: list[str] = []
    page.setup.connect_devices(lambda: begun.append("recording"))
    assert page.setup.connecting
    context.project.start(ProjectState(camera=PLAN.camera, plan=replace(PLAN, cutout=(7, 7))))
    qtbot.waitUntil(lambda: not page.setup.connecting, timeout=GUARD_MS)
    assert begun == [] and page.setup.station is None


def test_the_simulated_rig_is_one_click_away(page: Page, qtbot: QtBot, context: Context) -> None:
    own, choose, simulated = page.panel.setup.connect_buttons
    assert own.isHidden() and choose.isVisible() and simulated.isVisible() and page.panel.setup.overlay.isHidden()
    choose.click()
    assert page.panel.devices.head.isChecked() and page.panel.setup.devices.isVisible()
    simulated.click()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    assert AcquireSettings.of(context.state).device_options == (("optics", "pattern"),)
    assert choose.isHidden() and simulated.isHidden()
    page.setup.disconnect_devices()
    page.setup._devices_edited("folder", (), "")
    page.setup.show_controls()
    assert own.isVisible() and choose.isHidden() and simulated.isVisible()
    simulated.click()
    qtbot.waitUntil(lambda: page.setup.station is not None, timeout=GUARD_MS)
    assert AcquireSettings.of(context.state).backend == "sim" and page.setup.station.name == "sim"
    assert own.isHidden() and page.panel.setup.overlay.isVisible()


def test_the_folds_say_how_much_is_done(page: Page, qtbot: QtBot, context: Context) -> None:
    head, panel = page.panel.adjust.head, page.panel
    assert head.words == "0 of 5 done" and panel.devices.head.words == "not connected"
    connect(page, qtbot)
    find(page, qtbot, "stage")
    assert head.words == "1 of 5 done" and panel.devices.head.words == panel.setup.devices.backend.currentText() != ""
    assert panel.recording.head.words == "defaults"
    page.record._field_edited("retries", 1)
    assert panel.recording.head.words == "1 changed"
    other = replace(PLAN, depths_um=PLAN.depths_um[:1], exposure_s=PLAN.exposures[:1])
    context.project.start(ProjectState(camera=other.camera, plan=other))
    assert head.words == "0 of 5 done" and panel.recording.head.words == "defaults"


@pytest.fixture
def live(page: Page, qtbot: QtBot) -> Page:
    """Return the page with the simulator connected, and its first live frame."""
    connect(page, qtbot)
    qtbot.waitUntil(lambda: page.panel.setup.view.values is not None, timeout=GUARD_MS)
    return page


def test_overlays_are_switched_and_the_age_of_a_frame_counts_up_where_none_comes(live: Page, qtbot: QtBot) -> None:
    panel, show_age = live.panel.setup, live.panel.setup.show_age
    live.setup.reserved = True  # no further frame
    idle(live.context.jobs, qtbot)
    assert len(panel.view.overlays) == 2
    panel.overlays["cutout"].setChecked(False)
    assert not panel.view.overlays and panel.arrows.isHidden()
    panel.overlays["axes"].setChecked(True)
    assert panel.arrows.isVisible()
    panel.overlays["lattice"].setChecked(True)
    qtbot.waitUntil(lambda: any(isinstance(one, Symbols) and len(one.points) for one in panel.view.overlays))
    live.setup.moves.follow(False)
    picture = panel._last[0]
    show_age(picture.taken_s + 0.1, picture.stage_um)
    assert panel.view.note == ("0.1 s old", "")
    show_age(picture.taken_s + picture.due_s + 4.0, picture.stage_um)
    assert panel.view.note[0].endswith("s old") and panel.view.note[1] == canvas_fair()


def test_a_simulator_of_another_camera_or_options_is_released(live: Page, context: Context, qtbot: QtBot) -> None:
    optics, station, devices = PLAN.camera.optics, live.setup.station, live.panel.setup.devices
    assert isinstance(optics, MainLens)
    context.project.update("exposure", plan=replace(PLAN, exposure_s=0.03, order="raster"))
    assert live.setup.station is station, "what is set and not described"
    camera = replace(PLAN.camera, optics=replace(optics, f_number=11.0))
    context.project.update("f-number", camera=camera, plan=replace(PLAN, camera=camera))
    assert live.setup.station is None and devices.button.text() == "Connect" and devices.button.isEnabled()
    assert "connect again" in devices.reason.text() and live.panel.setup.view.values is None
    connect(live, qtbot)
    chosen = AcquireSettings.of(context.state)
    options = (*chosen.device_options, ("velocity", "500"))
    context.project.update("choice", settings=replace(chosen, device_options=options).into(context.state))
    assert live.setup.station is None and "than those connected" in devices.reason.text()
    connect(live, qtbot)
    said: list[str] = []
    context.message.connect(said.append)
    live.hide()
    context.project.undo()
    assert live.setup.station is None and said == [], "on another page it is of no use"


def test_devices_at_work_are_released_afterwards(live: Page, context: Context, qtbot: QtBot) -> None:
    live.setup.measuring.find("axis")
    assert not live.setup.free
    changed = replace(PLAN, depths_um=(*PLAN.depths_um, 2 * PLAN.depths_um[-1] - PLAN.depths_um[0]), exposure_s=0.02)
    context.project.update("planes", plan=changed)
    assert live.setup.station is not None
    qtbot.waitUntil(lambda: live.setup.free, timeout=GUARD_MS)
    assert live.setup.station is None and "axis" not in live.setup.measuring.found
    assert "measure again" in live.panel.setup.results["axis"].text()


def test_findings_are_used_for_their_planes_and_project_alone(live: Page, context: Context, qtbot: QtBot) -> None:
    find(live, qtbot, "exposure")
    found, results = live.setup.measuring.found, live.panel.setup.results
    assert context.state.plan.exposures == found["exposure"] != PLAN.exposures
    find(live, qtbot, "stage")
    other = small_plan((3, 4), 5, settle_s=0.0)
    context.project.update("planes", plan=other, camera=other.camera)
    assert "exposure" not in live.setup.measuring.found and results["exposure"].text() == ""
    assert "stage" in live.setup.measuring.found, "the stage moves as it does"
    assert context.state.plan == other
    context.project.start(ProjectState())
    context.project.update("plan", plan=PLAN, camera=PLAN.camera)
    assert live.setup.measuring.found == {} and all(label.text() == "" for label in results.values())


def test_faults_are_added_removed_and_injected_on_screen(page: Page, context: Context, qtbot: QtBot) -> None:
    faults = page.panel.setup.faults

    def stated() -> str:
        return dict(AcquireSettings.of(context.state).device_options).get("faults", "")

    def add(kind: str, at: int, times: int) -> None:
        faults.kind.setCurrentIndex(faults.kind.findData(kind))
        faults.at.setValue(at)
        faults.times.setValue(times)
        faults.add.click()

    add("times out", 5, 2)
    add("lamp low", 3, 1)
    assert stated() == "times out@5*2;lamp low@3" and faults.list.count() == 2
    faults.list.setCurrentRow(0)
    faults.remove.click()
    assert stated() == "lamp low@3"
    context.project.undo()
    assert faults.list.count() == 2, "undo takes a fault back"
    context.project.undo()
    context.project.undo()
    connect(page, qtbot)
    idle(context.jobs, qtbot)
    assert faults.add.isEnabled() and faults.add.text() == "Inject fault" and not faults.list.isEnabled()
    station = page.setup.station
    station.rig.stage.move((1.0, 0.0, 0.0))
    add("move fails", 1, 1)
    assert "move 1 from now" in faults.hint.text() and not stated()
    station.move((2.0, 0.0, 0.0))
    with pytest.raises(StageError, match="move refused because of the simulated fault"):
        station.move((3.0, 0.0, 0.0))
    station.move((4.0, 0.0, 0.0))
    add("too warm", 0, 1)
    assert [gauge.read() for gauge in station.rig.gauges] == [27.0, 100.0]
    assert station.rig.gauges[0].read() == 21.0
    page.setup.disconnect_devices()
    assert faults.add.text() == "Add" and faults.hint.text().startswith("Rehearse faults")


def test_every_fault_has_words_and_only_simulated_devices_have_faults() -> None:
    assert [kind for kind, _ in KINDS] == list(FAULTS) and all(words != kind for kind, words in KINDS)
    assert set(COUNTED) == set(FAULTS)
    assert fault_words(DeviceFault("too warm", 4, 3)) == "reading 4 to 6: the room is too warm (gauge)"
    with pytest.raises(InputError, match="connect the simulator"):
        inject(replace(simulated_rig(PLAN), gauges=()), DeviceFault("too warm", 0))


def test_white_and_dark_frames_are_taken_on_the_page(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    buttons = page.panel.setup.find_buttons
    assert not buttons["white"].isEnabled()
    page.context.project.update("folder", recording=str(tmp_path / "session"))
    connect(page, qtbot)
    for kind in ("white", "dark"):
        buttons[kind].click()
        assert not buttons["white"].isEnabled()
        qtbot.waitUntil(lambda: page.setup.free, timeout=GUARD_MS)
        assert f"8 {kind} frames" in page.panel.setup.results[kind].text()
        assert all(path.is_file() for path in still_files(tmp_path / "session", kind))
