"""Everything a session will do, in order."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.acquire.options import Options
from lfcal.acquire.recording.records import Kind
from lfcal.acquire.schedule import Schedule, coarse_order, window_shape
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.frames.source import Position
from tests.acquire.rigs import small_plan


@settings(derandomize=True, deadline=None, max_examples=60)
@given(
    st.tuples(st.integers(1, 6), st.integers(1, 6)),
    st.integers(1, 3),
    st.sampled_from(["plan", "coarse"]),
    st.sampled_from(["serpentine", "raster"]),
    st.integers(0, 7),
    st.integers(0, 2),
    st.integers(0, 9),
    st.integers(0, 2),
)
def test_every_position_once_and_every_slot_once(
    period: tuple[int, int], planes: int, order: str, scan: str, reference: int, darks: int, every: int, controls: int
) -> None:
    plan = small_plan(period, planes, order=scan)
    options = Options(order=order, reference_every=reference, darks=darks, dark_every=every, controls=controls)
    schedule = Schedule.of(plan, options)
    steps = list(schedule.steps())
    assert len(steps) == len(schedule)
    taken = [s for s in steps if s.kind is Kind.POSITION]
    assert sorted(s.slot for s in taken) == list(range(plan.n_positions)) == sorted(s.flat for s in taken)
    for s in taken:
        position = np.unravel_index(s.flat, plan.shape[:3])
        assert s.slot == s.flat
        assert s.z == position[0]
        assert np.allclose(s.target, plan.stage_um(np.array(position)))
        image = plan.image_px(np.array(position))
        assert (s.row, s.column) == tuple(int(v) - 10 for v in image)
    files = Counter((s.kind in (Kind.REFERENCE, Kind.CONTROL), s.kind is Kind.DARK, s.slot) for s in steps)
    assert max(files.values()) == 1
    checks = sorted(s.slot for s in steps if s.kind in (Kind.REFERENCE, Kind.CONTROL))
    assert checks == list(range(len(checks)))


def test_plan_order_is_kept_and_extras_come_where_they_should() -> None:
    plan = small_plan()
    options = Options(reference_every=10, darks=3, dark_every=20, controls=1)
    steps = list(Schedule.of(plan, options).steps())
    assert [s.flat for s in steps if s.kind is Kind.POSITION] == [
        int(np.ravel_multi_index(p, plan.shape[:3])) for p in plan.positions()
    ]
    kinds = "".join("PDRC"[s.kind] for s in steps)
    assert kinds == "DR" + "P" * 10 + "R" + "P" * 10 + "DR" + "P" * 7 + "R" + "C" * 12


def test_each_exposure_has_darks_and_the_defaults_cost_little() -> None:
    plan = small_plan(exposure_s=(0.01, 0.02, 0.01))
    steps = [s for s in Schedule.of(plan, Options(darks=2)).steps() if s.kind is Kind.DARK]
    assert [plan.exposures[s.z] for s in steps] == [0.01, 0.02]
    schedule = Schedule.of(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0, 4.0]), Options())
    assert (schedule.count(Kind.POSITION), schedule.count(Kind.DARK)) == (1254, 1)
    assert 2 <= schedule.count(Kind.REFERENCE) <= 0.02 * 1254 and Options().darks >= 2


def test_coarse_order_visits_all_planes_first_and_refines() -> None:
    plan = small_plan((8, 12), 3)
    order = coarse_order(plan)
    assert sorted(map(tuple, order.tolist())) == sorted(plan.positions())
    first = order[:6]
    assert set(first[:, 0].tolist()) == {0, 1, 2}
    seen: set[tuple[int, ...]] = set()
    for pitch in (8, 4, 2):
        grid = {(z, y, x) for z in range(3) for y in range(0, 8, pitch) for x in range(0, 12, pitch)}
        assert set(map(tuple, order[: len(grid)].tolist())) == grid
        assert seen <= grid
        seen = grid


def test_control_frames_lie_whole_periods_away_and_on_the_sensor() -> None:
    plan = small_plan((5, 7), 2)
    schedule = Schedule.of(plan, Options(controls=3))
    steps = [s for s in schedule.steps() if s.kind is Kind.CONTROL]
    assert {(abs(s.period_y), abs(s.period_x)) for s in steps} >= {(1, 0), (0, 1)}
    middle = plan.image_px(np.array([0, 2, 3])) - 10
    for s in steps:
        assert (s.row, s.column) == (middle[0] + 5 * s.period_y, middle[1] + 7 * s.period_x)
        assert 0 <= s.row <= 96 - 21 and 0 <= s.column <= 96 - 21
    farthest = max(s.column for s in steps)
    assert farthest + 21 + 7 > 96 - 7
    roi = schedule.control_roi
    assert (schedule.roi.rows, schedule.roi.columns) == (21 + 4, 21 + 6) and roi.rows > schedule.roi.rows


def test_cutouts_have_a_margin_for_interpolation_and_lie_on_the_sensor() -> None:
    plan = small_plan((3, 3), 1, cutout=(41, 41))
    Schedule.of(plan, Options(margin_px=25))
    with pytest.raises(InputError, match=r"z=0, y=0, x=2.*smaller margin"):
        Schedule.of(plan, Options(margin_px=26))
    plan = small_plan()
    assert window_shape(plan, Options()) == (21, 21)
    between = ScanPlan(plan.camera, (3, 3), (21, 21), plan.depths_um, (48.25, 48.0))
    assert window_shape(between, Options()) == (45, 45)
    assert window_shape(between, Options(margin_px=1)) == (23, 23)


def test_positions_recorded_again_are_taken_once_and_those_done_are_left_out() -> None:
    plan = small_plan()
    redo = [Position(2, 1, 0), Position(0, 0, 1), Position(2, 1, 0)]
    schedule = Schedule.of(plan, Options(reference_every=0), redo)
    assert [(s.slot, s.flat) for s in schedule.steps()] == [(0, 1), (1, 21)]
    with pytest.raises(InputError, match="inside"):
        Schedule.of(plan, Options(), [Position(3, 0, 0)])
    with pytest.raises(InputError, match="at least one"):
        Schedule.of(plan, Options(), [])
    whole, todo = Schedule.of(plan, Options()), np.isin(np.arange(27), [3, 20])
    assert [s.slot for s in whole.steps(todo)] == [s.slot for k, s in enumerate(whole.steps()) if k in (3, 20)]
