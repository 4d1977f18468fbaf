"""Jobs: they report, stop and wait in one queue; the sheet of jobs shows each with its log."""

from __future__ import annotations

import gc
import json
import os
import socket
import threading
import time
import warnings
import weakref
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QPoint, QRect
from PySide6.QtWidgets import QApplication, QMessageBox, QPushButton
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, Work, raise_if_abandoned
from lfcal.work.journal import HEADER, JOURNAL, read_run, run_table
from lfcal_gui.job_panel import JobPanel, look
from lfcal_gui.jobs import JOBS_S, LOADS_S, Jobs, JobState, Line, WindowJob
from lfcal_gui.models.history import Taken
from lfcal_gui.models.step import CommandStep
from lfcal_gui.window import MainWindow
from lfcal_gui.workers import words_of
from tests.gui.waiting import GUARD_MS, idle


def counting(n: int, cleaned: list[str]) -> Work[str]:
    try:
        for k in range(n):
            yield Progress(k, n, "count", 0.1)
            time.sleep(0.002)
        return "result"
    finally:
        cleaned.append("cleaned")


def test_a_job_reports_in_the_thread_of_the_window_and_can_be_stopped(jobs: Jobs, qtbot: QtBot) -> None:
    seen: list[tuple[WindowJob, threading.Thread]] = []
    results, cleaned, ended = list[str](), list[str](), threading.Event()
    jobs.changed.connect(lambda job: seen.append((job, threading.current_thread())))
    with qtbot.waitSignal(jobs.finished, timeout=GUARD_MS):
        jobs.start("Counting", "h", lambda: counting(50, cleaned), results.append)
    assert results == ["result"] and cleaned == ["cleaned"]
    assert {thread for _, thread in seen} == {threading.current_thread()}
    states = [job.state for job, _ in seen]
    assert states[0] is JobState.WAITING and states[-1] is JobState.DONE and jobs.running_pages() == set()
    with qtbot.waitSignal(jobs.finished, timeout=GUARD_MS) as end:
        number = jobs.start("Counting", "h", lambda: counting(100_000, cleaned))
        assert jobs.running_pages() == {"h"}
        qtbot.waitUntil(lambda: jobs.jobs()[0].state is JobState.RUNNING, timeout=GUARD_MS)
        jobs.cancel(number)
    assert end.args[0].state is JobState.CANCELLED and cleaned == ["cleaned"] * 2

    def short() -> Work[None]:
        yield Progress(0, 1, "short", 4e-6)
        yield Progress(1, 1, "short", 0.25)
        ended.set()

    with qtbot.waitSignal(jobs.finished, timeout=GUARD_MS) as end:
        jobs.start("Short", "h", short)
        ended.wait(GUARD_MS / 1e3)  # the window looks at its records only afterwards
    assert end.args[0].progress.seconds == 0.25


def test_only_the_newest_computation_of_a_group_reports(jobs: Jobs, qtbot: QtBot) -> None:
    shown, calls, all_asked = list[int](), list[int](), threading.Event()

    def work(k: int) -> int:
        calls.append(k)
        all_asked.wait()
        return k

    for k in range(40):
        jobs.compute("scrub", lambda k=k: work(k), shown.append)
    all_asked.set()
    qtbot.waitUntil(lambda: shown[-1:] == [39], timeout=GUARD_MS)
    assert len(calls) <= 4, "stale requests are dropped, not computed"
    assert shown == [39]


def test_errors_of_computations_are_reported(jobs: Jobs, qtbot: QtBot) -> None:
    words: list[str] = []
    jobs.compute("x", lambda: 1 / 0, lambda _: None, words.append)
    qtbot.waitUntil(lambda: bool(words), timeout=GUARD_MS)
    assert words == ["ZeroDivisionError: division by zero"]


