"""The inspection of H by metrics: its numbers, its order, its verdict, and any input."""

from __future__ import annotations

import json
import math
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import plain
from lfcal.base.errors import InputError
from lfcal.judge.quality import METRICS, QualityReport, inspect, iter_inspect
from lfcal.judge.quality.metric import Reading, judge
from lfcal.judge.quality.verdict import counted, counted_words
from lfcal.psf import PSFMatrix

from .faults import NOISE, base, matrix
from .scenes import hexagonal, single, square


@pytest.fixture(scope="module")
def report():
    return inspect(matrix(hexagonal(), base(hexagonal())))


def test_every_metric_of_the_catalogue_is_there_once(report):
    assert sorted(m.key for m in report.metrics) == sorted(METRICS.names())
    assert len(METRICS) >= 31 and not METRICS.failures()
    assert all(s.meaning.endswith(".") and s.advice.endswith(".") for s in METRICS)


def test_noise_depths_f_number_and_flicker_are_those_of_the_scene(report):
    assert report.noise == pytest.approx(NOISE, rel=0.03)
    assert report.virtual_depths == pytest.approx(hexagonal().virtual_depths, rel=0.03)
    assert report.f_number.value == pytest.approx(4.8, rel=0.02)
    assert report["flicker"].value == pytest.approx(1.0, abs=0.2)
    data = json.loads(json.dumps(plain(report.to_dict()), allow_nan=False))
    assert data["merit"] == "good" and len(data["planes"]) == 3
    assert data["metrics"][0]["key"] == report.metrics[0].key


@pytest.mark.long
def test_the_f_number_of_a_square_array_comes_out():
    report = inspect(matrix(square(), base(square())))
    assert report.f_number.value == pytest.approx(20.0, rel=0.02)


def test_bad_metrics_come_first_and_costly_ones_before_cheap_ones():
    values = base(hexagonal())
    values[1, 3, 4] = 0
    values += 15
    report = inspect(matrix(hexagonal(), values))
    merits = [{"bad": 0, "fair": 1, "good": 2, "unknown": 3}[m.merit] for m in report.metrics]
    assert merits == sorted(merits)
    costs = [m.cost for m in report.alarms]
    assert len(costs) >= 2 and costs == sorted(costs, reverse=True)


@pytest.mark.long
def test_views_threads_and_types_give_the_same_answer():
    H = matrix(single(), base(single()))
    one, many, double = inspect(H, workers=1), inspect(H.T, workers=3), inspect(matrix(single(), H[:].astype(float)))
    for metric in one.metrics:
        assert metric.value == pytest.approx(many[metric.key].value, rel=1e-9, nan_ok=True), metric.key
    for key in ("snr", "position", "flicker", "truncation"):
        assert one[key].value == pytest.approx(double[key].value, rel=1e-4), key
    counts = np.clip(np.round(base(single()) + 64), 0, None).astype(np.uint16)
    report = inspect(matrix(single(), counts, offset=-64.0))
    assert report.merit == "good", [(m.key, m.text) for m in report.metrics if m.merit != "good"]


def test_progress_counts_up_and_closing_stops():
    work = iter_inspect(matrix(single(), base(single())))
    first, second = next(work), next(work)
    assert (first.done, second.done) == (0, 1) and first.total == 12
    work.close()


@pytest.mark.long
def test_memory_stays_within_two_planes():
    values = base(hexagonal())
    plane = values[0].nbytes
    H = matrix(hexagonal(), np.repeat(values, 2, axis=0), depths=np.arange(6.0), camera=None)
    inspect(H)
    tracemalloc.start()
    inspect(H)
    assert tracemalloc.get_traced_memory()[1] < 2 * plane + 20e6
    tracemalloc.stop()


def test_a_single_position_and_a_single_plane_are_no_trouble():
    report = inspect(np.random.default_rng(0).random((1, 1, 1, 31, 31)).astype(np.float32))
    assert report.shape == (1, 1, 1, 31, 31)
    assert math.isnan(report["seam"].value)


