"""Jobs in the status bar and their sheet: a row for each job, its log, and room for more than one."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QPoint, QRect
from PySide6.QtWidgets import QApplication, QPushButton
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress
from lfcal_gui.job_panel import JobPanel
from lfcal_gui.jobs import Jobs
from lfcal_gui.models.history import Taken
from lfcal_gui.models.step import CommandStep
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS


@pytest.fixture
def jobs(qapp: QApplication) -> Iterator[Jobs]:
    made = Jobs()
    yield made
    made.close()


class Made:
    """What a job returns."""

    notes = ("12 positions are missing",)


def working(*, warn: bool = True) -> Any:
    yield Progress(0, 2, "read", 0.1)
    yield Progress(2, 2, "read", 0.2)
    if warn:
        warnings.warn("mean of empty slice", RuntimeWarning, stacklevel=1)
    yield Progress(1, 1, "write", 0.5)
    return Made()


def failing() -> Any:
    yield Progress(0, 2, "read", 0.1)
    raise InputError("frames: expected light, got none; switch the lamp on")


def test_a_job_s_log_is_read_copied_and_saved(jobs: Jobs, qtbot: QtBot, tmp_path: Path) -> None:
    panel = JobPanel(jobs)
    qtbot.addWidget(panel)
    taken = Taken("frames", "Assemble", CommandStep(("assemble", "frames"), ""), "H.h5")
    with pytest.warns(RuntimeWarning, match="mean of empty slice"):
        number = jobs.start("Assemble H.h5", "frames", working, taken=taken)
        qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
    row = panel.row(number)
    assert row.status.text() == "done in 500 ms, 1 warning: see its log"
    view = row.show_log()
    qtbot.addWidget(view)
    text = view.view.toPlainText()
    assert not view.view.horizontalScrollBar().isVisible(), "as wide as its lines"
    for words in (
        "command  lfcal assemble frames",
        "stage    read: 2 of 2 in ",
        "warning  RuntimeWarning: mean of empty slice",
        "note     12 positions are missing",
        "wrote    H.h5",
        "end      done in 500 ms",
    ):
        assert words in text
    view.copy.click()
    assert QApplication.clipboard().text() == jobs.log(number).text()
    view.save(str(tmp_path / "log.txt"))
    assert (tmp_path / "log.txt").read_text(encoding="utf-8") == jobs.log(number).text()
    assert row.show_log() is view


def test_a_job_of_several_clocks_took_as_long_as_all_of_them(jobs: Jobs, qtbot: QtBot) -> None:
    """An inspection, whose last part is a moment, was done in microseconds."""

    def parts() -> Any:
        yield Progress(1, 2, "compare", 1.0)
        yield Progress(2, 2, "compare", 2.0)
        yield Progress(1, 1, "judge", 0.0)
        yield Progress(1, 1, "judge", 0.5)

    panel = JobPanel(jobs)
    qtbot.addWidget(panel)
    number = jobs.start("Inspect H.h5", "h", parts)
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
    assert panel.row(number).status.text() == "done in 2.5 s"


def test_a_log_grows_while_it_is_read_and_tells_of_stopping(jobs: Jobs, qtbot: QtBot) -> None:
    go_on = threading.Event()

    def slow() -> Any:
        yield Progress(3, 9, "solve", 1.0, "residual 0.5")
        go_on.wait(GUARD_MS / 1e3)
        yield Progress(4, 9, "solve", 2.0, "residual 0.4")

    panel = JobPanel(jobs)
    qtbot.addWidget(panel)
    number = jobs.start("Reconstruct", "reconstruct", slow)
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    view = panel.row(number).show_log()
    qtbot.addWidget(view)
    assert "residual 0.5" in view.view.toPlainText() and "now: solve: 3 of 9" in view.view.toPlainText()
    jobs.cancel(number)
    jobs.cancel(number)
    go_on.set()
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
    view.refresh()
    text = view.view.toPlainText()
    assert text.count("stop requested") == 1 and "end      stopped after 1.0 s" in text and "now:" not in text


def test_the_trace_of_a_failure_is_in_its_log(jobs: Jobs, qtbot: QtBot) -> None:
    panel = JobPanel(jobs)
    qtbot.addWidget(panel)
    number = jobs.start("Failing", "h", failing)
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
    row = panel.row(number)
    assert row.error.text() == "frames: expected light, got none; switch the lamp on"
    text = jobs.log(number).text()
    assert f"end      failed: {row.error.text()}" in text and "trace    Traceback" in text
    row.button.click()
    assert not panel.isAncestorOf(row), "dismissed"


def test_two_jobs_are_seen_whole_in_a_small_window(window: MainWindow, qtbot: QtBot) -> None:
    """Of the second job a strip was seen: the button below took the room."""
    window.resize(1280, 800)
    for name in ("Assemble H.h5", "Inspect H.h5"):
        window.jobs.start(name, "frames", lambda: working(warn=False))
    qtbot.waitUntil(lambda: not window.jobs.busy, timeout=GUARD_MS)
    QApplication.processEvents()
    window.job_line.toggle()
    QApplication.processEvents()
    panel = window.job_line.sheet.panel
    port = panel.area.viewport()
    seen = QRect(port.mapToGlobal(QPoint(0, 0)), port.size())
    for number in (1, 2):
        row = panel.row(number)
        assert seen.contains(QRect(row.mapToGlobal(QPoint(0, 0)), row.size()))
        for button in row.findChildren(QPushButton):
            assert button.width() >= button.sizeHint().width() and button.accessibleName()
