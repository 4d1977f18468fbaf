"""What a job did, in lines."""

from __future__ import annotations

import itertools
import threading
import warnings
from types import SimpleNamespace

import pytest

from lfcal.base.progress import Progress
from lfcal_gui.models.job import MOST, JobLog, notes_of, warnings_to


def ticking(step: float = 1.0) -> JobLog:
    clock = itertools.count(1_000_000.0, step)
    return JobLog("Assemble H.h5", "lfcal assemble frames -o H.h5\n", lambda: next(clock))


def kinds(log: JobLog) -> list[tuple[str, str]]:
    return [(line.kind, line.words) for line in log.lines()]


def test_stages_with_their_times_notes_and_the_command() -> None:
    log = ticking()
    for k in range(3):
        log.follow(Progress(k, 2, "read"))
    log.follow(Progress(0, 10, "write", 3.0, "one frame is saturated"))
    log.follow(Progress(1, 10, "write", 3.0, "one frame is saturated"))
    assert "now: write: 1 of 10" in log.text()
    log.end("done in 4 s")
    assert kinds(log) == [
        ("begin", "Assemble H.h5"),
        ("command", "lfcal assemble frames -o H.h5"),
        ("stage", "read: 2 of 2 in 1.0 s"),
        ("note", "write: one frame is saturated"),
        ("stage", "write: 1 of 10 in 2.0 s"),
        ("end", "done in 4 s"),
    ]
    assert "now:" not in log.text() and log.text().startswith("Assemble H.h5, begun 1970-01-12 ")
    log.follow(Progress(2, 10, "left behind"))
    log.say("note", "too late")
    assert kinds(log)[-1] == ("end", "done in 4 s"), "what was left says nothing more"


def test_a_trace_is_kept_line_by_line() -> None:
    log = ticking()
    log.end("failed: no light", "Traceback\n  File\n")
    assert kinds(log)[-3:] == [("end", "failed: no light"), ("trace", "Traceback"), ("trace", "  File")]


def test_what_is_said_by_the_way_goes_first() -> None:
    log = ticking()
    log.say("warning", "hot")
    for k in range(2 * MOST):
        log.follow(Progress(k, 0, "solve", note=f"residual {k}"))
    found = log.lines()
    assert len(found) == MOST and [line.kind for line in found[:3]] == ["begin", "command", "warning"]
    assert found[-1].words == f"solve: residual {2 * MOST - 1}" and log.warned == 1
    assert f"({2 * MOST + 3 - MOST} notes are omitted)" in log.text()


def test_warnings_go_to_the_job_of_their_thread() -> None:
    told: list[str] = []
    other = threading.Thread(target=lambda: warnings.warn("elsewhere", RuntimeWarning, stacklevel=1))
    with pytest.warns(RuntimeWarning) as seen, warnings_to(told.append):
        warnings.warn("mean of\nempty slice", RuntimeWarning, stacklevel=1)
        other.start()
        other.join()
        assert told == ["RuntimeWarning: mean of empty slice"]
    assert seen.list, "whoever listened before hears of it as well"


def test_notes_of_a_result() -> None:
    assert notes_of(SimpleNamespace(notes=("12 positions are missing",))) == ("12 positions are missing",)
    assert notes_of(SimpleNamespace(notes={"a": 1})) == () and notes_of(None) == ()


def test_times_do_not_follow_a_clock_that_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(7.0, 2.0)
    monkeypatch.setattr("lfcal_gui.models.job.time.monotonic", lambda: next(clock))
    log = JobLog("Assemble H.h5")
    monkeypatch.setattr("lfcal_gui.models.job.time.time", lambda: 0.0)
    log.end("done")
    assert [line.after for line in log.lines()] == pytest.approx([2.0, 4.0])
    assert log.lines()[0].at > 1e9