def test_replaced_computations_and_left_jobs_stop_computing(jobs: Jobs, qtbot: QtBot) -> None:
    """Estimates for a large camera, and a search that was stopped, used a processor for minutes."""
    begun, asked, inside = threading.Event(), threading.Event(), threading.Event()
    shown: list[str] = []

    def endless() -> str:
        begun.set()
        asked.wait(GUARD_MS / 1e3)
        while True:
            raise_if_abandoned()

    jobs.compute("estimates", endless, shown.append, shown.append)
    assert begun.wait(GUARD_MS / 1e3)
    jobs.compute("estimates", lambda: "of another camera", shown.append, shown.append)
    asked.set()
    qtbot.waitUntil(lambda: bool(shown) and not jobs.busy, timeout=GUARD_MS)
    assert shown == ["of another camera"]

    def search() -> Work[None]:
        yield Progress(0, 1, "search")
        inside.set()
        while True:
            raise_if_abandoned()

    number = jobs.start("Search", "multiplex", search, leave=True)
    qtbot.waitUntil(inside.is_set, timeout=GUARD_MS)
    thread = next(one for one in threading.enumerate() if one.name == f"lfcal-job-{number}")
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    jobs.cancel(number)
    thread.join(GUARD_MS / 1e3)
    assert not thread.is_alive()


class Slow:
    """Work that yields a record, waits until it may continue, and yields another."""

    def __init__(self) -> None:
        self.inside, self.go_on, self.cleaned = threading.Event(), threading.Event(), list[str]()

    def work(self) -> Work[str]:
        try:
            yield Progress(3, 9, "solve", 1.0, "residual 0.5")
            self.inside.set()
            self.go_on.wait(GUARD_MS / 1e3)
            yield Progress(4, 9, "solve", 2.0, "residual 0.4")
            return "result"
        finally:
            self.cleaned.append("cleaned")


def test_a_job_that_may_be_left_is_stopped_immediately(jobs: Jobs, qtbot: QtBot) -> None:
    """A job that writes nothing may compute until its next record; its result is not reported."""
    slow, results = Slow(), list[str]()
    number = jobs.start("Slow", "fit", slow.work, results.append, leave=True)
    qtbot.waitUntil(slow.inside.is_set, timeout=GUARD_MS)
    thread = next(one for one in threading.enumerate() if one.name == f"lfcal-job-{number}")
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    jobs.cancel(number)
    assert jobs.jobs()[0].state is JobState.CANCELLED and not jobs.busy and not slow.cleaned
    slow.go_on.set()
    thread.join(GUARD_MS / 1e3)
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
    assert slow.cleaned == ["cleaned"] and not results and jobs.jobs()[0].state is JobState.CANCELLED


