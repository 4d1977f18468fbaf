"""A run in units, watched in the Jobs dock: the table of ``lfcal status``."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtWidgets import QApplication, QPushButton
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.work.journal import HEADER, JOURNAL, read_run, run_table
from lfcal_gui.job_panel import JobPanel, look
from lfcal_gui.jobs import Jobs
from tests.gui.waiting import GUARD_MS


@pytest.fixture
def jobs(qapp: QApplication) -> Iterator[Jobs]:
    jobs = Jobs()
    yield jobs
    jobs.close()


def journal(folder: Path, *lines: dict[str, object], place: str = "") -> None:
    folder.mkdir(exist_ok=True)
    units = ["plane 0", "plane 1", "plane 2"]
    here = {"process": os.getpid(), "host": socket.gethostname()}
    begin = {"at": 0, "event": "begin", "title": "simulate H.h5", "units": units, "executor": "dask", "workers": 2}
    said = [{**begin, "place": place, **here}, *lines]
    (folder / JOURNAL).write_text("".join(json.dumps(line) + "\n" for line in said))


STARTED = {"at": 1, "event": "started", "unit": "plane 0", "worker": "tcp://a:1"}
DONE = {"at": 37, "event": "done", "unit": "plane 0", "seconds": 36.0}
NEXT = {"at": 38, "event": "started", "unit": "plane 1", "worker": "tcp://a:1"}


def test_the_dock_shows_what_status_shows(jobs: Jobs, qtbot: QtBot, tmp_path: Path) -> None:
    folder = tmp_path / "H.h5.parts"
    journal(folder, STARTED, DONE, NEXT, place="http://127.0.0.1:8787/status")
    panel = JobPanel(jobs)
    view = panel.watch(folder)
    qtbot.waitUntil(lambda: view.table.rowCount() == 3, timeout=GUARD_MS)
    found = run_table(read_run(folder))
    assert view.title.text() == found.headline
    assert found.headline == "simulate H.h5: 1 of 3 units done; dask, 2 at work"
    assert found.pace == "1 under way, 200 units an hour, about 36 s left" and view.status.text() == found.pace
    assert "http://127.0.0.1:8787/status" in view.place.text() and not view.place.isHidden()
    assert [view.table.horizontalHeaderItem(k).text() for k in range(len(HEADER))] == list(HEADER)
    assert panel.isAncestorOf(view)
    assert [view.table.item(0, k).text() for k in (0, 1, 4)] == ["plane 0", "done", "tcp://a:1"]


def test_a_run_that_ends_is_told(jobs: Jobs, qtbot: QtBot, tmp_path: Path) -> None:
    folder = tmp_path / "H.h5.parts"
    journal(folder, STARTED)
    panel = JobPanel(jobs)
    view = panel.watch(tmp_path / "H.h5")
    qtbot.waitUntil(lambda: "0 of 3" in view.title.text(), timeout=GUARD_MS)
    (folder / JOURNAL).unlink()
    folder.rmdir()
    (tmp_path / "H.h5").write_bytes(b"")
    view.refresh()
    qtbot.waitUntil(lambda: "complete" in view.title.text(), timeout=GUARD_MS)
    assert view.table.isHidden() and view.place.isHidden()


def test_no_run_is_a_line(jobs: Jobs, qtbot: QtBot, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="name the output file of the run"):
        look(tmp_path / "H.h5")
    with pytest.raises(InputError, match="the folder of a run"):
        look(Path("/"))
    panel = JobPanel(jobs)
    view = panel.watch(tmp_path / "H.h5")
    qtbot.waitUntil(lambda: "name the output file of the run" in view.status.text(), timeout=GUARD_MS)


def test_a_view_that_is_dismissed_hears_nothing_more(jobs: Jobs, qtbot: QtBot, tmp_path: Path) -> None:
    panel = JobPanel(jobs)
    view = panel.watch(tmp_path / "H.h5")
    button = view.findChild(QPushButton)
    assert button is not None
    button.click()
    assert not panel.isAncestorOf(view)
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
