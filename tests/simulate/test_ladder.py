"""Accuracy against time on a ladder of samplings; forecasts of seconds and of memory."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import Microscope, ScanPlan, preset
from lfcal.simulate import (
    Ladder,
    PlaneResponse,
    Sampling,
    draw_ladder,
    iter_ladder,
    ladder,
    predict_bytes,
    predict_seconds,
    simulate_psf,
)
from lfcal.simulate.accuracy import LadderRung, _work, cost, forecast, rung_label
from lfcal.simulate.accuracy._ladder import _marked, _places
from lfcal.simulate.engines import EnergyError
from lfcal.work import RunChoice
from tests.simulate.common import BASE, peak_bytes, small_camera, small_plan

COARSE_TO_FINE = [
    Sampling(nodes_per_px=2, margin_px=3),
    Sampling(nodes_per_px=4, margin_px=5),
    Sampling(nodes_per_px=5, margin_px=12, coherent=True),
]


@pytest.fixture(scope="module")
def measured(pytestconfig: pytest.Config) -> Ladder:
    plan, positions = small_plan(cutout=51), 2 if pytestconfig.getoption("--long") else 1
    return ladder(plan, 0.05, positions=positions, samplings=COARSE_TO_FINE)


@pytest.mark.long
def test_finer_samplings_come_closer_to_the_reference(measured: Ladder) -> None:
    errors = {r.label: r.error for r in measured.rungs}
    assert errors["geometric"] > 0.2
    ordered = [errors[rung_label("wave", sampling)] for sampling in COARSE_TO_FINE]
    assert sorted(ordered, reverse=True) == ordered and ordered[-1] < 0.015
    assert measured.refused == () and measured.positions == 2
    assert measured.virtual_depth == pytest.approx(4.0)


@pytest.mark.long
def test_the_picked_rung_is_the_fastest_within_the_tolerance(measured: Ladder, tmp_path: Path) -> None:
    picked = measured.chosen
    assert picked is not None and picked.error <= 0.05
    for rung in measured.rungs:
        assert rung.error > 0.05 or rung.whole_seconds >= picked.whole_seconds
    assert picked.efficient and measured.reference_seconds > 20 * picked.whole_seconds
    assert replace(measured, tolerance=1e-9).chosen == min(measured.rungs, key=lambda r: r.error)
    assert replace(measured, rungs=()).chosen is None
    draw_ladder(measured, tmp_path / "ladder.png")
    assert (tmp_path / "ladder.png").stat().st_size > 10_000


def test_efficient_rungs_are_beaten_by_no_other_and_places_spread_over_the_period() -> None:
    points = [(1.0, 0.5), (2.0, 0.1), (2.5, 0.2), (3.0, 0.05), (3.0, 0.04), (9.0, 0.04)]
    rungs = _marked([LadderRung("wave", None, str(k), e, 0.0, 0.0, t) for k, (t, e) in enumerate(points)])
    assert [r.label for r in rungs if r.efficient] == ["0", "1", "4"]
    places = np.array(_places((55, 95), 40))
    assert len({tuple(p) for p in places}) == 40 and (places >= 0).all() and (places < (55, 95)).all()
    assert np.abs(places.mean(0) / (55, 95) - 0.5).max() < 0.06


def test_progress_shows_the_rungs_so_far() -> None:
    running = iter_ladder(small_plan(cutout=41), 0.05, positions=1, samplings=COARSE_TO_FINE[:1])
    records = [next(running) for _ in range(3)]
    running.close()
    found = [getattr(record, "ladder", None) for record in records]
    assert records[0].total == 3 and found[0] is None and found[1].rungs == ()
    assert [rung.label for rung in found[2].rungs] == ["geometric"]
    with pytest.raises(InputError, match="plane"):
        ladder(small_plan(), z=3)


def test_too_coarse_a_sampling_is_refused_by_its_energy() -> None:
    plan = small_plan(cutout=41)
    found = ladder(plan, positions=1, samplings=[Sampling(nodes_per_px=1, margin_px=2)])
    assert len(found.refused) == 1 and [r.level for r in found.rungs] == ["geometric"]


@pytest.mark.long
@pytest.mark.parametrize("case", ["microscope", "two planes"])
@pytest.mark.few(1)
def test_seconds_are_forecast(case: str) -> None:
    """Within 1.5 on a quiet machine (`benchmarks accuracy --check`); here within 4, for processors are shared."""
    if case == "microscope":
        camera = preset("lfm_20x05")
        plan = ScanPlan.for_camera(camera, depths_um=[15.0], cutout=91)
    else:
        plan = ScanPlan.for_camera(small_camera(), virtual_depths=[4.0, 2.5])
    effects = BASE if case != "microscope" else "auto"
    simulate_psf(replace(plan, period=(1, 2)), effects, tolerance=0.12)  # compile
    forecast_s = predict_seconds(plan, effects, tolerance=0.12)
    start = time.process_time()
    simulate_psf(plan, effects, tolerance=0.12, workers=1)
    spent = time.process_time() - start
    assert spent / 4 < forecast_s < 4 * spent + 0.1


@pytest.mark.parametrize(("probes", "counted"), [((0.5, 0.1), 0.1), ((3.0, 0.1), 3.0)])
def test_what_a_session_computes_once_is_not_forecast(probes, counted, monkeypatch):
    """A short probe is timed again when kernels and shared tables are there; a long one is not repeated."""
    camera = small_camera()
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[4.0], cutout=21), period=(2, 2))
    now, costs, real = [0.0], list(probes), PlaneResponse.engine

    def engine(self: PlaneResponse, *given: Any) -> Any:
        now[0] += costs.pop(0)
        return real(self, *given)

    monkeypatch.setattr(PlaneResponse, "engine", engine)
    monkeypatch.setattr(forecast, "engine_clock", lambda: now[0])
    monkeypatch.setattr(forecast, "plane_seconds", lambda engine: 2.0)
    assert predict_seconds(plan, (), tolerance=0.2) == pytest.approx(counted + 2.0 + forecast.PER_PLANE, abs=1e-3)


def test_a_forecast_refines_the_sampling_as_the_plane_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """The probe has seen four positions; at others the energy may not balance, and the forecast raised an error."""
    plan = replace(ScanPlan.for_camera(small_camera(), virtual_depths=[4.0], cutout=21), period=(2, 2))
    tried: list[int] = []

    def unbalanced(engine: Any) -> float:
        tried.append(engine.sampling.nodes_per_px)
        if len(tried) % 3:
            raise EnergyError("energy on the sensor")
        return 2.0

    monkeypatch.setattr(_work, "PER_SAMPLE", 100 * _work.PER_SAMPLE)  # windows, whose nodes are counted
    monkeypatch.setattr(cost, "RISK", math.inf)
    monkeypatch.setattr(forecast, "plane_seconds", unbalanced)
    assert 2.0 < predict_seconds(plan, BASE, tolerance=0.2) < 60.0
    assert tried == [tried[0], tried[0] + 1, tried[0] + 2] * 2
    with pytest.raises(EnergyError):
        predict_seconds(plan, BASE, tolerance=0.2, sampling=Sampling(nodes_per_px=2))


TIGHT = 8.0


def plan_of(name: str, where: float) -> ScanPlan:
    camera = preset(name)
    depths = {"depths_um": [where]} if isinstance(camera.optics, Microscope) else {"virtual_depths": [where]}
    return replace(ScanPlan.for_camera(camera, cutout=61, **depths), period=(2, 3))


@pytest.mark.parametrize(
    ("name", "where", "level", "tolerance"),
    [
        ("bench", 4.0, "auto", 0.05),
        ("bench", 4.0, "auto", 0.02),
        ("bench", 0.0, "auto", 0.05),
        ("bench", 4.0, "geometric", 0.05),
        ("bench", 3.0, "reference", 0.03),
        ("lfm_20x05", 5.0, "auto", 0.03),
    ],
)
@pytest.mark.few(3)
def test_the_memory_forecast_is_enough_and_not_many_times_too_much(name, where, level, tolerance):
    plan = plan_of(name, where)
    allowed = predict_bytes(plan, BASE, level, tolerance=tolerance, workers=1)
    _, taken = peak_bytes(lambda: simulate_psf(plan, BASE, level, tolerance=tolerance, workers=1))
    assert taken <= allowed
    assert allowed < TIGHT * taken or allowed < 64 << 20


def test_h_is_counted_whole_or_by_the_plane() -> None:
    camera = small_camera(96, 96)
    plan = replace(ScanPlan.for_camera(camera, virtual_depths=[3.0, 4.0, 5.0, 6.0], cutout=31), period=(40, 40))
    plane = 4 * 40 * 40 * 31 * 31
    whole, by_plane = (predict_bytes(plan, (), to_file=to_file) for to_file in (False, True))
    assert whole - by_plane == 2 * plane and by_plane > 2 * plane
    # more threads need more grids, a given sampling no probe
    few, many = (predict_bytes(plan, BASE, tolerance=0.02, workers=count) for count in (1, 8))
    assert many > few
    apart = RunChoice("processes", workers=8)
    assert predict_bytes(plan, BASE, tolerance=0.02, workers=8, run=apart) == 8 * few, "each process has its engines"
    stored = predict_bytes(plan, BASE, tolerance=0.02, workers=1, store_tolerance=0.01)
    assert stored == few + 6 * plane // 4
    assert predict_bytes(plan, BASE, sampling=Sampling(nodes_per_px=3), workers=1) < few
    double = Sampling(nodes_per_px=3, double=True)
    assert predict_bytes(plan, BASE, sampling=double) > predict_bytes(
        plan, BASE, sampling=replace(double, double=False)
    )