def test_closing_stops_everything(qapp: QApplication, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> None:
    cleaned, late, slow = list[str](), list[Any](), Slow()
    made = Jobs()
    made.start("Long", "h", lambda: counting(100_000, cleaned), late.append)
    made.compute("slow", lambda: time.sleep(0.05), late.append)
    made.close()
    assert cleaned == ["cleaned"] and late == []
    made.compute("after", lambda: late.append("ran"), late.append)
    assert late == []
    # a job that may be left has no file to complete, so that the window waits for it as for a file that is opened
    waits: list[tuple[list[str], float]] = []
    monkeypatch.setattr("lfcal_gui.jobs.wait_for", lambda threads, s: waits.append(([one.name for one in threads], s)))
    made = Jobs()
    number = made.start("Slow", "fit", slow.work, leave=True)
    qtbot.waitUntil(slow.inside.is_set, timeout=GUARD_MS)
    made.close()
    slow.go_on.set()
    assert waits == [([], JOBS_S), ([f"lfcal-job-{number}"], LOADS_S)]


class Result:
    notes = ("12 positions are missing",)


def test_the_window_does_not_keep_the_result_of_a_job(window: MainWindow, qtbot: QtBot) -> None:
    """The row in the sheet kept every result, and the last record of a reconstruction its volume."""

    @dataclass(frozen=True, slots=True)
    class Record(Progress):
        state: Any = None

    seen: list[weakref.ref[Result]] = []
    reported: list[bool] = []

    def made() -> Result:
        one = Result()
        seen.append(weakref.ref(one))
        return one

    def work() -> Work[Result]:
        yield Record(1, 2, "solve", 3.0, state=made())
        return made()

    window.jobs.finished.connect(lambda job: reported.append(job.result is seen[-1]()))
    window.jobs.start("Reconstruct", "reconstruct", work)
    idle(window.jobs, qtbot)
    job = window.jobs.jobs()[0]
    assert reported == [True] and job.result is None
    assert job.progress == Progress(1, 2, "solve", 3.0) and job.ended_words() == "done in 3.0 s"

    def freed() -> bool:
        gc.collect()
        return all(one() is None for one in seen)

    qtbot.waitUntil(freed, timeout=GUARD_MS)
    assert len(seen) == 2


def test_a_failing_callback_does_not_keep_its_job_running(jobs: Jobs, qtbot: QtBot) -> None:
    ended: list[WindowJob] = []
    jobs.finished.connect(ended.append)
    with qtbot.capture_exceptions() as caught:
        jobs.start("Work", "h", lambda: counting(1, []), lambda _: {}["missing"])
        qtbot.waitUntil(lambda: bool(ended), timeout=GUARD_MS)
    assert caught[0][0] is KeyError and not jobs.busy


def test_an_error_of_the_system_names_the_file_and_a_remedy() -> None:
    """The window showed "NotADirectoryError: [Errno 20] …" with no remedy."""
    for error, words in (
        (NotADirectoryError(20, "Not a directory", "/data/H.h5/dark"), "/data/H.h5/dark: Not a directory; a part of "),
        (NotADirectoryError(20, "Not a directory", "/data/H.h5/dark"), "the path is a file; check the path"),
        (PermissionError(13, "Permission denied", "/root/x"), "choose a folder you may write to"),
        (OSError("no number"), "OSError: no number"),
    ):
        assert words in words_of(error)


def test_a_record_before_a_long_step_is_reported(jobs: Jobs, qtbot: QtBot) -> None:
    """Records that came soon after another were dropped: the job seemed to be where it was before them."""
    go_on = threading.Event()

    def work() -> Work[None]:
        for k in range(5):
            yield Progress(k, 9, f"step {k}")
        go_on.wait(GUARD_MS / 1e3)

    jobs.start("Steps", "h", work)
    qtbot.waitUntil(lambda: getattr(jobs.jobs()[0].progress, "stage", "") == "step 4", timeout=GUARD_MS)
    go_on.set()
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)


# -- rows and logs -----------------------------------------------------------------------------------------
@pytest.fixture
def panel(jobs: Jobs, qtbot: QtBot) -> JobPanel:
    made = JobPanel(jobs)
    qtbot.addWidget(made)
    return made


def working() -> Work[Result]:
    yield Progress(0, 2, "read", 0.1)
    yield Progress(2, 2, "read", 0.2)
    warnings.warn("mean of empty slice", RuntimeWarning, stacklevel=1)
    yield Progress(1, 1, "write", 0.5)
    return Result()


def test_the_log_of_a_job_is_read_copied_and_saved(jobs: Jobs, panel: JobPanel, qtbot: QtBot, tmp_path: Path) -> None:
    taken = Taken("frames", "Assemble", CommandStep(("assemble", "frames"), ""), "H.h5")
    with pytest.warns(RuntimeWarning, match="mean of empty slice"):
        number = jobs.start("Assemble H.h5", "frames", working, taken=taken)
        idle(jobs, qtbot)
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
    view.save(str(tmp_path / "log.txt"))
    for copied in (QApplication.clipboard().text(), (tmp_path / "log.txt").read_text(encoding="utf-8")):
        assert copied == jobs.log(number).text()
    assert row.show_log() is view


def test_the_seconds_of_all_stages_of_a_job_are_added(jobs: Jobs, panel: JobPanel, qtbot: QtBot) -> None:
    """An inspection, whose last stage is short, was done in microseconds."""

    def parts() -> Work[None]:
        for done, total, stage, seconds in (
            (1, 2, "compare", 1.0), (2, 2, "compare", 2.0), (1, 1, "judge", 0.0), (1, 1, "judge", 0.5),
        ):  # fmt: skip
            yield Progress(done, total, stage, seconds)

    number = jobs.start("Inspect H.h5", "h", parts)
    idle(jobs, qtbot)
    assert panel.row(number).status.text() == "done in 2.5 s"


