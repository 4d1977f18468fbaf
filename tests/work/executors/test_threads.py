"""Concurrent units in one process: as many as threads and memory allow, and stopped together."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.work import Unit, iter_run, read_run
from lfcal.work.executors.threads import Threads, concurrent_units
from lfcal.work.journal import JOURNAL
from tests.work.tasks import unit


def concurrent(name: str, task: str = "write", size: int = 1, **arguments: Any) -> Unit:
    """Return a unit that may be done at the same time as others."""
    return replace(unit(name, task, **arguments), concurrent_bytes=size)


def test_as_many_as_threads_and_memory_allow() -> None:
    for sizes, threads, memory, count in (
        ([1, 1, 1], 2, 100, 2),
        ([1, 1, 1], 8, 100, 3),
        ([40, 40, 40], 8, 100, 2),
        ([140, 1], 8, 100, 0),
        ([1, 0, 1], 8, 100, 1),
        ([0, 1], 8, 100, 0),
        ([1], 0, 100, 0),
        ([], 4, 100, 0),
    ):
        assert concurrent_units(sizes, threads, memory) == count, (sizes, threads)


def test_concurrent_units_are_under_way_at_the_same_time(tmp_path: Path) -> None:
    units = [concurrent(f"plane {k}", "meet", marks=str(tmp_path / "marks"), count=3) for k in range(3)]
    parts = drain(iter_run(units, tmp_path / "run", Threads(3)))
    assert sorted(part.read_text() for part in parts) == ["0", "1", "2"]  # each worker's number
    state = read_run(tmp_path / "run")
    assert {u.worker for u in state.units} == {"thread 1", "thread 2", "thread 3"}
    assert state.per_hour == pytest.approx(3600 * 3 * 3 / sum(u.seconds for u in state.units))


def test_threads_are_divided_and_nothing_is_begun_twice(tmp_path: Path) -> None:
    def used(count: int, threads: int) -> list[int]:
        seen = tmp_path / f"seen {count} {threads}"
        units = [concurrent(f"plane {k}", text=f"{k}", seen=str(seen)) for k in range(count)]
        parts = drain(iter_run(units, tmp_path / f"run {count} {threads}", Threads(threads)))
        assert [part.read_text() for part in parts] == [f"{k}" for k in range(count)]
        return [int(line.split()[1]) for line in seen.read_text().splitlines()]

    assert sorted(used(2, 5)) == [2, 3]
    assert used(1, 5) == [5]
    found = used(7, 2)
    assert len(found) == 7 and found[:6] == [1] * 6  # the last may find itself alone
    assert used(4, 1) == [1] * 4


def test_units_that_are_too_large_are_done_alone_with_all_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("lfcal.work.executors.threads.free_memory", lambda: 100)
    seen = tmp_path / "seen"
    units = [concurrent(f"plane {k}", size=50, seen=str(seen)) for k in range(3)]
    drain(iter_run(units, tmp_path / "run", Threads(4)))
    assert {line.split()[1] for line in seen.read_text().splitlines()} == {"4"}
    assert {u.worker for u in read_run(tmp_path / "run").units} == {"this process"}


def test_other_units_wait_until_they_are_alone(tmp_path: Path) -> None:
    units = [concurrent("a"), concurrent("b"), unit("c"), concurrent("d"), concurrent("e")]
    seen = tmp_path / "seen"
    units = [replace(u, arguments={**u.arguments, "seen": str(seen)}) for u in units]
    drain(iter_run(units, tmp_path / "run", Threads(2)))
    workers = [u.worker for u in read_run(tmp_path / "run").units]
    assert workers[2] == "this process" and "this process" not in (*workers[:2], *workers[3:4])
    assert seen.read_text().splitlines()[2].split()[1] == "2"


def test_a_unit_that_fails_stops_the_others(tmp_path: Path) -> None:
    units = [concurrent("a", "endless", begun=str(tmp_path / "begun")), concurrent("b", "refuse"), concurrent("c")]
    with pytest.raises(InputError, match="open the shutter"):
        drain(iter_run(units, tmp_path / "run", Threads(2)))
    assert [path.name for path in (tmp_path / "run").iterdir()] == [JOURNAL]
    assert [u.state for u in read_run(tmp_path / "run").units] == ["waiting", "failed", "waiting"]
    with pytest.raises(ZeroDivisionError, match="one by nothing"):  # no message for people: as it is
        drain(iter_run([concurrent("a", "stumble"), concurrent("b")], tmp_path / "other", Threads(2)))


def test_closing_stops_all_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    marks = [tmp_path / "one", tmp_path / "other"]
    units = [concurrent(f"plane {k}", "endless", begun=str(mark)) for k, mark in enumerate(marks)]
    work = iter_run(units, tmp_path / "run", Threads(2))
    for _ in work:
        if all(mark.exists() for mark in marks):
            break
    work.close()
    assert [path.name for path in (tmp_path / "run").iterdir()] == [JOURNAL]
    assert not read_run(tmp_path / "run").running
