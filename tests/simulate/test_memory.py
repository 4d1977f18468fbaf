"""Memory foretold is enough, and not many times too much; `tests/fuzz` holds it for random cameras."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lfcal.camera import Microscope, ScanPlan, preset
from lfcal.simulate import predict_bytes, simulate_psf
from lfcal.simulate.engines.base import Sampling
from lfcal.work import RunChoice
from tests.simulate.common import BASE, peak_bytes, small_camera

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
@pytest.mark.few(4)
def test_it_is_enough_and_not_many_times_too_much(name: str, where: float, level: str, tolerance: float) -> None:
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
