"""Record > Rig records: chosen, started, paused, stopped, resumed, held by a fault, and seen plane by plane."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QCheckBox, QFileDialog, QWidget
from pytestqt.qtbot import QtBot

from lfcal.acquire import Control, Options, SessionFile, iter_record, record, verify
from lfcal.base import StorageError
from lfcal.camera import preset
from lfcal.psf import open_psf
from lfcal_gui.context import Context
from lfcal_gui.models import ProjectState, Verdict, stamp_of, with_verdict
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.model_folder import folder_state
from lfcal_gui.pages.acquire.model_recorder import picture_of
from lfcal_gui.pages.acquire.page import Page
from lfcal_gui.pages.acquire.step import step
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for
from tests.gui.conftest import OpenPage
from tests.gui.pages.acquire._building import PLAN, connect
from tests.gui.waiting import GUARD_MS, idle


def test_without_a_plan_it_says_what_is_missing(context: Context, open_page: OpenPage) -> None:
    context.project.update("none", plan=None)
    page = open_page("acquire")
    assert "scan plan" in page.empty.label.text()
    went: list[str] = []
    context.go.connect(lambda key, _: went.append(key))
    context.project.update("plan", plan=PLAN)
    assert page.empty is None and went == []


def test_form_and_project_follow_each_other(page: Page, context: Context) -> None:
    form = page.panel.record.form
    darks = form.editor("darks")
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
    assert context.state.plan.order == "raster"
    order.setCurrentIndex(order.findData("coarse"))
    assert AcquireSettings.of(context.state).order == "coarse" and context.state.plan.order == "raster"


def test_a_session_from_start_to_h(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
    """Start, pause, stop, resume, open a plane and assemble: all by the page's own buttons."""
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
    page.record.after.pack()
    qtbot.waitUntil(lambda: not context.jobs.running_pages(), timeout=GUARD_MS)
    assert folder_state(str(folder)).complete


def test_an_automatic_camera_records_once_allowed(page: Page, context: Context, qtbot: QtBot, tmp_path: Path) -> None:
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


