from __future__ import annotations

import gc
import threading
import time
import weakref
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress, raise_if_abandoned
from lfcal_gui.jobs import JOBS_S, LOADS_S, Jobs, JobState, WindowJob
from lfcal_gui.window import MainWindow
from lfcal_gui.workers import words_of
from tests.gui.waiting import GUARD_MS, idle


@pytest.fixture
def jobs(qapp: Any) -> Generator[Jobs, None, None]:
    made = Jobs()
    yield made
    made.close()


def counting(n: int, cleaned: list[str]) -> Generator[Progress, None, str]:
    try:
        for k in range(n):
            yield Progress(k, n, "count", 0.1)
            time.sleep(0.002)
        return "result"
    finally:
        cleaned.append("cleaned")


def test_a_job_reports_in_the_windows_thread(jobs: Jobs, qtbot: QtBot) -> None:
    seen: list[tuple[WindowJob, threading.Thread]] = []
    results: list[str] = []
    jobs.changed.connect(lambda job: seen.append((job, threading.current_thread())))
    cleaned: list[str] = []
    with qtbot.waitSignal(jobs.finished, timeout=GUARD_MS):
        jobs.start("Counting", "h", lambda: counting(50, cleaned), results.append)
    assert results == ["result"] and cleaned == ["cleaned"]
    assert {thread for _, thread in seen} == {threading.current_thread()}
    states = [job.state for job, _ in seen]
    assert states[0] is JobState.WAITING and states[-1] is JobState.DONE
    assert jobs.running_pages() == set()


def test_a_job_shorter_than_a_look_at_the_queue_says_how_long_it_took(jobs: Jobs, qtbot: QtBot) -> None:
    ended = threading.Event()

    def work() -> Generator[Progress, None, None]:
        yield Progress(0, 1, "short", 4e-6)
        yield Progress(1, 1, "short", 0.25)
        ended.set()

    with qtbot.waitSignal(jobs.finished, timeout=GUARD_MS) as end:
        jobs.start("Short", "h", work)
        ended.wait(GUARD_MS / 1e3)  # the window's thread looks only afterwards
    assert end.args[0].progress.seconds == 0.25


def test_cancelling_closes_the_work(jobs: Jobs, qtbot: QtBot) -> None:
    cleaned: list[str] = []
    with qtbot.waitSignal(jobs.finished, timeout=GUARD_MS) as end:
        number = jobs.start("Counting", "h", lambda: counting(100_000, cleaned))
        assert jobs.running_pages() == {"h"}
        qtbot.waitUntil(lambda: jobs.jobs()[0].state is JobState.RUNNING, timeout=GUARD_MS)
        jobs.cancel(number)
    assert end.args[0].state is JobState.CANCELLED and cleaned == ["cleaned"]


def failing() -> Generator[Progress, None, None]:
    yield Progress(0, 2, "fail")
    raise InputError("sensor: expected light, got none; switch the lamp on")


def test_errors_come_in_words_with_details(jobs: Jobs, qtbot: QtBot) -> None:
    failed: list[WindowJob] = []
    with qtbot.waitSignal(jobs.finished, timeout=GUARD_MS):
        jobs.start("Failing", "h", failing, on_failed=failed.append)
    job = failed[0]
    assert job.state is JobState.FAILED
    assert job.error == "sensor: expected light, got none; switch the lamp on"
    assert "Traceback" in job.details


def test_only_the_newest_of_a_group_reports(jobs: Jobs, qtbot: QtBot) -> None:
    shown: list[int] = []
    calls: list[int] = []
    all_asked = threading.Event()

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


def test_a_computation_that_nobody_waits_for_is_left(jobs: Jobs, qtbot: QtBot) -> None:
    """Estimates of a large camera went on for minutes after another was chosen."""
    begun, asked = threading.Event(), threading.Event()
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


def test_errors_of_computations(jobs: Jobs, qtbot: QtBot) -> None:
    words: list[str] = []
    jobs.compute("x", lambda: 1 / 0, lambda _: None, words.append)
    qtbot.waitUntil(lambda: bool(words), timeout=GUARD_MS)
    assert words == ["ZeroDivisionError: division by zero"]


def test_closing_stops_everything(qapp: Any) -> None:
    jobs = Jobs()
    cleaned: list[str] = []
    late: list[Any] = []
    jobs.start("Long", "h", lambda: counting(100_000, cleaned), late.append)
    jobs.compute("slow", lambda: time.sleep(0.05), late.append)
    jobs.close()
    assert cleaned == ["cleaned"] and late == []
    jobs.compute("after", lambda: late.append("ran"), late.append)
    assert late == []


def test_a_job_that_is_left_is_stopped_at_once(jobs: Jobs, qtbot: QtBot) -> None:
    """One that writes nothing may compute on to its next record; nobody waits for it, and it reports no more."""
    inside, go_on, results = threading.Event(), threading.Event(), list[str]()
    cleaned: list[str] = []

    def slow() -> Generator[Progress, None, str]:
        try:
            yield Progress(0, 2, "slow")
            inside.set()
            go_on.wait(GUARD_MS / 1e3)
            yield Progress(1, 2, "slow")
            return "result"
        finally:
            cleaned.append("cleaned")

    number = jobs.start("Slow", "fit", slow, results.append, leave=True)
    qtbot.waitUntil(inside.is_set, timeout=GUARD_MS)
    thread = next(one for one in threading.enumerate() if one.name == f"lfcal-job-{number}")
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    jobs.cancel(number)
    assert jobs.jobs()[0].state is JobState.CANCELLED and not jobs.busy and not cleaned
    go_on.set()
    thread.join(GUARD_MS / 1e3)
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
    assert cleaned == ["cleaned"] and not results and jobs.jobs()[0].state is JobState.CANCELLED


