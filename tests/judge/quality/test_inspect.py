import json
import math
import tracemalloc

import numpy as np
import pytest

from lfcal.base import plain
from lfcal.base.errors import InputError
from lfcal.judge.quality import METRICS, inspect, iter_inspect
from lfcal.judge.quality.metric import Reading, judge
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


def test_noise_peak_and_virtual_depths_are_those_of_the_scene(report):
    assert report.noise == pytest.approx(NOISE, rel=0.03)
    assert report.virtual_depths == pytest.approx(hexagonal().virtual_depths, rel=0.03)
    assert report.f_number.value == pytest.approx(4.8, rel=0.02)


@pytest.mark.long
def test_the_f_number_of_a_square_array_comes_out():
    report = inspect(matrix(square(), base(square())))
    assert report.f_number.value == pytest.approx(20.0, rel=0.02)


def test_flicker_is_what_was_put_in(report):
    assert report["flicker"].value == pytest.approx(1.0, abs=0.2)


def test_bad_metrics_come_first_and_costly_ones_before_cheap_ones():
    values = base(hexagonal())
    values[1, 3, 4] = 0
    values += 15
    report = inspect(matrix(hexagonal(), values))
    merits = [{"bad": 0, "fair": 1, "good": 2, "unknown": 3}[m.merit] for m in report.metrics]
    assert merits == sorted(merits)
    costs = [m.cost for m in report.alarms]
    assert len(costs) >= 2 and costs == sorted(costs, reverse=True)


def test_the_report_is_plain_json(report):
    data = json.loads(json.dumps(plain(report.to_dict()), allow_nan=False))
    assert data["merit"] == "good" and len(data["planes"]) == 3
    assert data["metrics"][0]["key"] == report.metrics[0].key


def test_a_transposed_view_is_judged_by_the_matrix_behind_it():
    H = matrix(single(), base(single()))
    assert inspect(H.T)["seam"].value == inspect(H)["seam"].value


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.few(1)
def test_other_types_give_the_same_answer(dtype):
    values = base(single())
    one, other = inspect(matrix(single(), values)), inspect(matrix(single(), values.astype(dtype)))
    for key in ("snr", "position", "flicker", "truncation"):
        assert one[key].value == pytest.approx(other[key].value, rel=1e-4)


def test_integers_are_judged_by_their_values():
    values = np.clip(np.round(base(single()) + 64), 0, None).astype(np.uint16)
    report = inspect(matrix(single(), values, offset=-64.0))
    assert report.merit == "good", [(m.key, m.text) for m in report.metrics if m.merit != "good"]


def test_one_thread_and_many_agree():
    H = matrix(single(), base(single()))
    one, many = inspect(H, workers=1), inspect(H, workers=3)
    for metric in one.metrics:
        assert metric.value == pytest.approx(many[metric.key].value, rel=1e-9, nan_ok=True)


def test_progress_counts_up_and_closing_stops():
    work = iter_inspect(matrix(single(), base(single())))
    first, second = next(work), next(work)
    assert (first.done, second.done) == (0, 1) and first.total == 12
    work.close()


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


@pytest.mark.parametrize("fill", [0.0, np.nan, 3.0])
def test_an_empty_matrix_is_bad_and_no_crash(fill):
    report = inspect(np.full((2, 5, 7, 21, 21), fill, np.float32))
    assert report.merit == "bad"


def test_a_broken_depth_sum_is_found():
    values = base(single())
    sums = values.sum((1, 2), dtype=np.float64) * 1.01
    assert inspect(matrix(single(), values, depth_sums=sums))["identities"].merit == "bad"


def test_complex_numbers_are_refused():
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
