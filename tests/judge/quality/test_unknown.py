"""Values that were not measured are unknown everywhere: never zero, never good."""

from __future__ import annotations

import dataclasses
import json
import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from lfcal.base._plain import plain
from lfcal.base.progress import drain
from lfcal.judge import Inspection
from lfcal.judge.quality import METRICS, UNKNOWN, Limits, Metric, QualityReport, Reading, inspect
from lfcal.judge.quality.metric import judge
from lfcal.judge.quality.verdict import counted_words
from lfcal.judge.report import iter_report
from lfcal.psf import Facts, PSFMatrix
from tests.judge.plain_report import undrawn

from .faults import base, matrix
from .scenes import hexagonal, single


def saturation(counts: NDArray[np.int32] | None) -> Metric:
    """Return the metric of a good H with these counts; -1 where saturation was not counted."""
    scene = single()
    H = PSFMatrix(base(scene), depths=scene.depths, camera=scene.camera, saturated=counts)
    return inspect(H, workers=1)["saturation"]


def zeros() -> NDArray[np.int32]:
    return np.zeros((len(single().virtual_depths), *single().period), np.int32)


def test_saturation_is_unknown_unless_enough_was_counted() -> None:
    for counts in (None, zeros() - 1):
        found = saturation(counts)
        assert found.merit == "unknown" and math.isnan(found.value) and np.isnan(found.per_plane).all()
    found = saturation(zeros())
    assert (found.merit, found.value, found.detail) == ("good", 0.0, "")
    for where in (1, (1, 2, 3)):
        counts = zeros()
        counts[where] = -1
        found = saturation(counts)
        assert found.merit == "unknown" and math.isnan(found.value)
        if where != 1:
            assert found.detail == f"counted at {counts[0].size - 1} of {counts[0].size} positions"
            assert found.map is not None and np.isnan(found.map[1, 2, 3]) and found.map[1, 0, 0] == 0
        counts[0, 4, 5] = 30
        found = saturation(counts)
        assert found.merit == "bad" and found.value == 30 and found.positions.tolist() == [[0, 4, 5]]
    scene = single()
    found = inspect(matrix(scene, np.minimum(base(scene) * 1.8, np.float32(4031))))["saturation"]
    assert found.merit == "bad" and "suspected" in found.detail, "equal highest values"


@pytest.fixture(scope="module")
def report() -> QualityReport:
    """Return the report of a good H without camera or counts."""
    return inspect(PSFMatrix(base(hexagonal())))


def test_unknown_is_unknown_in_json(report: QualityReport) -> None:
    lines = {m["key"]: m for m in json.loads(json.dumps(plain(report.to_dict(every=True))))["metrics"]}
    for key in ("saturation", "period", "depth", "tiling"):
        line = lines[key]
        assert (line["merit"], line["value"], line["cost"], line["advice"]) == ("unknown", None, None, "")
        assert set(line["per_plane"]) == {None}
    assert math.isfinite(report.cost)