def test_an_empty_matrix_is_bad_and_broken_ones_are_found():
    for fill in (0.0, np.nan, 3.0):
        assert inspect(np.full((2, 5, 7, 21, 21), fill, np.float32)).merit == "bad", fill
    values = base(single())
    sums = values.sum((1, 2), dtype=np.float64) * 1.01
    assert inspect(matrix(single(), values, depth_sums=sums))["identities"].merit == "bad"
    with pytest.raises(InputError, match="real numbers"):
        inspect(PSFMatrix(np.ones((1, 3, 3, 9, 9), complex)))


def test_merit_and_cost_follow_the_thresholds():
    snr = METRICS.get("snr")
    assert [snr.limits.merit(v) for v in (100, 99, 20, 19, math.nan)] == ["good", "fair", "fair", "bad", "unknown"]
    assert snr.cost.of(40, snr.limits) == pytest.approx(0.25) and snr.cost.of(1, snr.limits) == snr.cost.worst
    missing = METRICS.get("missing")
    assert missing.cost.of(30, missing.limits, 1000) == pytest.approx(0.225, abs=0.01)
    shape = (2, 5, 100)
    assert judge(missing, [Reading(0.0), Reading(2.0)], shape).value == 2
    assert judge(snr, [Reading(300.0), Reading(50.0)], shape).value == 50


# -- the verdict: what is wrong, where, what it costs, the remedy, and what remains ----------------------
FIVE = np.array([(0, 3, 4), (1, 2, 7), (2, 5, 1), (2, 5, 2), (3, 8, 8)], np.intp)


@pytest.fixture(scope="module")
def clean() -> QualityReport:
    return inspect(PSFMatrix(base(hexagonal())))


def with_misplaced(clean: QualityReport, shape: tuple[int, int, int]) -> QualityReport:
    """Return the report of an H of so many positions of which five are misplaced."""
    spec = clean["misplaced"].spec
    frames = int(np.prod(shape))
    cost = spec.cost.of(5.0, spec.limits, frames)
    one = replace(clean["misplaced"], value=5.0, merit="bad", cost=cost, positions=FIVE)
    metrics = tuple(one if m.key == "misplaced" else m for m in clean.metrics)
    return replace(clean, shape=(*shape, 41, 41), metrics=metrics)


def test_five_of_many_positions_make_a_good_H_with_five_to_repeat(clean: QualityReport) -> None:
    found = with_misplaced(clean, (9, 19, 33))
    assert found.merit == "good" and len(found.redo()) == 5
    assert found.verdict.startswith("This H is good but for 5 positions to record again: misplaced frames.")
    assert "5 of 5,643 positions (z, y, x): (0, 3, 4), (1, 2, 7), (2, 5, 1) …" in found.verdict
    assert "it costs 0.018 (NRMSE, typical)" in found.verdict and "Record these positions again" in found.verdict
    assert f"What remains is good by {counted(found.metrics)['good'] - 1} checks" in found.verdict


def test_five_of_few_positions_must_not_be_used(clean: QualityReport) -> None:
    found = with_misplaced(clean, (4, 10, 10))
    assert found.merit == "fair" and "What remains is good" in found.verdict
    assert with_misplaced(clean, (4, 5, 5)).merit == "bad"


def test_a_value_without_bound_is_shown(clean: QualityReport) -> None:
    """The contrast of an H without any noise, for one; it once ended the list of checks with an OverflowError."""
    metric = clean["misplaced"]
    unit = f" {metric.spec.unit}" if metric.spec.unit else ""
    assert [replace(metric, value=v).text for v in (np.inf, -np.inf)] == [f"∞{unit}", f"-∞{unit}"]


def test_the_metrics_are_counted(clean: QualityReport) -> None:
    words = counted_words(clean.metrics)
    assert sum(counted(clean.metrics).values()) == len(clean.metrics)
    assert words.endswith("not applicable") and " good" in words and "1 unknown" in words