def test_a_job_shows_that_it_stops_and_its_log_grows(jobs: Jobs, panel: JobPanel, qtbot: QtBot) -> None:
    slow = Slow()
    number = jobs.start("Reconstruct", "reconstruct", slow.work)
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    row = panel.row(number)
    view = row.show_log()
    qtbot.addWidget(view)
    assert "residual 0.5" in view.view.toPlainText() and "now: solve: 3 of 9" in view.view.toPlainText()
    jobs.cancel(number)
    assert row.status.text() == "stopping …" and not row.button.isEnabled()
    jobs.cancel(number)
    slow.go_on.set()
    idle(jobs, qtbot)
    assert row.status.text() == "stopped after 1.0 s" and row.button.text() == "Dismiss" and row.button.isEnabled()
    view.refresh()
    text = view.view.toPlainText()
    assert text.count("stop requested") == 1 and "end      stopped after 1.0 s" in text and "now:" not in text


def test_a_failed_job_shows_its_error_and_logs_the_traceback(jobs: Jobs, panel: JobPanel, qtbot: QtBot) -> None:
    message, failed = "frames: expected light, got none; switch the lamp on", list[WindowJob]()

    def failing() -> Work[None]:
        yield Progress(0, 2, "read", 0.1)
        raise InputError(message)

    number = jobs.start("Failing", "h", failing, on_failed=failed.append)
    idle(jobs, qtbot)
    assert failed[0].state is JobState.FAILED and failed[0].error == message and "Traceback" in failed[0].details
    row = panel.row(number)
    assert row.error.text() == message
    text = jobs.log(number).text()
    assert f"end      failed: {message}" in text and "trace    Traceback" in text
    row.button.click()
    assert not panel.isAncestorOf(row), "dismissed"


# -- the queue ---------------------------------------------------------------------------------------------
class Gates:
    """Work of jobs by name: it notes that it began, and continues until it is released."""

    def __init__(self) -> None:
        self.begun, self._released = list[str](), defaultdict[str, threading.Event](threading.Event)

    def work(self, name: str) -> Callable[[], Work[None]]:
        released = self._released[name]

        def run() -> Work[None]:
            self.begun.append(name)
            while not released.wait(0.001):
                yield Progress(0, 1, "work")
            yield Progress(1, 1, "work", 0.5)

        return run

    def release(self, *names: str) -> None:
        for name in names or self._released:
            self._released[name].set()


@pytest.fixture
def gates() -> Gates:
    return Gates()


def state_of(jobs: Jobs, number: int) -> JobState:
    return next(job.state for job in jobs.jobs() if job.number == number)


def test_heavy_jobs_run_one_after_the_other_and_others_do_not_wait(jobs: Jobs, qtbot: QtBot, gates: Gates) -> None:
    numbers = [jobs.start(name, "frames", gates.work(name)) for name in "abc"]
    assert jobs.waiting() == tuple(numbers[1:]) and state_of(jobs, numbers[1]) is JobState.WAITING
    qtbot.waitUntil(lambda: gates.begun == ["a"], timeout=GUARD_MS)
    gates.release("b", "c")
    assert jobs.waiting() == tuple(numbers[1:]), "they wait for the first"
    recording = jobs.start("recording", "acquire", gates.work("recording"), at_once=True)
    qtbot.waitUntil(lambda: gates.begun == ["a", "recording"], timeout=GUARD_MS)
    gates.release("recording")
    qtbot.waitUntil(lambda: state_of(jobs, recording) is JobState.DONE, timeout=GUARD_MS)
    found: list[int] = []
    jobs.compute("picture", lambda: 7, found.append)
    qtbot.waitUntil(lambda: found == [7], timeout=GUARD_MS)
    gates.release("a")
    idle(jobs, qtbot)
    assert gates.begun == ["a", "recording", "b", "c"] and {state_of(jobs, n) for n in numbers} == {JobState.DONE}


def test_the_next_job_begins_after_a_failed_or_a_left_one(jobs: Jobs, qtbot: QtBot, gates: Gates) -> None:
    def failing() -> Work[None]:
        yield Progress(0, 1, "fail")
        raise ValueError("x")

    jobs.start("failing", "frames", failing)
    number = jobs.start("left", "fit", gates.work("left"), leave=True)
    jobs.start("after", "frames", gates.work("after"))
    qtbot.waitUntil(lambda: gates.begun == ["left"], timeout=GUARD_MS)
    jobs.cancel(number)
    qtbot.waitUntil(lambda: gates.begun == ["left", "after"], timeout=GUARD_MS)
    gates.release()
    idle(jobs, qtbot)


