"""A scan that is moved so that its cutouts lie on the sensor."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, moved_onto_sensor, preset

BENCH = preset("bench")


def plan_at(row: float, column: float, **options: bool) -> ScanPlan:
    return ScanPlan.for_camera(BENCH, virtual_depths=(3.0,), cutout=41, anchor=(row, column), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("cutout", [(41, 41), (101, 41), (61, 141), (251, 201)])
@pytest.mark.parametrize("anchor", [(20.0, 20.0), (150.0, 144.0), (281.0, 20.25), (280.5, 267.0)])
def test_the_scan_moves_to_the_nearest_place_of_the_same_phase(
    anchor: tuple[float, float], cutout: tuple[int, int]
) -> None:
    plan = plan_at(*anchor)
    moved = moved_onto_sensor(plan, cutout=cutout)
    assert moved == replace(plan, cutout=cutout, anchor=moved.anchor)
    for axis in (0, 1):
        exact, shift = plan.cell_camera.period_px[axis], moved.anchor[axis] - plan.anchor[axis]
        pixel, half = np.floor(plan.anchor[axis] + 0.5), (cutout[axis] - 1) // 2
        free = np.arange(half, 320 - half - plan.period[axis] + 1)
        if pixel in free:
            assert shift == 0
            continue
        # by whole periods to the nearest pixel that does, by brute force; else to the nearest pixel at all
        steps = {round(k * exact) for k in range(-30, 31)}
        same_phase = [p for p in free if p - pixel in steps]
        wanted = min(same_phase or free, key=lambda p: abs(p - pixel))
        assert shift == wanted - pixel


def test_a_place_off_the_sensor_becomes_the_nearest_one_on_it() -> None:
    plan = plan_at(150.0, 144.0)
    moved = moved_onto_sensor(plan, anchor=(-40.0, 5000.0))
    # 3 periods of 19 rows lead to 17, which is off by 3 px: 4 of them
    assert moved.anchor[0] == -40 + round(4 * plan.cell_camera.period_px[0])
    assert moved.anchor[1] <= 320 - 33 - 20 and (5000 - moved.anchor[1]) % 33 == 0


def test_resampled_frames_move_by_the_array_s_own_period() -> None:
    plan = plan_at(20.0, 144.0, resample=True)
    moved = moved_onto_sensor(plan, cutout=(61, 41))
    shift = (moved.anchor[0] - plan.anchor[0]) / plan.cell_camera.period_px[0]
    assert shift == pytest.approx(round(shift), abs=1e-9) and shift > 0.5
    assert moved.lattice_anchor[0] == pytest.approx(plan.lattice_anchor[0], abs=1e-6)


def test_a_cutout_that_fits_nowhere_is_refused_with_the_largest_that_fits() -> None:
    plan = plan_at(150.0, 144.0)
    with pytest.raises(InputError, match="at most 301 rows on a sensor of 320"):
        moved_onto_sensor(plan, cutout=(303, 41))
    assert moved_onto_sensor(plan, cutout=(301, 41)).cutout == (301, 41)
    with pytest.raises(InputError, match="odd"):
        moved_onto_sensor(plan, cutout=(40, 41))


@pytest.mark.parametrize("order", ["serpentine", "raster"])
@pytest.mark.parametrize("period", [(3, 4), (4, 3), (1, 5), (5, 1), (2, 2), (19, 33)])
def test_the_ends_of_the_rows_are_in_scan_order(order: str, period: tuple[int, int]) -> None:
    depths = tuple(BENCH.depth_of(v) for v in (3.0, 4.0, 5.0))
    plan = ScanPlan(BENCH, period, (41, 41), depths, (150, 144), order=order, resample=period == (19, 33))
    ends, every = plan.row_ends(), plan.order_indices()
    last = period[1] - 1
    wanted = every[(every[:, 2] == 0) | (every[:, 2] == last)]
    assert (ends == wanted).all()
    way = np.abs(np.diff(plan.stage_um(ends), axis=0)).max(axis=1).sum()
    assert math.isclose(way, np.abs(np.diff(plan.stage_um(every), axis=0)).max(axis=1).sum(), rel_tol=1e-12)
