"""Curves of parts: points as they come, kept when stopped; the time limit; reasons instead of errors; the subject."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
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
from lfcal.accuracy import subject as module
from lfcal.accuracy.part import find_parts
from lfcal.base import InputError, Progress, drain
from lfcal.camera import ScanPlan, preset
from lfcal.psf import PSFMatrix, open_psf, save
from lfcal.simulate import plan_effects, simulate_psf
from tests.distribution import names_of


def part(work: Callable[[], Iterator[object]], name: str = "made up") -> AccuracyPart:
    return AccuracyPart(name, "Made up", "error", "cost", "seconds", lambda subject, seconds: work())


def points(count: int, clock: Clock | None = None, each: float = 0.0) -> Iterator[object]:
    yield Truth("exact", ("note",))
    for k in range(count):
        yield AccuracyStep(f"point {k}")
        if clock is not None:
            clock.now += each
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
        if len(record.curve.points) == 3:
            break
    work.close()
    assert closed == [True] and len(record.curve.points) == 3
    assert [r.label for r in record.curve.front] == ["point 0", "point 1", "point 2"]


def test_no_step_begins_that_would_end_too_late(subject: Subject, clock: Clock) -> None:
    found = measure_curve(part(lambda: points(100, clock, 3.0)), subject, 10.0)
    assert len(found.points) == 3 and clock.now == 9.0, "the fourth would end after 12 s"
    assert found.stopped == "ended after 9.0 s, before: point 3 (about 3.0 s)"

    def announced(last: float) -> Iterator[object]:
        yield Truth("exact")
        clock.now += 1.0
        yield CostPoint("first", {}, 1.0, 1.0, "seconds")
        yield AccuracyStep("second", last)
        yield CostPoint("second", {}, 0.5, 2.0, "seconds")

    for seconds, count in ((8.9, 2), (9.1, 1)):
        assert len(measure_curve(part(lambda seconds=seconds: announced(seconds)), subject, 10.0).points) == count


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


def test_the_time_limit_is_kept_within_a_factor(subject: Subject, clock: Clock) -> None:
    for seconds in (10.0, 20.0, 100.0):
        for reference, each in ((0.0, 1.0), (5.0, 3.0), (19.0, 0.5), (15.0, 4.0)):
            clock.now = 0.0

            def slow(reference: float = reference, each: float = each) -> Iterator[object]:
                yield AccuracyStep("reference", reference)
                clock.now += reference
                yield from points(10**6, clock, each)

            found = measure_curve(part(slow), subject, seconds)
            assert found.points and "before: point" in found.stopped
            assert clock.now <= max(seconds, reference + 0.4 * seconds) <= 2.4 * seconds, (seconds, reference, each)


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


def test_refusals_are_reasons_and_mistakes_of_the_program_are_errors(subject: Subject) -> None:
    def failing(error: Exception) -> Iterator[object]:
        yield from points(2)
        raise error

    found = measure_curve(part(lambda: failing(InputError("iris: none"))), subject)
    assert found.stopped == "iris: none" and len(found.points) == 2
    with pytest.raises(ZeroDivisionError):
        measure_curve(part(lambda: failing(ZeroDivisionError())), subject)
    for seconds in (0, -1, float("nan")):
        with pytest.raises(InputError, match="time for each measurement"):
            measure_curve(part(lambda: points(1)), subject, seconds)


def test_every_part_of_the_work_is_there_and_says_what_it_measures() -> None:
    names = "simulation sampling planes lattice interpolation recording averaging storage aperture projection"
    assert PARTS.names() == (*names.split(), "solvers", "filters", "bases")
    assert all(part.title and part.error and part.cost for part in PARTS)


def test_parts_of_other_distributions_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    mine = replace(part(lambda: points(1), "mine"), rank=5)
    entry_points = [
        SimpleNamespace(name=name, load=lambda found=found: found) for name, found in (("good", mine), ("bad", len))
    ]
    monkeypatch.setattr("importlib.metadata.entry_points", lambda group: entry_points)
    found = find_parts()
    assert found.names()[0] == "mine" and found.get("mine") is mine
    assert list(found.failures()) == ["bad"]


def test_the_part_of_the_documentation_measures() -> None:
    names = names_of("extending.md", "An accuracy curve")
    H = PSFMatrix(np.random.default_rng(0).random((1, 6, 6, 3, 3)).astype(np.float32))
    curve = measure_curve(names["MEAN_LIGHT"], Subject.of_matrix(H, "H"), 10)
    assert curve.stopped == "" and len(curve.points) == 5
    # the mean of n patterns scatters by 1/sqrt(n)
    assert 0.15 < curve.points[-1].error / curve.points[0].error < 0.4


def numbered(shape: tuple[int, int, int, int, int]) -> PSFMatrix:
    return PSFMatrix(np.arange(np.prod(shape), dtype=np.float32).reshape(shape), depths=np.arange(shape[0]))


def test_a_sample_of_h_is_its_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    H = numbered((5, 2, 3, 9, 9))
    monkeypatch.setattr(module, "SAMPLE_BYTES", 4 * 3 * 6 * 25)
    sample = drain(Subject.of_matrix(H, "H").iter_sample(3))
    np.testing.assert_array_equal(np.asarray(sample.matrix), np.asarray(H)[1:4, :, :, 2:7, 2:7])
    assert sample.scale == H.size / sample.matrix.size and list(sample.matrix.depths) == [1, 2, 3]
    assert sample.notes == ("3 of 5 planes, 3 x 2 positions, 5 x 5 px of the cutout's 9 x 9, of H",)


def test_ht_is_measured_as_its_h_and_samples_are_made_once() -> None:
    H = numbered((3, 2, 3, 5, 7))
    subject = Subject.of_matrix(H.T, "HT")
    np.testing.assert_array_equal(np.asarray(drain(subject.iter_sample(3)).matrix), np.asarray(H))
    assert drain(subject.iter_sample(7)) is drain(subject.iter_sample(3)), "there are no more than three"
    assert drain(subject.iter_patterns()) is drain(subject.iter_patterns())


def test_without_light_there_is_nothing_to_measure() -> None:
    for name in ("storage", "projection", "solvers"):
        for level in (0.0, -1.0):
            H = PSFMatrix(np.full((3, 2, 2, 5, 5), level, np.float32))
            found = measure_curve(PARTS.get(name), Subject.of_matrix(H, "dark.h5"))
            assert not found.points and "expected light in the middle planes, got none" in found.stopped


def test_patterns_keep_their_cutout_and_are_spread() -> None:
    H = numbered((3, 30, 40, 3, 5))
    patterns = drain(Subject.of_matrix(H, "H").iter_patterns())
    assert patterns.values.shape == (8, 8, 3, 5) and patterns.scale == 3 * 30 * 40 / 64
    np.testing.assert_array_equal(patterns.values[0, 0], H[1, 0, 0])
    np.testing.assert_array_equal(patterns.values[-1, -1], H[1, 29, 39])


@pytest.mark.long
def test_a_simulated_sample_is_the_middle_of_a_simulated_h(plan: ScanPlan, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SAMPLE_BYTES", 4 * 9 * 15 * 15)
    monkeypatch.setattr(module, "LONGEST_WAVES", 0.0)
    sample = drain(Subject("small", plan).iter_sample(1))
    effects = plan_effects(plan, module.EFFECTS_TOLERANCE)
    middle = replace(plan, depths_um=plan.depths_um[1:2], exposure_s=plan.exposures[1:2])
    (whole,) = simulate_psf(middle, effects, level="geometric", tolerance=module.TOLERANCE)
    np.testing.assert_allclose(sample.matrix[0], whole[:, :, 3:18, 3:18], atol=1e-6 * float(whole.max()))
    assert "by rays" in sample.notes[0] or "level geometric, because wave optics takes longer" in sample.notes[0]


@pytest.mark.long
def test_the_plan_of_a_simulated_h_is_the_recorded_one(plan: ScanPlan, tmp_path: Path) -> None:
    with simulate_psf(plan, (), "geometric", out=tmp_path / "H.h5", provenance={"plan": plan.to_dict()}) as H:
        assert Subject.of_matrix(H, "H").planned == plan


def test_the_plan_of_other_h_follows_from_its_camera(plan: ScanPlan) -> None:
    known = {"camera": plan.camera, "depths": plan.depths_um, "anchor": plan.anchor}
    # a plan that anyone may have written is not believed
    for recorded in (None, {"format": "lfcal-plan"}, "plan", {"format": "lfcal-plan", "version": 1, "x": []}):
        H = PSFMatrix(np.ones(plan.shape, np.float32), **known, provenance={"plan": recorded} if recorded else {})
        found = Subject.of_matrix(H, "H").planned
        assert (found.camera, found.shape, found.anchor) == (plan.camera, plan.shape, plan.anchor), recorded
        assert found.depths_um == plan.depths_um


def test_subjects_without_a_fitting_camera_are_refused(plan: ScanPlan, tmp_path: Path) -> None:
    save(numbered((1, 2, 2, 3, 3)), tmp_path / "H.h5")
    with open_psf(tmp_path / "H.h5") as H, pytest.raises(InputError, match="got H of an unknown camera"):
        _ = Subject.of_matrix(H, "H").planned
    with pytest.raises(InputError, match="subject of the accuracy measurement"):
        Subject("nothing")
    H = PSFMatrix(np.ones((1, 3, 3, 201, 201), np.float32), camera=plan.camera, depths=[-2e4], anchor=plan.anchor)
    with pytest.raises(InputError, match="a camera that does not fit H"):
        _ = Subject.of_matrix(H, "H").planned


@pytest.mark.long
def test_a_sample_is_simulated_at_the_level_of_its_sampling() -> None:
    """For this plan, the fastest sampling of waves is that of a grid, which windows about lenslets cannot use."""
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=55)
    sample = drain(Subject("bench", plan, workers=1).iter_sample(1))
    assert "level grid" in sample.notes[0], sample.notes