def test_a_job_whose_file_changed_while_it_waited_fails_with_a_remedy(
    jobs: Jobs, qtbot: QtBot, tmp_path: Path, gates: Gates
) -> None:
    path, ends = tmp_path / "H.h5", list[WindowJob]()
    path.write_text("as it was")
    jobs.finished.connect(ends.append)
    jobs.start("before", "frames", gates.work("before"))
    jobs.start("Inspect H.h5", "h", gates.work("inspect"), needs=[str(path)])
    jobs.start("Inspect none", "h", gates.work("none"), needs=[""])
    path.write_text("another")
    gates.release("before")
    qtbot.waitUntil(lambda: len(ends) == 2, timeout=GUARD_MS)
    expected = "H.h5: expected the file as it was when the job was started, got a changed or missing file"
    assert ends[1].error == f"{expected}; start the job again"
    jobs.cancel_all()
    idle(jobs, qtbot)


def test_closing_names_running_and_waiting_jobs_and_starts_none(
    window: MainWindow, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, gates: Gates
) -> None:
    for name in ("Assemble H.h5", "Simulate S.h5", "Inspect H.h5"):
        window.jobs.start(name, "frames", gates.work(name))
    qtbot.waitUntil(lambda: gates.begun == ["Assemble H.h5"], timeout=GUARD_MS)
    asked: list[str] = []
    buttons = QMessageBox.StandardButton
    monkeypatch.setattr(QMessageBox, "question", lambda *said: (asked.append(said[2]), buttons.Yes)[1])
    assert window.files.may_leave()
    idle(window.jobs, qtbot)
    assert "Running:\nAssemble H.h5\n\nWaiting to start:\nSimulate S.h5\nInspect H.h5\n\nStop them?" in asked[0]
    assert gates.begun == ["Assemble H.h5"]


def test_numbers_move_in_the_queue() -> None:
    line = Line()
    assert line.next() is None and not line.move(1, 1)
    for number in (1, 2, 3):
        line.add(number)
    assert line.next() == 1 and line.next() is None and line.waiting == (2, 3)
    assert line.move(3, -9) and line.waiting == (3, 2) and not line.move(3, -1)
    line.leave(1)
    line.leave(2)
    assert line.next() == 3 and line.waiting == ()


def test_the_order_of_the_queue_is_shown_and_changed(jobs: Jobs, panel: JobPanel, qtbot: QtBot, gates: Gates) -> None:
    panel.show()
    a, b, c, d = (jobs.start(name, "frames", gates.work(name)) for name in "abcd")
    assert panel.listed() == [a, b, c, d]
    assert panel.row(b).status.text() == "waiting: next in the queue"
    assert panel.row(d).status.text() == "waiting: number 3 in the queue"
    for number, up, down in ((a, False, False), (b, False, True), (c, True, True), (d, True, False)):
        row = panel.row(number)
        assert (row.up.isVisibleTo(row), row.down.isVisibleTo(row)) == (up, down)
    for button in (panel.row(d).up, panel.row(d).up, panel.row(b).down):
        button.click()
    assert panel.listed() == [a, d, c, b] and panel.row(d).status.text() == "waiting: next in the queue"
    panel.row(c).button.click()
    assert state_of(jobs, c) is JobState.CANCELLED and panel.row(c).status.text() == "stopped"
    assert panel.listed() == [a, d, b, c] and panel.row(c).button.text() == "Dismiss"
    gates.release()
    idle(jobs, qtbot)
    assert gates.begun == ["a", "d", "b"], "a job that was removed never begins"
    assert panel.listed() == [d, c, b, a], "of the jobs that ended, the newest is first"


