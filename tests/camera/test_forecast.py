from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Forecast, ScanPlan, preset


def plan(**options: object) -> ScanPlan:
    return ScanPlan(preset("r29"), (55, 95), (181, 181), (-50e3, -40e3), (2000.0, 3000.0), **options)  # type: ignore[arg-type]


def test_counts_and_bytes_follow_from_the_shape() -> None:
    cost = Forecast.of(plan(frames_averaged=3, exposure_s=(0.1, 0.2), settle_s=0.5))
    n = 2 * 55 * 95
    assert (cost.positions, cost.frames) == (n, 3 * n)
    assert cost.exposure_hours == pytest.approx((0.1 + 0.2) * 3 * 5225 / 3600)
    assert cost.settle_hours == pytest.approx(0.5 * n / 3600)
    assert cost.frame_bytes == 3 * n * 4384 * 6576 * 2
    assert cost.cutout_bytes == n * 181 * 181 * 2 and cost.h_rounded_bytes == n * 181 * 181 * 21 // 8
    assert cost.h_float32_bytes == cost.ht_float32_bytes == np.zeros(1, np.float32).nbytes * n * 181 * 181
    assert cost.assembly_bytes == 2 * 5225 * 181 * 181 * 4  # 1.37 GB: two planes of 685 MB
    assert cost.hours == pytest.approx(cost.exposure_hours + cost.settle_hours + cost.move_hours)


def test_moving_time_is_the_walked_way_over_the_speed() -> None:
    scan = plan()
    camera = scan.camera
    lateral = sum((55 * 95 - 1) * camera.step_um(z) for z in scan.depths_um)
    cost = Forecast.of(scan, stage_um_per_s=500.0)
    assert cost.move_hours * 3600 * 500.0 == pytest.approx(lateral + 10e3, rel=1e-9)
    back = Forecast.of(plan(order="raster"), stage_um_per_s=500.0)
    assert 1.5 < back.move_hours / cost.move_hours < 2.0


def test_each_frame_is_read_out_after_its_exposure() -> None:
    """The stage waits for the frame: the camera's least time between frames adds to all else."""
    scan = plan(frames_averaged=3, exposure_s=0.1)
    unknown, known = Forecast.of(scan), Forecast.of(scan, frames_per_s=5.0)
    assert unknown.readout_hours is None and known.readout_hours == pytest.approx(known.frames / 5 / 3600)
    assert known.hours - unknown.hours == pytest.approx(known.readout_hours)
    assert unknown.bytes_per_s == pytest.approx(unknown.frame_bytes / (3600 * unknown.hours))
    assert known.bytes_per_s < 5.0 * known.frame_bytes / known.frames, "no more than the camera delivers"
    some = Forecast.of(scan, frames_per_s=5.0, positions=scan.order_indices()[:10])
    assert some.readout_hours == pytest.approx(30 / 5 / 3600)


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf"), 1e-300])
def test_a_camera_must_deliver(rate: float) -> None:
    with pytest.raises(InputError, match=r"frame rate \(frames/s\)"):
        Forecast.of(plan(), frames_per_s=rate)


def test_a_stage_must_move() -> None:
    with pytest.raises(InputError, match="stage speed"):
        Forecast.of(plan(), stage_um_per_s=0.0)
    with pytest.raises(InputError, match="stage speed"):
        Forecast.of(plan(), stage_um_per_s=5e-324)  # it would never arrive
