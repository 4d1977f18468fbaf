"""The log of a job, and mishaps with what is safe after them."""

from __future__ import annotations

import itertools
import threading
import warnings
from types import SimpleNamespace

import pytest

from lfcal.base.progress import Progress
from lfcal_gui.models.job import MOST, JobLog, notes_of, warnings_to
from lfcal_gui.models.mishaps import Mishap, Mishaps, safe_words


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


def test_warnings_go_to_the_job_of_their_thread() -> None:
    told: list[str] = []
    other = threading.Thread(target=lambda: warnings.warn("elsewhere", RuntimeWarning, stacklevel=1))
    with pytest.warns(RuntimeWarning) as seen, warnings_to(told.append):
        warnings.warn("mean of\nempty slice", RuntimeWarning, stacklevel=1)
        other.start()
        other.join()
        assert told == ["RuntimeWarning: mean of empty slice"]
    assert seen.list, "whoever listened before hears of it as well"


def test_times_do_not_follow_a_clock_that_is_set(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = itertools.count(7.0, 2.0)
    monkeypatch.setattr("lfcal_gui.models.job.time.monotonic", lambda: next(clock))
    log = JobLog("Assemble H.h5")
    monkeypatch.setattr("lfcal_gui.models.job.time.time", lambda: 0.0)
    log.end("done")
    assert [line.after for line in log.lines()] == pytest.approx([2.0, 4.0])
    assert log.lines()[0].at > 1e9


def raised(kind: type[Exception], text: str) -> Mishap:
    try:
        raise kind(text)
    except kind as error:
        return Mishap.of(error)


def test_what_is_safe() -> None:
    def words(**changes: object) -> str:
        given = {"unsaved": True, "project": "", "copy": "/c.lfcal", "jobs": (), "recording": False}
        return " ".join(safe_words(**{**given, **changes}))  # type: ignore[arg-type]

    assert "/c.lfcal" in words()
    assert "could not be copied" in words(copy="") and "under a new name" in words(copy="")
    assert "saved in /p.lfcal" in words(unsaved=False, project="/p.lfcal", copy="")
    assert "no unsaved changes" in words(unsaved=False, copy="")
    assert "every position counted as done is on the disk" in words(recording=True, jobs=("Record a",))
    assert "Record a" in words(recording=True, jobs=("Record a",))


def test_traces_warnings_and_the_latest_notes_are_kept() -> None:
    failed = ticking()
    failed.end("failed: no light", "Traceback\n  File\n")
    assert kinds(failed)[-3:] == [("end", "failed: no light"), ("trace", "Traceback"), ("trace", "  File")]
    log = ticking()
    log.say("warning", "hot")
    for k in range(2 * MOST):
        log.follow(Progress(k, 0, "solve", note=f"residual {k}"))
    found = log.lines()
    assert len(found) == MOST and [line.kind for line in found[:3]] == ["begin", "command", "warning"]
    assert found[-1].words == f"solve: residual {2 * MOST - 1}" and log.warned == 1
    assert f"({2 * MOST + 3 - MOST} notes are omitted)" in log.text()
    assert notes_of(SimpleNamespace(notes=("12 positions are missing",))) == ("12 positions are missing",)
    assert notes_of(SimpleNamespace(notes={"a": 1})) == () and notes_of(None) == ()


def test_each_kind_of_mishap_counts_for_itself_in_one_short_line() -> None:
    found = Mishaps()
    assert found.add(raised(KeyError, "a"))[1]
    again, first = found.add(raised(KeyError, "b"))
    assert not first and again.count == 2 and "(2 times)" in again.title()
    assert found.add(raised(ValueError, "a"))[1]
    assert [m.count for m in found.all()] == [2, 1]
    mishap = raised(RuntimeError, "first\nsecond\t" + "x" * 5000)
    assert mishap.words.startswith("RuntimeError: first second x") and len(mishap.words) <= 500
