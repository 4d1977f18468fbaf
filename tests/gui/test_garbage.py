"""Garbage is collected while nothing goes on: a look at all objects holds the window for a tenth of a second."""

from __future__ import annotations

import gc
from collections.abc import Iterator

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication

from lfcal_gui import _garbage as garbage
from lfcal_gui._garbage import CALM_TICKS, LATEST_TICKS, Collector


@pytest.fixture
def collector(qapp: QApplication) -> Iterator[Collector]:
    was_on = gc.isenabled()
    made = Collector()
    made._timer.stop()
    yield made
    made.close()
    assert gc.isenabled() == was_on


@pytest.fixture
def collected(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Return the generations that are collected, all of them due."""
    found: list[int] = []
    monkeypatch.setattr(gc, "collect", lambda generation=2: found.append(generation))
    monkeypatch.setattr(gc, "get_count", lambda: (10**6, 10**6, 10**6))
    return found


class Busy(QObject):
    busy = True


class Thread:
    """Tells the processor time of a thread that works ``each_s`` between two ticks."""

    def __init__(self) -> None:
        self.now_s = self.each_s = 0.0

    def thread_time(self) -> float:
        return self.now_s

    def tick(self, collector: Collector) -> None:
        self.now_s += self.each_s
        collector.collect()


@pytest.fixture
def thread(monkeypatch: pytest.MonkeyPatch) -> Thread:
    made = Thread()
    monkeypatch.setattr(garbage, "time", made)
    return made


def test_while_the_user_works_only_young_objects_are_looked_through(
    thread: Thread, collector: Collector, collected: list[int]
) -> None:
    """All generations were collected while H was opened or scrubbed, whenever they were due: 50 to 110 ms."""
    thread.each_s = 0.2
    for _ in range(LATEST_TICKS - 1):
        thread.tick(collector)
    assert collected == [0] * (LATEST_TICKS - 1)
    thread.tick(collector)
    assert collected[-1] == 2, "but not for ever"
    thread.tick(collector)
    assert collected[-1] == 0


def test_all_objects_are_looked_through_when_nothing_goes_on(
    thread: Thread, collector: Collector, collected: list[int]
) -> None:
    for _ in range(CALM_TICKS):
        thread.tick(collector)
    assert collected == [0] * (CALM_TICKS - 1) + [2]


def test_while_a_job_is_at_work_something_goes_on(thread: Thread, collected: list[int], qapp: QApplication) -> None:
    """H was opened in the background, the window waited, and was held just when H was to be shown."""
    jobs = Busy()
    collector = Collector(jobs, lambda: jobs.busy)
    try:
        for _ in range(2 * CALM_TICKS):
            thread.tick(collector)
        assert set(collected) == {0}
        jobs.busy = False
        for _ in range(CALM_TICKS):
            thread.tick(collector)
        assert collected[-1] == 2
    finally:
        collector.close()


def test_nothing_is_collected_that_is_not_due(
    thread: Thread, collector: Collector, collected: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gc, "get_count", lambda: (0, 0, 0))
    for _ in range(LATEST_TICKS + 1):
        thread.tick(collector)
    assert collected == []


def test_what_was_there_before_is_left_aside(collector: Collector) -> None:
    """Two thirds of all objects are modules and functions."""
    assert gc.get_freeze_count() > 10_000


def test_cycles_made_since_are_freed(collector: Collector, thread: Thread) -> None:
    class Link:
        other: Link

    freed: list[int] = []

    class Ended(Link):
        def __del__(self) -> None:
            freed.append(1)

    one, two = Ended(), Link()
    one.other, two.other = two, one
    del one, two
    assert not freed
    gc.set_threshold(0, 0, 0)
    try:
        for _ in range(CALM_TICKS + 1):
            [[] for _ in range(10)]
            thread.tick(collector)
    finally:
        gc.set_threshold(700, 10, 10)
    assert freed