def test_unknown_is_unknown_for_people(
    report: QualityReport, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lfcal_gui.pages.h.model_checks import checks_of

    undrawn(monkeypatch)
    found = Inspection(report, (), 0, 0.0, "no camera is known", 0.0)
    rows = {row.found: row for row in checks_of(found, every=True)}
    dark = next(metric for metric in report.metrics if metric.key == "saturation")
    assert dark not in [row.found for row in checks_of(found)], "metrics that do not apply are counted"
    assert "not applicable" in counted_words(report.metrics)
    assert (rows[dark].value, rows[dark].merit, rows[dark].cost) == ("unknown", "unknown", "–")
    assert "not compared with a camera" in report.verdict and report.merit == "good"
    folder = tmp_path_factory.mktemp("report")
    work = iter_report(PSFMatrix(base(hexagonal())), folder, inspection=Inspection(report), every=True)
    text = drain(work).read_text(encoding="utf-8")
    row = text[text.index("Saturated pixels") - 200 :][:400]
    assert '<span class="merit unknown">unknown</span>' in row and ">unknown</td>" in row and "nan" not in row


def test_no_metric_is_good_unmeasured(report: QualityReport) -> None:
    for spec in METRICS:
        found = judge(spec, [UNKNOWN, UNKNOWN], (2, 3, 4))
        assert (found.merit, found.text, found.cost_text) == ("unknown", "unknown", "—"), spec.key
        assert math.isnan(found.value) and math.isnan(found.cost) and found.map is None, spec.key
    metrics = tuple(judge(m.spec, [UNKNOWN], (1, 3, 3)) for m in report.metrics[:3])
    nothing = dataclasses.replace(report, metrics=metrics)
    assert nothing.merit == "unknown" and nothing.cost == 0 and "not known whether" in nothing.verdict
    assert nothing.redo() == []


def test_metrics_that_need_light_are_unknown_in_the_dark() -> None:
    found = inspect(np.random.default_rng(0).normal(0, 3, (1, 5, 6, 21, 21)).astype(np.float32))
    for metric in found.metrics:
        if metric.spec.of_plane is not None and metric.spec.needs_light:
            assert metric.merit == "unknown", metric.key
    assert found["planes_lit"].merit == "bad"


def test_a_frame_out_of_focus_is_named_to_be_recorded_again() -> None:
    """Its change is 8 times the usual: beyond the limit, and far from any other."""
    values = base(hexagonal())
    values[1, 4, 7] = ndimage.gaussian_filter(values[1, 4, 7], 2)
    found = inspect(matrix(hexagonal(), values))
    assert 4 < found["step"].value < 20
    assert found["step"].positions.tolist() == [[1, 4, 7]]
    assert found.redo() == [((1, 4, 7), "unusual frames")]


def test_a_metric_is_checked_when_it_is_made_and_when_it_answers() -> None:
    spec = METRICS.get("missing")
    for make, words in (
        (lambda: dataclasses.replace(spec, of_plane=None), "one function"),
        (lambda: dataclasses.replace(spec, of_matrix=lambda h: [UNKNOWN]), "one function"),
        (lambda: dataclasses.replace(spec, advice=""), "advice is empty"),
        (lambda: Limits(good=2.0, bad=1.0), "must not be worse"),
        (lambda: judge(spec, [UNKNOWN, UNKNOWN], (3, 4, 5)), "1 or 3 readings"),
        (lambda: judge(spec, [Reading(1.0, map=np.zeros((5, 4)))], (1, 4, 5)), r"maps of \(4, 5\)"),
    ):
        with pytest.raises(ValueError, match=words):
            make()


def test_shares_of_no_light_are_unknown() -> None:
    # of a signed H whose values sum to less than nothing, shares of light were 1e300
    values = np.random.default_rng(31).standard_normal((2, 6, 6, 15, 15)).astype(np.float32)
    values[:, :, :, 5:10, 5:10] -= 6.0
    values[:, :, :, 7, 7] += 60.0
    assert values.sum() < 0
    found = inspect(PSFMatrix(values), workers=1)
    for key in ("flicker", "lamp", "background"):
        assert found[key].merit == "unknown" and math.isnan(found[key].value), key


def test_small_cutouts_and_few_positions_leave_metrics_unknown() -> None:
    for cutout in ((7, 7), (5, 9), (1, 15), (1, 1)):
        values = np.abs(np.random.default_rng(0).standard_normal((1, 3, 3, *cutout))).astype(np.float32)
        assert inspect(PSFMatrix(values), workers=1).apertures[0].refusal == "too small", cutout
    y, x = np.mgrid[-10:11, -10:11]
    for period, unknown in (((1, 1), ("lamp", "flicker")), ((1, 3), ("lamp",))):
        values = 1000 * np.exp(-(y**2 + x**2) / 8) + np.random.default_rng(0).normal(0, 1, (1, *period, 21, 21))
        found = inspect(PSFMatrix(values.astype(np.float32)), workers=1)
        for key in unknown:
            assert found[key].merit == "unknown" and math.isnan(found[key].value), key


# -- the noise of dark pixels compared with the sensor's -------------------------------------------------
SIGMA = 0.002
"""Noise of the scene, over the brightest pixel."""


def noisy(stated: float | None, slope: float = 1e-4) -> QualityReport:
    scene = hexagonal()
    values = base(scene).astype(np.float64)
    values = values / values.max() + SIGMA * np.random.default_rng(4).standard_normal(values.shape)
    if stated is None:
        return inspect(PSFMatrix(values.astype(np.float32), depths=scene.depths))
    noise = np.broadcast_to(np.array([stated**2, slope]), (*values.shape[:3], 2))
    facts = Facts.of(values.shape[:3], (values.shape[3], values.shape[4]), noise=noise)
    return inspect(PSFMatrix(values.astype(np.float32), depths=scene.depths, facts=facts))


@pytest.mark.few(2)
@pytest.mark.parametrize(
    ("stated", "ratio", "merit"), [(SIGMA, 1, "good"), (SIGMA / 4, 4, "bad"), (4 * SIGMA, 4, "bad")]
)
def test_noise_is_compared_with_the_sensors(stated: float, ratio: float, merit: str) -> None:
    found = noisy(stated)["noise"]
    assert found.merit == merit and found.value == pytest.approx(ratio, rel=0.15)
    assert ("less noise" in str(found)) == (stated > SIGMA)


def test_without_figures_of_the_sensor_it_is_unknown() -> None:
    assert noisy(None)["noise"].merit == "unknown"
    assert noisy(SIGMA, slope=0.0)["noise"].merit == "unknown", "taken from repeats: no figure of the sensor"


# -- repeated frames of a position -----------------------------------------------------------------------
def test_spread_of_repeats_is_judged_and_unknown_without() -> None:
    scene = hexagonal()
    values = base(scene)
    nz, ny, nx, nt, ns = values.shape
    alone = inspect(PSFMatrix(values, depths=scene.depths))["repeatability"]
    assert alone.merit == "unknown" and np.isnan(alone.value)
    spread = np.full((nz, ny, nx), np.nan)
    spread[0, 3, :5] = 0.4  # five positions of the first plane were recorded twice, and differ
    facts = Facts.of((nz, ny, nx), (nt, ns), recorded=np.ones((nz, ny, nx)), spread=spread)
    found = inspect(PSFMatrix(values, depths=scene.depths, facts=facts))["repeatability"]
    assert found.merit == "bad" and np.isclose(found.value, 40.0)
    facts = Facts.of((nz, ny, nx), (nt, ns), spread=np.where(np.isnan(spread), np.nan, 0.02))
    assert inspect(PSFMatrix(values, depths=scene.depths, facts=facts))["repeatability"].merit == "good"
