"""One queue: heavy jobs run one after the other, in an order that the user sees and changes."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtWidgets import QApplication, QMessageBox, QPushButton
from pytestqt.qtbot import QtBot

from lfcal.base.progress import Progress
from lfcal_gui.job_panel import JobPanel
from lfcal_gui.jobs import Jobs, JobState, Line, WindowJob
from lfcal_gui.window import MainWindow
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def jobs(qapp: QApplication) -> Iterator[Jobs]:
    made = Jobs()
    yield made
    made.close()


class Gate:
    """Work that goes on until it is opened, and says that it began."""

    def __init__(self, name: str, begun: list[str]) -> None:
        self.name, self._begun, self.open = name, begun, threading.Event()

    def work(self) -> Any:
        self._begun.append(self.name)
        while not self.open.wait(0.001):
            yield Progress(0, 1, "work")
        yield Progress(1, 1, "work", 0.5)


@pytest.fixture
def begun() -> list[str]:
    return []


@pytest.fixture
def gate(begun: list[str]) -> Callable[[str], Gate]:
    return lambda name: Gate(name, begun)


def state_of(jobs: Jobs, number: int) -> JobState:
    return next(job.state for job in jobs.jobs() if job.number == number)


def test_heavy_jobs_run_one_after_the_other(
    jobs: Jobs, qtbot: QtBot, gate: Callable[[str], Gate], begun: list[str]
) -> None:
    gates = [gate(name) for name in "abc"]
    numbers = [jobs.start(one.name, "frames", one.work) for one in gates]
    assert jobs.waiting() == tuple(numbers[1:]) and state_of(jobs, numbers[1]) is JobState.WAITING
    qtbot.waitUntil(lambda: begun == ["a"], timeout=GUARD_MS)
    for one in gates[1:]:
        one.open.set()
    assert jobs.waiting() == tuple(numbers[1:]), "they wait for the first"
    gates[0].open.set()
    idle(jobs, qtbot)
    assert begun == ["a", "b", "c"] and {state_of(jobs, n) for n in numbers} == {JobState.DONE}


def test_what_is_short_or_uses_devices_waits_for_nobody(
    jobs: Jobs, qtbot: QtBot, gate: Callable[[str], Gate], begun: list[str]
) -> None:
    heavy, recording = gate("heavy"), gate("recording")
    jobs.start("heavy", "frames", heavy.work)
    number = jobs.start("recording", "acquire", recording.work, at_once=True)
    qtbot.waitUntil(lambda: set(begun) == {"heavy", "recording"}, timeout=GUARD_MS)
    recording.open.set()
    qtbot.waitUntil(lambda: state_of(jobs, number) is JobState.DONE, timeout=GUARD_MS)
    found: list[int] = []
    jobs.compute("picture", lambda: 7, found.append)
    qtbot.waitUntil(lambda: found == [7], timeout=GUARD_MS)
    heavy.open.set()
    idle(jobs, qtbot)


def test_the_order_is_seen_and_changed(jobs: Jobs, qtbot: QtBot, gate: Callable[[str], Gate], begun: list[str]) -> None:
    panel = JobPanel(jobs)
    qtbot.addWidget(panel)
    panel.show()
    gates = {name: gate(name) for name in "abcd"}
    a, b, c, d = (jobs.start(name, "frames", one.work) for name, one in gates.items())
    assert panel.listed() == [a, b, c, d]
    assert (
        panel.row(b).status.text() == "waiting: next in the queue"
        and panel.row(d).status.text() == "waiting: number 3 in the queue"
    )
    assert [panel.row(n).up.isVisibleTo(panel.row(n)) for n in (a, b, c, d)] == [False, False, True, True]
    assert [panel.row(n).down.isVisibleTo(panel.row(n)) for n in (a, b, c, d)] == [False, True, True, False]
    panel.row(d).up.click()
    panel.row(d).up.click()
    panel.row(b).down.click()
    assert panel.listed() == [a, d, c, b] and panel.row(d).status.text() == "waiting: next in the queue"
    panel.row(c).button.click()
    assert state_of(jobs, c) is JobState.CANCELLED and panel.row(c).status.text() == "stopped"
    assert panel.listed() == [a, d, b, c] and panel.row(c).button.text() == "Dismiss"
    for one in gates.values():
        one.open.set()
    idle(jobs, qtbot)
    assert begun == ["a", "d", "b"], "one that was taken out never begins"
    assert panel.listed() == [d, c, b, a], "those that ended: the newest first"


def test_the_next_begins_whatever_became_of_the_one_before(
    jobs: Jobs, qtbot: QtBot, gate: Callable[[str], Gate], begun: list[str]
) -> None:
    def failing() -> Any:
        yield Progress(0, 1, "fail")
        raise ValueError("x")

    left, after = gate("left"), gate("after")
    jobs.start("failing", "frames", failing)
    number = jobs.start("left", "fit", left.work, leave=True)
    jobs.start("after", "frames", after.work)
    qtbot.waitUntil(lambda: begun == ["left"], timeout=GUARD_MS)
    jobs.cancel(number)
    qtbot.waitUntil(lambda: begun == ["left", "after"], timeout=GUARD_MS)
    left.open.set()
    after.open.set()
    idle(jobs, qtbot)


def test_a_job_whose_file_changed_while_it_waited_says_so(
    jobs: Jobs, qtbot: QtBot, tmp_path: Path, gate: Callable[[str], Gate]
) -> None:
    path, before, ends = tmp_path / "H.h5", gate("before"), list[WindowJob]()
    path.write_text("as it was")
    jobs.finished.connect(ends.append)
    jobs.start("before", "frames", before.work)
    jobs.start("Inspect H.h5", "h", gate("inspect").work, needs=[str(path)])
    jobs.start("Inspect none", "h", gate("none").work, needs=[""])
    path.write_text("another")
    before.open.set()
    qtbot.waitUntil(lambda: len(ends) == 2, timeout=GUARD_MS)
    assert ends[1].error == (
        "H.h5: expected the file as it was when the job was started, got a changed or missing file; start the job again"
    )
    jobs.cancel_all()
    idle(jobs, qtbot)


def test_closing_names_what_runs_and_what_waits_and_begins_nothing(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, gate: Callable[[str], Gate], begun: list[str]
) -> None:
    for name in ("Assemble H.h5", "Simulate S.h5", "Inspect H.h5"):
        window.jobs.start(name, "frames", gate(name).work)
    qtbot.waitUntil(lambda: begun == ["Assemble H.h5"], timeout=GUARD_MS)
    asked: list[str] = []
    buttons = QMessageBox.StandardButton
    monkeypatch.setattr(QMessageBox, "question", lambda *said: (asked.append(said[2]), buttons.Yes)[1])
    assert window.files.may_leave()
    idle(window.jobs, qtbot)
    assert "Running:\nAssemble H.h5\n\nWaiting to start:\nSimulate S.h5\nInspect H.h5\n\nStop them?" in asked[0]
    assert begun == ["Assemble H.h5"]


def test_rows_of_the_queue_are_whole_in_a_small_window(
    window: MainWindow, qtbot: QtBot, gate: Callable[[str], Gate]
) -> None:
    window.resize(1280, 800)
    gates = [gate(f"Assemble H_{k}.h5") for k in range(4)]
    numbers = [window.jobs.start(one.name, "frames", one.work) for one in gates]
    QApplication.processEvents()
    window.job_line.toggle()
    QApplication.processEvents()
    panel = window.job_line.sheet.panel
    for number in numbers:
        shown = [one for one in panel.row(number).findChildren(QPushButton) if one.isVisible()]
        assert shown and all(one.width() >= one.sizeHint().width() and one.accessibleName() for one in shown)
        assert panel.row(number).status.width() >= panel.row(number).status.sizeHint().width()
    for one in gates:
        one.open.set()
    idle(window.jobs, qtbot)


def test_work_in_units_says_which_one_and_how_many_are_done(jobs: Jobs, qtbot: QtBot) -> None:
    open_gate = threading.Event()

    def work() -> Any:
        while not open_gate.wait(0.001):
            yield Progress(2400, 40_000, "assemble plane 2", 1.0, per=1000)

    panel = JobPanel(jobs)
    qtbot.addWidget(panel)
    number = jobs.start("Assemble H.h5", "frames", work)
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    assert panel.row(number).status.text().startswith("assemble plane 2, 2 of 40 done, about ")
    assert "now: assemble plane 2: 2 of 40 done" in jobs.log(number).text()
    open_gate.set()
    idle(jobs, qtbot)


def test_places_in_the_line() -> None:
    line = Line()
    assert line.next() is None and not line.move(1, 1)
    for number in (1, 2, 3):
        line.add(number)
    assert line.next() == 1 and line.next() is None and line.waiting == (2, 3)
    assert line.move(3, -9) and line.waiting == (3, 2) and not line.move(3, -1)
    line.leave(1)
    line.leave(2)
    assert line.next() == 3 and line.waiting == ()