def test_what_nobody_waits_for_is_computed_no_further(jobs: Jobs, qtbot: QtBot) -> None:
    """A search that was stopped kept a processor for half a minute."""
    inside = threading.Event()

    def endless() -> Generator[Progress, None, None]:
        yield Progress(0, 1, "search")
        inside.set()
        while True:
            raise_if_abandoned()

    number = jobs.start("Search", "multiplex", endless, leave=True)
    qtbot.waitUntil(inside.is_set, timeout=GUARD_MS)
    thread = next(one for one in threading.enumerate() if one.name == f"lfcal-job-{number}")
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    jobs.cancel(number)
    thread.join(GUARD_MS / 1e3)
    assert not thread.is_alive()


def test_closing_waits_no_longer_for_what_is_left_than_for_a_file(
    qapp: Any, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    inside, go_on = threading.Event(), threading.Event()
    waits: list[tuple[list[str], float]] = []

    def slow() -> Generator[Progress, None, None]:
        yield Progress(0, 2, "slow")
        inside.set()
        go_on.wait(GUARD_MS / 1e3)
        yield Progress(1, 2, "slow")

    monkeypatch.setattr("lfcal_gui.jobs.wait_for", lambda threads, s: waits.append(([one.name for one in threads], s)))
    made = Jobs()
    number = made.start("Slow", "fit", slow, leave=True)
    qtbot.waitUntil(inside.is_set, timeout=GUARD_MS)
    made.close()
    go_on.set()
    assert waits == [([], JOBS_S), ([f"lfcal-job-{number}"], LOADS_S)]


def test_what_a_job_made_is_told_and_not_remembered(jobs: Jobs, qtbot: QtBot) -> None:
    made: list[Any] = []
    ends: list[WindowJob] = []
    jobs.finished.connect(ends.append)
    jobs.start("Short", "h", lambda: counting(2, []), made.append)
    qtbot.waitUntil(lambda: bool(ends), timeout=GUARD_MS)
    assert made and ends[0].result == made[0], "whoever hears of the end gets it"
    assert jobs.jobs()[0].state is JobState.DONE and jobs.jobs()[0].result is None


def test_nothing_of_the_window_keeps_what_a_job_made(window: MainWindow, qtbot: QtBot) -> None:
    """The row in the dock kept every result, and the last record of a reconstruction its volume."""

    class Made:
        pass

    @dataclass(frozen=True, slots=True)
    class Record(Progress):
        state: Any = None

    seen: list[weakref.ref[Made]] = []

    def made() -> Made:
        one = Made()
        seen.append(weakref.ref(one))
        return one

    def work() -> Generator[Progress, None, Made]:
        yield Record(1, 2, "solve", 3.0, state=made())
        return made()

    window.jobs.start("Reconstruct", "reconstruct", work)
    idle(window.jobs, qtbot)
    job = window.jobs.jobs()[0]
    assert job.progress == Progress(1, 2, "solve", 3.0) and job.ended_words() == "done in 3.0 s"

    def freed() -> bool:
        gc.collect()
        return all(one() is None for one in seen)

    qtbot.waitUntil(freed, timeout=GUARD_MS)
    assert len(seen) == 2


def test_a_job_asked_to_stop_says_so_at_once(jobs: Jobs, qtbot: QtBot) -> None:
    from lfcal_gui.job_panel import JobPanel

    go_on = threading.Event()

    def slow() -> Generator[Progress, None, None]:
        yield Progress(0, 2, "slow")
        go_on.wait(GUARD_MS / 1e3)
        yield Progress(1, 2, "slow")

    panel = JobPanel(jobs)
    qtbot.addWidget(panel)
    number = jobs.start("Slow", "simulate", slow)
    qtbot.waitUntil(lambda: jobs.jobs()[0].progress is not None, timeout=GUARD_MS)
    row = panel._rows[number]
    jobs.cancel(number)
    assert row.status.text() == "stopping …" and not row.button.isEnabled()
    go_on.set()
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
    assert row.status.text() == "stopped" and row.button.text() == "Dismiss" and row.button.isEnabled()


def test_what_the_system_says_of_a_file_is_a_line_that_says_what_to_do() -> None:
    """The window showed "NotADirectoryError: [Errno 20] …" with no remedy."""
    told = words_of(NotADirectoryError(20, "Not a directory", "/data/H.h5/dark"))
    assert told == "/data/H.h5/dark: Not a directory; a part of the path is a file; check the path"
    assert "choose a folder you may write to" in words_of(PermissionError(13, "Permission denied", "/root/x"))
    assert words_of(OSError("no number")) == "OSError: no number"


def test_a_record_before_a_long_step_is_told(jobs: Jobs, qtbot: QtBot) -> None:
    """Records that came soon after another were dropped: the job seemed to be where it was before them."""
    go_on = threading.Event()

    def work() -> Generator[Progress, None, None]:
        for k in range(5):
            yield Progress(k, 9, f"step {k}")
        go_on.wait(GUARD_MS / 1e3)

    jobs.start("Steps", "h", work)
    qtbot.waitUntil(lambda: getattr(jobs.jobs()[0].progress, "stage", "") == "step 4", timeout=GUARD_MS)
    go_on.set()
    qtbot.waitUntil(lambda: not jobs.busy, timeout=GUARD_MS)