def test_a_lens_is_covered_by_hand_or_dark_frames_are_skipped(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    record, cover = page.panel.record, page.panel.record.form.editor("cover")
    cover.setChecked(True)
    page.record._field_edited("darks", 1)
    assert "--cover" in step(page.context.state).arguments
    connect(page, qtbot)
    page.setup.station.rig = replace(page.setup.station.rig, light=None)
    seen = list[tuple[str, bool]]()
    page.context.attention.connect(lambda *found: seen.append(found))

    def answer(begins: str, button: str) -> None:
        qtbot.waitUntil(
            lambda: page.notice.label.text().startswith(begins) and page.notice.isVisible(), timeout=GUARD_MS
        )
        assert seen[-1] == ("acquire", True) and record.status.text() == page.notice.label.text()
        qtbot.mouseClick(getattr(page.notice, button), Qt.MouseButton.LeftButton)

    def begin(name: str) -> Path:
        page.context.project.update("folder", recording=str(tmp_path / name))
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
    page.context.jobs.cancel(page.record._job)
    ended()


def test_a_dropped_session_that_is_damaged_is_refused(page: Page, tmp_path: Path, qtbot: QtBot) -> None:
    assert not page.accept_drop([str(tmp_path)])
    (tmp_path / "session.json").write_text("{}")
    assert page.accept_drop([str(tmp_path)])
    qtbot.waitUntil(lambda: "session.json" in page.panel.record.detail.text(), timeout=GUARD_MS)
    assert page.context.state.recording == "", "the folder before stays"


def test_folder_and_file_are_asked(
    page: Page, context: Context, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot
) -> None:
    asked: list[QWidget] = []

    def answer(parent: QWidget, *_: Any) -> str:
        asked.append(parent)
        return ""

    monkeypatch.setattr(QFileDialog, "getExistingDirectory", answer)
    monkeypatch.setattr(QFileDialog, "getSaveFileName", lambda *a: (answer(*a), ""))
    page.record.start()
    assert len(asked) == 1 and not page.record.recording, "no folder chosen: nothing begins"
    page.panel.record.folder_asked.emit()
    page.record.after.assemble()
    assert len(asked) == 3 and all(isinstance(one, QWidget) for one in asked) and context.state.recording == ""
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
    tab, seen = recording.record, list[tuple[str, bool]]()
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


@pytest.mark.parametrize("dock", [False, True])
def test_what_a_recording_is_asked_to_do_is_said_at_once(recording: Page, qtbot: QtBot, dock: bool) -> None:
    panel, recorder = recording.panel.record, recording.record.recorder
    assert panel.status.text().startswith("Pausing") or recorder.control.held
    qtbot.waitUntil(lambda: recorder.control.held == "paused", timeout=GUARD_MS)
    qtbot.waitUntil(lambda: panel.detail.text() == "paused", timeout=GUARD_MS)
    if dock:
        recording.context.jobs.cancel(recording.record._job)
    else:
        panel.buttons["stop"].click()
        assert not panel.buttons["stop"].isEnabled()
    assert panel.status.text().startswith("Stopping")
    qtbot.waitUntil(lambda: not recording.record.recording, timeout=GUARD_MS)
    assert dock or panel.status.text().startswith("Stopped")


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


def click(page: Page, z: int, qtbot: QtBot) -> None:
    strip = page.panel.record.strip
    where = strip.visualItemRect(strip.item(z)).center()
    qtbot.mouseClick(strip.viewport(), Qt.MouseButton.LeftButton, pos=where)


def test_planes_fill_while_they_are_recorded(quick: Page, qtbot: QtBot, context: Context, tmp_path: Path) -> None:
    page = quick
    context.project.update("folder", recording=str(tmp_path / "s"))
    connect(page, qtbot)
    page.record.start()
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    recorder, panel = page.record.recorder, page.panel.record
    qtbot.waitUntil(lambda: recorder.taken > 14 or not page.record.recording, timeout=GUARD_MS)
    page.record.pause()
    qtbot.waitUntil(lambda: recorder.control.held == "paused" or not page.record.recording, timeout=GUARD_MS)
    qtbot.waitUntil(lambda: panel.strip.tiles[0].word == "recorded", timeout=GUARD_MS)
    if page.record.recording:
        done = recorder.taken - 12
        qtbot.waitUntil(lambda: panel.strip.tiles[1].word == f"{100 * done / 12:.0f} %", timeout=GUARD_MS)
        assert panel.strip.tiles[1].progress == pytest.approx(done / 12) and panel.z == 1
        assert panel.map_box.isVisible() and panel.map_words.text().startswith("within")
        panel.strip.setCurrentRow(0)
        page.record._poll_frame()
        assert panel.z == 0, "the plane that was chosen stays"
        panel.strip.setCurrentRow(1)
        page.record.pause()
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    assert [one.word for one in panel.strip.tiles] == ["recorded", "recorded"]
    assert panel.strip.tiles[1].image is not None and panel.strip.tiles[1].progress is None
    state = context.state
    stamp = stamp_of(state.psf)
    assert stamp is not None and panel.strip.tiles[0].merit == ""
    verdict = Verdict("bad", "One position is bad.", 1, 0.04, "good", 1, 39, ((1, 0, 0),))
    context.project.update("verdict", settings=with_verdict(state, stamp, verdict))
    idle(context.jobs, qtbot)
    page.record.refresh()
    idle(context.jobs, qtbot)
    assert [one.merit for one in panel.strip.tiles] == ["good", "bad"]


def test_a_recording_holds_in_the_window_and_continues_automatically(quick: Page, qtbot: QtBot, tmp_path: Path) -> None:
    page = quick
    settings = AcquireSettings.of(quick.context.state)
    assert page.record._check_field("suspend", "temperature") != "", "what says no bounds is refused"
    changed, _ = settings.changed_on(PLAN, "suspend", "temperature=20:22")
    options = (*changed.device_options, ("faults", "too warm@1*4"))
    changed = AcquireSettings.from_dict(changed.to_dict() | {"device_options": options, "steady": 2.0})
    quick.context.project.update("try", settings=changed.into(quick.context.state), recording=str(tmp_path / "session"))
    idle(quick.context.jobs, qtbot)
    told: list[str] = []
    page.panel.record.pressed.emit("start")
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    quick.context.jobs.changed.connect(lambda job: told.append(job.progress.note) if job.progress else None)
    qtbot.waitUntil(lambda: not page.record.recording, timeout=GUARD_MS)
    idle(quick.context.jobs, qtbot)
    assert any("outside 20 to 22" in words for words in told), "why it holds is shown"
    assert page.record.folder.complete


HOLDER = """
import sys
from pathlib import Path
from lfcal.acquire.recording.durable import FolderLock
lock = FolderLock(Path(sys.argv[1]))
print("ready", flush=True)
sys.stdin.read()
"""


@contextmanager
def held(folder: Path) -> Iterator[int]:
    """Let another process hold a session folder, as ``lfcal acquire`` does; yield its number."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout.readline() == "ready\n"
        yield child.pid
        child.communicate("")


def begun(folder: Path, count: int = 7) -> None:
    control = Control()
    for seen in iter_record(folder, PLAN, rig_for(PLAN), CAREFUL, control=control):
        if seen.stage == "record" and seen.done >= count:
            control.stop()


def looked_at(page: Page, context: Context, qtbot: QtBot, folder: Path) -> Page:
    """Let the page look at a session that was begun."""
    begun(folder)
    context.project.update("folder", recording=str(folder))
    page.panel.setCurrentWidget(page.panel.record)
    qtbot.waitUntil(lambda: page.record.folder.there is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    return page


def test_the_command_is_refused_while_the_window_records(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    looked_at(page, page.context, qtbot, folder)
    page.record.start()
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    page.record.pause()
    recorder = page.record.recorder
    qtbot.waitUntil(lambda: recorder.control.held == "paused", timeout=GUARD_MS)
    with pytest.raises(StorageError, match=rf"another program \(process {os.getpid()}\); end the other"):
        record(folder, PLAN, rig_for(PLAN), None, resume=True)
    page.record.pause()
    completed(page, qtbot, folder)


def test_what_the_command_recorded_meanwhile_is_shown(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    looked_at(page, page.context, qtbot, tmp_path / "s")
    there = page.record.folder.there
    assert 0 < there.sum() < 24
    assert record(tmp_path / "s", PLAN, rig_for(PLAN), None, resume=True).how == "complete"
    page.entered()
    qtbot.waitUntil(lambda: page.record.folder.complete, timeout=GUARD_MS)
    assert not page.panel.record.buttons["start"].isEnabled()


@pytest.fixture
def quick(page: Page, context: Context, qtbot: QtBot) -> Page:
    """Return the page for a recording of positions alone."""
    chosen = replace(AcquireSettings.of(context.state), darks=0, reference_every=0)
    context.project.update("quick", settings=chosen.into(context.state))
    idle(context.jobs, qtbot)
    return page


def test_a_fault_stops_safely_and_another_project_shows_nothing_of_it(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    page.setup._devices_edited("sim", (("faults", "vanishes@42"),), "")
    connect(page, qtbot)
    exposure, seen, panel = page.panel.setup.exposure, set[tuple[bool, bool]](), page.panel.record
    assert not exposure.isHidden()
    page.context.jobs.changed.connect(lambda _: seen.add((page.record.recording, exposure.isHidden())))
    page.context.project.update("folder", recording=str(tmp_path / "s"))
    page.record.start()
    qtbot.waitUntil(lambda: "fault" in panel.status.text(), timeout=GUARD_MS)
    assert (True, True) in seen and (True, False) not in seen, "recorded frames have the exposures of the plan"
    qtbot.waitUntil(lambda: page.record.folder.there is not None, timeout=GUARD_MS)
    # still shown after the folder was read, together with the next action
    assert "resume" in panel.detail.text()
    there = page.record.folder.there
    assert 0 < there.sum() < 24
    qtbot.waitUntil(lambda: panel.buttons["assemble"].isEnabled(), timeout=GUARD_MS)
    marked = list[tuple[str, bool]]()
    page.context.attention.connect(lambda *found: marked.append(found))
    page.context.project.start(ProjectState())
    page.context.project.update("plan", plan=PLAN, camera=PLAN.camera)
    idle(page.context.jobs, qtbot)
    assert panel.progress.isHidden() and marked[-1] == ("acquire", False)
    assert {label.text() for label in (panel.status, panel.detail, panel.folder_words)} == {""}
    assert panel.buttons["start"].text() == "Start" and not panel.buttons["assemble"].isEnabled()
    assert page.panel.setup.view.item.image is None


def completed(page: Page, qtbot: QtBot, folder: Path) -> None:
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    report = verify(folder)
    assert report.ok and not report.never_taken and len(frames_of(folder)) == 24


def test_the_window_names_who_records_and_continues_afterwards(page: Page, qtbot: QtBot, tmp_path: Path) -> None:
    folder = tmp_path / "s"
    looked_at(page, page.context, qtbot, folder)
    before = frames_of(folder)
    with held(folder) as process:
        page.record.start()
        words = f"open in another program (process {process})"
        panel = page.panel.record
        qtbot.waitUntil(lambda: words in panel.status.text() + panel.detail.text(), timeout=GUARD_MS)
        assert not page.record.recording
        assert_same_frames(frames_of(folder), before)
    page.record.start()
    completed(page, qtbot, folder)


def test_settings_without_effect_are_hidden(
    page: Page, context: Context, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot
) -> None:
    form, extent = page.panel.record.form, page.panel.record.extent
    form.open()
    hidden = {key: form.editor(key) for key in ("allow_automatic", "steady", "cover", "unknowns")}
    connect(page, qtbot)
    assert all(editor.isHidden() for editor in hidden.values())
    page.record._field_edited("suspend", "temperature=20:22")
    assert not hidden["steady"].isHidden()
    editor = form.editor("positions")
    monkeypatch.setattr(QFileDialog, "getOpenFileName", lambda *_: ("half.json", ""))
    (browse,) = editor.actions()
    browse.trigger()
    assert AcquireSettings.of(context.state).positions == editor.text() == "half.json"
    extent.setCurrentIndex(1)
    assert editor.isHidden() and not hidden["unknowns"].isHidden()


def test_a_click_on_a_plane_moves_the_stage_there(quick: Page, qtbot: QtBot) -> None:
    page, panel = quick, quick.panel.record
    tiles = panel.strip.tiles
    assert [one.depth_um for one in tiles] == list(PLAN.depths_um) and panel.map_box.isHidden()
    assert all(one.shape == PLAN.cutout and one.image is None and one.word == "" for one in tiles)
    assert any(one.expected is not None for one in tiles)
    click(page, 1, qtbot)
    assert panel.z == 1 == page.panel.setup.z, "without a rig it is looked at"
    connect(page, qtbot)
    station = page.setup.station
    for z in (0, 1):
        click(page, z, qtbot)
        wanted = PLAN.stage_um(np.array([z, PLAN.period[0] // 2, PLAN.period[1] // 2]))
        qtbot.waitUntil(lambda wanted=wanted: np.allclose(station.position(), wanted, atol=0.5), timeout=GUARD_MS)
    qtbot.keyClick(panel.strip, Qt.Key.Key_Left)
    qtbot.waitUntil(lambda: not page.setup.moves.moving, timeout=GUARD_MS)
    assert panel.z == 0 and np.allclose(station.position(), wanted, atol=0.5), "keys only look"
