"""Curves of parts: points as they come, kept when stopped; the time limit; reasons instead of errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace

import pytest

from lfcal.accuracy import (
    PARTS,
    AccuracyPart,
    AccuracyStep,
    CostPoint,
    Subject,
    Truth,
    iter_measure_curve,
    measure,
    measure_curve,
)
from lfcal.accuracy.part import find_parts
from lfcal.base import Progress
from lfcal.base.errors import InputError


def part(work: Callable[..., Iterator[object]], name: str = "made up") -> AccuracyPart:
    return AccuracyPart(name, "Made up", "error", "cost", "seconds", lambda subject, seconds: work())  # type: ignore[arg-type]


def points(count: int) -> Iterator[object]:
    yield Truth("exact", ("note",))
    for k in range(count):
        yield AccuracyStep(f"point {k}")
        yield CostPoint(f"point {k}", {"k": k}, 1 / (k + 1), k, "seconds")


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


def test_a_curve_has_truth_notes_and_all_points(subject: Subject) -> None:
    found = measure_curve(part(lambda: points(4)), subject)
    assert (found.truth, found.notes, found.stopped) == ("exact", ("note",), "")
    assert [r.settings["k"] for r in found.points] == [0, 1, 2, 3] and all(r.efficient for r in found.points)


def test_closed_early_it_keeps_the_points_and_closes_the_part(subject: Subject) -> None:
    closed: list[bool] = []

    def endless() -> Iterator[object]:
        try:
            yield from points(10**9)
        finally:
            closed.append(True)

    work = iter_measure_curve(part(endless), subject)
    for record in work:
        if len(record.curve.points) == 3:  # type: ignore[attr-defined]
            break
    work.close()
    assert closed == [True] and len(record.curve.points) == 3  # type: ignore[attr-defined]
    assert [r.label for r in record.curve.front] == ["point 0", "point 1", "point 2"]  # type: ignore[attr-defined]


def test_no_step_begins_that_would_end_too_late(subject: Subject, clock: Clock) -> None:
    begun: list[int] = []

    def slow() -> Iterator[object]:
        yield Truth("exact")
        for k in range(100):
            yield AccuracyStep(f"point {k}")
            begun.append(k)
            clock.now += 3.0
            yield CostPoint(f"point {k}", {}, 1.0, k, "seconds")

    found = measure_curve(part(slow), subject, 10.0)
    assert len(found.points) == len(begun) == 3 and clock.now == 9.0, "the fourth would end after 12 s"
    assert found.stopped == "ended after 9.0 s, before: point 3 (about 3.0 s)"


def test_a_step_that_says_how_long_it_takes_is_believed(subject: Subject, clock: Clock) -> None:
    def steps(last: float) -> Iterator[object]:
        yield Truth("exact")
        clock.now += 1.0
        yield CostPoint("first", {}, 1.0, 1.0, "seconds")
        yield AccuracyStep("second", last)
        yield CostPoint("second", {}, 0.5, 2.0, "seconds")

    assert len(measure_curve(part(lambda: steps(8.9)), subject, 10.0).points) == 2
    assert len(measure_curve(part(lambda: steps(9.1)), subject, 10.0).points) == 1


def test_a_long_truth_leaves_time_for_points(subject: Subject, clock: Clock) -> None:
    def slow() -> Iterator[object]:
        clock.now += 100.0
        yield Truth("exact")
        for k in range(100):
            clock.now += 1.0
            yield CostPoint(f"point {k}", {}, 1.0, k, "seconds")

    assert len(measure_curve(part(slow), subject, 10.0).points) == 5, "4 s, and the one that ends later"


def test_a_reference_that_does_not_fit_is_not_begun(subject: Subject, clock: Clock) -> None:
    begun: list[str] = []

    def slow() -> Iterator[object]:
        yield AccuracyStep("reference", 61.0)
        begun.append("reference")
        yield Truth("exact")

    found = measure_curve(part(slow), subject, 30.0)
    assert not begun and found.stopped == "not begun: reference takes about 1 min 01 s"
    assert measure_curve(part(slow), subject, 31.0).truth == "exact" and begun == ["reference"]


def test_a_step_in_progress_ends_at_twice_the_limit(subject: Subject, clock: Clock) -> None:
    ended: list[int] = []

    def endless() -> Iterator[object]:
        yield AccuracyStep("reference")
        try:
            for k in range(10**6):
                clock.now += 1.0
                yield Progress(k, 10**6, "rows")
        finally:
            ended.append(k)

    found = measure_curve(part(endless), subject, 30.0)
    assert clock.now == 61.0 and ended == [60]
    assert found.stopped == "ended after 1 min 01 s before any setting was measured"


@pytest.mark.parametrize("seconds", [10.0, 20.0, 100.0])
@pytest.mark.parametrize(("reference", "each"), [(0.0, 1.0), (5.0, 3.0), (19.0, 0.5), (15.0, 4.0)])
def test_the_time_limit_is_kept_within_a_factor(
    subject: Subject, clock: Clock, seconds: float, reference: float, each: float
) -> None:
    def slow() -> Iterator[object]:
        yield AccuracyStep("reference", reference)
        clock.now += reference
        yield Truth("exact")
        for k in range(10**6):
            yield AccuracyStep(f"point {k}")
            clock.now += each
            yield CostPoint(f"point {k}", {}, 1.0, k, "seconds")

    found = measure_curve(part(slow), subject, seconds)
    assert found.points and clock.now <= max(seconds, reference + 0.4 * seconds) <= 2.4 * seconds
    assert "before: point" in found.stopped


def test_a_long_simulation_of_a_large_camera_is_not_begun(monkeypatch: pytest.MonkeyPatch, clock: Clock) -> None:
    """By the forecast of the reference alone: no pattern of the R29 is computed."""
    from lfcal.accuracy.parts import simulation
    from lfcal.camera import ScanPlan, preset

    plan = ScanPlan.for_camera(preset("r29"), virtual_depths=[3.0], cutout=301)
    computed: list[object] = []
    monkeypatch.setattr(simulation.PlaneResponse, "rows", lambda *given: computed.append(given))
    monkeypatch.setattr("lfcal.accuracy.subject.REFERENCE", 1000.0)
    found = measure_curve(PARTS.get("simulation"), Subject("R29", plan, workers=1), 10.0)
    assert not computed and not found.points
    assert found.stopped.startswith("not begun: reference at 1 position takes about ")


def test_what_cannot_be_measured_says_why(subject: Subject) -> None:
    def refused() -> Iterator[object]:
        yield from points(2)
        raise InputError("iris: none")

    found = measure_curve(part(refused), subject)
    assert found.stopped == "iris: none" and len(found.points) == 2
    assert measure_curve(part(lambda: points(1)), subject).stopped == ""


def test_a_mistake_of_the_program_is_not_hidden(subject: Subject) -> None:
    def broken() -> Iterator[object]:
        yield from points(1)
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        measure_curve(part(broken), subject)


@pytest.mark.parametrize("seconds", [0, -1, float("nan")])
def test_seconds_are_above_nothing(subject: Subject, seconds: float) -> None:
    with pytest.raises(InputError, match="time for each measurement"):
        measure_curve(part(lambda: points(1)), subject, seconds)


def test_every_part_of_the_work_is_there_and_says_what_it_measures() -> None:
    assert PARTS.names() == (
        "simulation",
        "sampling",
        "planes",
        "lattice",
        "interpolation",
        "recording",
        "averaging",
        "storage",
        "aperture",
        "projection",
        "solvers",
        "filters",
        "bases",
    )
    assert all(part.title and part.error and part.cost for part in PARTS)


def test_parts_of_other_distributions_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    class Point:
        def __init__(self, name: str, part: object) -> None:
            self.name, self.part = name, part

        def load(self) -> object:
            return self.part

    mine = replace(part(lambda: points(1), "mine"), rank=5)
    points = [Point("good", mine), Point("bad", lambda: None)]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: points)
    found = find_parts()
    assert found.names()[0] == "mine" and found.get("mine") is mine
    assert list(found.failures()) == ["bad"]
