"""Places to curves: rungs as they come, kept when stopped; seconds that are kept to; reasons in place of errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace

import pytest

from lfcal.accuracy import (
    PLACES,
    AccuracyStep,
    Place,
    Rung,
    Subject,
    Truth,
    iter_measure_curve,
    measure,
    measure_curve,
)
from lfcal.accuracy.place import find_places
from lfcal.base.errors import InputError


def place(work: Callable[..., Iterator[object]], name: str = "made up") -> Place:
    return Place(name, "Made up", "error", "cost", "seconds", lambda subject, seconds: work())  # type: ignore[arg-type]


def rungs(count: int) -> Iterator[object]:
    yield Truth("exact", ("note",))
    for k in range(count):
        yield AccuracyStep(f"rung {k}")
        yield Rung(f"rung {k}", {"k": k}, 1 / (k + 1), k, "seconds")


class Clock:
    """A clock that a test turns."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(measure, "time", SimpleNamespace(perf_counter=made))
    return made


def test_a_curve_has_truth_notes_and_all_rungs(subject: Subject) -> None:
    found = measure_curve(place(lambda: rungs(4)), subject)
    assert (found.truth, found.notes, found.stopped) == ("exact", ("note",), "")
    assert [r.settings["k"] for r in found.rungs] == [0, 1, 2, 3] and all(r.efficient for r in found.rungs)


def test_closed_early_it_keeps_the_rungs_and_closes_the_place(subject: Subject) -> None:
    closed: list[bool] = []

    def endless() -> Iterator[object]:
        try:
            yield from rungs(10**9)
        finally:
            closed.append(True)

    work = iter_measure_curve(place(endless), subject)
    for record in work:
        if len(record.curve.rungs) == 3:  # type: ignore[attr-defined]
            break
    work.close()
    assert closed == [True] and len(record.curve.rungs) == 3  # type: ignore[attr-defined]
    assert [r.label for r in record.curve.front] == ["rung 0", "rung 1", "rung 2"]  # type: ignore[attr-defined]


def test_no_step_begins_that_would_end_too_late(subject: Subject, clock: Clock) -> None:
    begun: list[int] = []

    def slow() -> Iterator[object]:
        yield Truth("exact")
        for k in range(100):
            yield AccuracyStep(f"rung {k}")
            begun.append(k)
            clock.now += 3.0
            yield Rung(f"rung {k}", {}, 1.0, k, "seconds")

    found = measure_curve(place(slow), subject, 10.0)
    assert len(found.rungs) == len(begun) == 3 and clock.now == 9.0, "the fourth would end after 12 s"
    assert found.stopped == "ended after 9.0 s"


def test_a_step_that_says_how_long_it_takes_is_believed(subject: Subject, clock: Clock) -> None:
    def steps(last: float) -> Iterator[object]:
        yield Truth("exact")
        clock.now += 1.0
        yield Rung("first", {}, 1.0, 1.0, "seconds")
        yield AccuracyStep("second", last)
        yield Rung("second", {}, 0.5, 2.0, "seconds")

    assert len(measure_curve(place(lambda: steps(8.9)), subject, 10.0).rungs) == 2
    assert len(measure_curve(place(lambda: steps(9.1)), subject, 10.0).rungs) == 1


def test_a_long_truth_leaves_time_for_rungs(subject: Subject, clock: Clock) -> None:
    def slow() -> Iterator[object]:
        clock.now += 100.0
        yield Truth("exact")
        for k in range(100):
            clock.now += 1.0
            yield Rung(f"rung {k}", {}, 1.0, k, "seconds")

    assert len(measure_curve(place(slow), subject, 10.0).rungs) == 5, "4 s, and the one that ends later"


def test_what_cannot_be_measured_says_why(subject: Subject) -> None:
    def refused() -> Iterator[object]:
        yield from rungs(2)
        raise InputError("iris: none")

    found = measure_curve(place(refused), subject)
    assert found.stopped == "iris: none" and len(found.rungs) == 2
    assert measure_curve(place(lambda: rungs(1)), subject).stopped == ""


def test_a_mistake_of_the_program_is_not_hidden(subject: Subject) -> None:
    def broken() -> Iterator[object]:
        yield from rungs(1)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        measure_curve(place(broken), subject)


@pytest.mark.parametrize("seconds", [0, -1, float("nan")])
def test_seconds_are_above_nothing(subject: Subject, seconds: float) -> None:
    with pytest.raises(InputError, match="time for each measurement"):
        measure_curve(place(lambda: rungs(1)), subject, seconds)


def test_every_place_of_the_work_is_there_and_says_what_it_measures() -> None:
    assert PLACES.names() == (
        "simulation",
        "sampling",
        "planes",
        "lattice",
        "interpolation",
        "averaging",
        "storage",
        "aperture",
        "projection",
        "solvers",
        "filters",
        "bases",
    )
    assert all(place.title and place.error and place.cost for place in PLACES)


def test_places_of_other_distributions_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    class Point:
        def __init__(self, name: str, part: object) -> None:
            self.name, self.part = name, part

        def load(self) -> object:
            return self.part

    mine = replace(place(lambda: rungs(1), "mine"), rank=5)
    points = [Point("good", mine), Point("bad", lambda: None)]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points)
    found = find_places()
    assert found.names()[0] == "mine" and found.get("mine") is mine
    assert list(found.failures()) == ["bad"]