def test_rows_of_jobs_are_whole_in_a_small_window(window: MainWindow, qtbot: QtBot, gates: Gates) -> None:
    """Only a strip of the second job was visible: the button below it took the room."""
    window.resize(1280, 800)
    numbers = [window.jobs.start(f"Assemble H_{k}.h5", "frames", gates.work(str(k))) for k in range(4)]
    QApplication.processEvents()
    window.job_line.toggle()
    QApplication.processEvents()
    panel = window.job_line.sheet.panel
    port = panel.area.viewport()
    seen = QRect(port.mapToGlobal(QPoint(0, 0)), port.size())
    for number in numbers:
        row = panel.row(number)
        shown = [one for one in row.findChildren(QPushButton) if one.isVisible()]
        assert shown and all(one.width() >= one.sizeHint().width() and one.accessibleName() for one in shown)
        assert row.status.width() >= row.status.sizeHint().width()
        assert number > numbers[1] or seen.contains(QRect(row.mapToGlobal(QPoint(0, 0)), row.size()))
    gates.release()
    idle(window.jobs, qtbot)


def test_work_in_units_shows_the_unit_and_how_many_are_done(jobs: Jobs, panel: JobPanel, qtbot: QtBot) -> None:
    released = threading.Event()

    def work() -> Work[None]:
        while not released.wait(0.001):
            yield Progress(2400, 40_000, "assemble plane 2", 1.0, per=1000)

    number = jobs.start("Assemble H.h5", "frames", work)
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    assert panel.row(number).status.text().startswith("assemble plane 2, 2 of 40 done, about ")
    assert "now: assemble plane 2: 2 of 40 done" in jobs.log(number).text()
    released.set()
    idle(jobs, qtbot)


# -- runs in units, as `lfcal status` shows them -----------------------------------------------------------
def journal(folder: Path, *lines: dict[str, object], place: str = "") -> None:
    folder.mkdir(exist_ok=True)
    units = ["plane 0", "plane 1", "plane 2"]
    here = {"process": os.getpid(), "host": socket.gethostname(), "place": place}
    begin = {"at": 0, "event": "begin", "title": "simulate H.h5", "units": units, "executor": "dask", "workers": 2}
    (folder / JOURNAL).write_text("".join(json.dumps(line) + "\n" for line in ({**begin, **here}, *lines)))


def test_a_run_is_watched_with_the_table_of_status(panel: JobPanel, qtbot: QtBot, tmp_path: Path) -> None:
    folder, place = tmp_path / "H.h5.parts", "http://127.0.0.1:8787/status"
    started, following = (
        {"at": at, "event": "started", "unit": f"plane {k}", "worker": "w"} for k, at in ((0, 1), (1, 38))
    )
    journal(folder, started, {"at": 37, "event": "done", "unit": "plane 0", "seconds": 36.0}, following, place=place)
    view = panel.watch(tmp_path / "H.h5")
    qtbot.waitUntil(lambda: view.table.rowCount() == 3, timeout=GUARD_MS)
    found = run_table(read_run(folder))
    assert view.title.text() == found.headline == "simulate H.h5: 1 of 3 units done; dask, 2 at work"
    assert view.status.text() == found.pace == "1 under way, 200 units an hour, about 36 s left"
    assert place in view.place.text() and not view.place.isHidden() and panel.isAncestorOf(view)
    assert [view.table.horizontalHeaderItem(k).text() for k in range(len(HEADER))] == list(HEADER)
    assert [view.table.item(0, k).text() for k in (0, 1, 4)] == ["plane 0", "done", "w"]
    (folder / JOURNAL).unlink()
    folder.rmdir()
    (tmp_path / "H.h5").write_bytes(b"")
    view.refresh()
    qtbot.waitUntil(lambda: "complete" in view.title.text(), timeout=GUARD_MS)
    assert view.table.isHidden() and view.place.isHidden()


def test_a_missing_run_is_a_message_until_it_is_dismissed(
    panel: JobPanel, jobs: Jobs, qtbot: QtBot, tmp_path: Path
) -> None:
    for path, words in ((tmp_path / "H.h5", "give the output file of the run"), (Path("/"), "the folder of a run")):
        with pytest.raises(InputError, match=words):
            look(path)
    view = panel.watch(tmp_path / "H.h5")
    qtbot.waitUntil(lambda: "give the output file of the run" in view.status.text(), timeout=GUARD_MS)
    button = view.findChild(QPushButton)
    assert button is not None
    button.click()
    assert not panel.isAncestorOf(view)
    idle(jobs, qtbot)
