"""The window and the command line on one session: the holder is named, nothing is overwritten, changes are shown."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from pytestqt.qtbot import QtBot

from lfcal.acquire import verify
from lfcal.acquire.control import Control
from lfcal.acquire.session import iter_record, record
from lfcal.base.errors import StorageError
from lfcal_gui.context import Context
from lfcal_gui.models.project import ProjectState
from lfcal_gui.pages.acquire.model import AcquireSettings
from lfcal_gui.pages.acquire.page import Page
from tests.acquire.rigs import CAREFUL, assert_same_frames, frames_of, rig_for, small_plan
from tests.gui.conftest import OpenPage
from tests.gui.waiting import GUARD_MS, idle

PLAN = small_plan((3, 4), 2, settle_s=0.0)

HOLDER = """
import sys
from pathlib import Path
from lfcal.acquire.recording.durable import FolderLock
lock = FolderLock(Path(sys.argv[1]))
print("ready", flush=True)
sys.stdin.read()
"""


@pytest.fixture
def state() -> ProjectState:
    settings = AcquireSettings(device_options=(("optics", "pattern"),), darks=0, reference_every=0)
    return ProjectState(camera=PLAN.camera, plan=PLAN, settings={"acquire": settings.to_dict()})


@contextmanager
def held(folder: Path) -> Iterator[int]:
    """Let another process hold a session folder, as ``lfcal acquire`` does; yield its number."""
    with subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None and child.stdout.readline() == "ready\n"
        yield child.pid
        child.communicate("")


def begun(folder: Path, count: int = 7) -> None:
    control = Control()
    for step in iter_record(folder, PLAN, rig_for(PLAN), CAREFUL, control=control):
        if step.stage == "record" and step.done >= count:
            control.stop()


def shown(open_page: OpenPage, context: Context, qtbot: QtBot, folder: Path) -> Page:
    page: Page = open_page("acquire")
    page.entered()
    context.project.update("folder", recording=str(folder))
    page.panel.setCurrentWidget(page.panel.record)
    qtbot.waitUntil(lambda: page.record.folder.there is not None, timeout=GUARD_MS)
    idle(context.jobs, qtbot)
    return page


def test_the_window_names_who_records_and_goes_on_afterwards(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    folder = tmp_path / "s"
    begun(folder)
    before = frames_of(folder)
    page = shown(open_page, context, qtbot, folder)
    with held(folder) as process:
        page.record.start()
        words = f"open in another program (process {process})"
        panel = page.panel.record
        qtbot.waitUntil(lambda: words in panel.status.text() + panel.detail.text(), timeout=GUARD_MS)
        assert not page.record.recording
        assert_same_frames(frames_of(folder), before)
    page.record.start()
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    assert len(frames_of(folder)) == 24


def test_the_command_is_refused_while_the_window_records(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    folder = tmp_path / "s"
    begun(folder)
    page = shown(open_page, context, qtbot, folder)
    page.record.start()
    qtbot.waitUntil(lambda: page.record.recording, timeout=GUARD_MS)
    page.record.pause()
    recorder = page.record.recorder
    assert recorder is not None
    qtbot.waitUntil(lambda: recorder.control.held == "paused", timeout=GUARD_MS)
    with pytest.raises(StorageError, match=rf"another program \(process {os.getpid()}\); end the other"):
        record(folder, PLAN, rig_for(PLAN), None, resume=True)
    page.record.pause()
    qtbot.waitUntil(lambda: page.record.folder.complete and not page.record.recording, timeout=GUARD_MS)
    report = verify(folder)
    assert report.ok and not report.never_taken and len(frames_of(folder)) == 24


def test_what_the_command_recorded_meanwhile_is_shown(
    open_page: OpenPage, context: Context, qtbot: QtBot, tmp_path: Path
) -> None:
    folder = tmp_path / "s"
    begun(folder)
    page = shown(open_page, context, qtbot, folder)
    there = page.record.folder.there
    assert there is not None and 0 < there.sum() < 24
    assert record(folder, PLAN, rig_for(PLAN), None, resume=True).how == "complete"
    page.entered()
    qtbot.waitUntil(lambda: page.record.folder.complete, timeout=GUARD_MS)
    assert not page.panel.record.buttons["start"].isEnabled()
