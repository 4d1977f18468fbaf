"""Scan plans: positions, places, periods and half of them, files; plans moved onto the sensor; time and bytes."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base import InputError, Position
from lfcal.camera import (
    PRESETS,
    Camera,
    Forecast,
    LensletLattice,
    LensType,
    MainLens,
    Microscope,
    ScanPlan,
    Sensor,
    StageAxes,
    half_cell,
    moved_onto_sensor,
    preset,
)
from lfcal.camera.plan import checked_depths
from tests.camera.strategies import cameras, numbers

QUICK = settings(derandomize=True, deadline=None, max_examples=40)


def r29(**options: Any) -> ScanPlan:
    return ScanPlan.for_camera(preset("r29"), **{"virtual_depths": [4.0], **options})


def test_a_session_like_that_of_the_paper() -> None:
    plan = r29(virtual_depths=np.linspace(1.1, 5.5, 11).tolist(), cutout=181)
    assert plan.period == (55, 95) and plan.shape[1:3] == (55, 95)
    assert plan.period_residual_px == pytest.approx((31.7 * math.sqrt(3) - 55, 0.1))
    assert plan.cells == (1, 1) and plan.tilt_residual_px == 0
    visited = list(plan.positions())
    assert len(visited) == len(set(visited)) == plan.n_positions == 57_475
    assert isinstance(visited[0], Position) and visited[0] == (0, 0, 0)
    assert np.array_equal(np.array(visited), plan.order_indices())


def test_every_preset_can_be_planned() -> None:
    for name in PRESETS:
        camera = preset(name)
        scope = isinstance(camera.optics, Microscope)
        plan = ScanPlan.for_camera(camera, **({"depths_um": [-10.0, 5.0]} if scope else {"virtual_depths": [2.0, 3.0]}))
        assert ScanPlan.from_json(plan.to_json()) == plan
        centre = plan.image_px([0, (plan.period[0] - 1) / 2, (plan.period[1] - 1) / 2])
        assert np.abs(centre - camera.sensor.centre_px).max() <= 0.5
        assert all(n % 2 for n in plan.cutout)


def test_serpentine_moves_one_step_at_a_time_and_raster_always_the_same_way() -> None:
    for shape in ((1, 1, 1), (1, 4, 5), (3, 5, 4), (2, 3, 3), (4, 2, 6), (5, 1, 3)):
        (nz, *period), index = shape, {}
        for order in ("serpentine", "raster"):
            depths = tuple(-1000.0 * k for k in range(nz))
            plan = ScanPlan(preset("bench"), tuple(period), (9, 9), depths, (50.0, 50.0), order=order)
            index[order] = plan.order_indices()
        assert index["raster"].tolist() == [list(p) for p in np.ndindex(shape)]
        assert sorted(map(tuple, index["serpentine"].tolist())) == list(np.ndindex(shape))
        assert (np.abs(np.diff(index["serpentine"], axis=0)).sum(1) == 1).all(), shape


def test_places_agree_with_the_camera() -> None:
    plan = r29(depths_um=(-30e3, 10e3), virtual_depths=None, stage=StageAxes("-x", "+y", "+z", (5.0, 6.0, 7.0)))
    camera, (row0, column0) = plan.camera, plan.anchor
    position = Position(1, 7, 11)
    assert plan.image_px(position).tolist() == [row0 + 7, column0 + 11]
    right, down, away = plan.object_um(position)
    step = camera.step_um(10e3)
    assert plan.step_um(1) == (step, step)
    assert right == pytest.approx((column0 + 11 - 3287.5) * step)
    assert down == pytest.approx((row0 + 7 - 2191.5) * step)
    assert away == 10e3
    assert plan.stage_um(position) == pytest.approx([5.0 - right, 6.0 + down, 7.0 + 10e3])
    assert np.array_equal(plan.stage_um()[0], plan.stage_um(Position(0, 0, 0)))
    steps = np.diff(plan.stage_um(np.array([[0, 0, 0], [0, 0, 1], [0, 1, 1]])), axis=0)
    near = camera.step_um(-30e3)
    assert steps == pytest.approx(np.array([[-near, 0, 0], [0, near, 0]]), abs=1e-6)


def test_the_chief_ray_of_the_anchor_is_straight_through_the_lens() -> None:
    """Moving between planes at fixed y, x follows one line through the centre of the main lens."""
    plan = r29(depths_um=(-60e3, -20e3, 40e3), virtual_depths=None)
    points = plan.object_um(np.array([[z, 3, 90] for z in range(3)]))
    assert isinstance(plan.camera.optics, MainLens)
    distance = plan.camera.optics.working_distance_um + points[:, 2]
    assert np.ptp(points[:, 0] / distance) < 1e-15 and np.ptp(points[:, 1] / distance) < 1e-15


def test_resampling_makes_the_period_whole() -> None:
    plan = r29(resample=True)
    fy, fx = plan.resample_factors
    assert (fy * plan.camera.period_px[0], fx * plan.camera.period_px[1]) == pytest.approx((55, 95))
    assert r29().resample_factors == (1.0, 1.0)
    step = plan.camera.step_um(plan.depths_um[0])
    assert plan.step_um(0) == pytest.approx((step / fy, step / fx))
    walked = plan.image_px([0, 55, 95]) - plan.image_px([0, 0, 0])
    assert walked == pytest.approx(plan.camera.period_px)


def test_a_longer_period_counts_its_cells_and_a_tilt_leaves_a_residual() -> None:
    one, many = (ScanPlan(preset("lfm_60x12"), (n, n), (9, 9), (0.0,), (900.0, 900.0)) for n in (15, 200))
    assert one.period_residual_px == pytest.approx((5 / 13, 5 / 13))
    assert many.cells == (13, 13) and many.period_residual_px == pytest.approx((0.0, 0.0), abs=1e-9)

    def tilted(angle: float) -> ScanPlan:
        lattice = LensletLattice("hexagonal", 174.0, 870.0, rotation_rad=angle)
        return ScanPlan.for_camera(Camera("c", MainLens(), lattice, Sensor()), depths_um=[0.0])

    assert tilted(math.radians(0.05)).tilt_residual_px == pytest.approx(0.048, abs=1e-3)
    assert tilted(math.pi / 2).period == tilted(0.0).period[::-1]
    with pytest.raises(InputError, match="lattice rotation"):
        tilted(math.radians(10))


TYPES = (LensType(900.0), LensType(1000.0), LensType(1100.0))


@pytest.mark.parametrize("step", [1, 2])
def test_the_anchor_is_measured_from_the_nearest_lenslet_of_type_0(step: int) -> None:
    """Brute force over every lenslet, with an anchor next to a lenslet of each type."""
    lattice = LensletLattice("hexagonal", 110.0, 500.0, TYPES, 0.001, (123.0, -45.0), type_step=step)
    camera = Camera("c", MainLens(), lattice, Sensor((801, 1001), 5.0))
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-12, 13), np.arange(-12, 13)))
    centres, types = camera.pixels(lattice.centres_um(q, r)), lattice.type_of(q, r)
    for nearest in (0, 1, 2):
        start = np.flatnonzero((types == nearest) & (np.abs(q) < 4) & (np.abs(r) < 4))[0]
        anchor = centres[start] + (1.5, -2.0)
        away = np.hypot(*(centres - anchor).T)
        assert types[np.argmin(away)] == nearest
        zero = np.flatnonzero(types == 0)[np.argmin(away[types == 0])]
        plan = ScanPlan(camera, (9, 9), (9, 9), (0.0,), tuple(anchor))
        assert plan.lattice_anchor == pytest.approx(tuple(anchor - centres[zero]))
        assert (np.hypot(*plan.lattice_anchor) > 10) == (nearest != 0)


def test_a_cutout_off_the_sensor_names_the_position() -> None:
    plan = r29(cutout=181)
    rows, columns = plan.camera.sensor.shape
    for anchor in ((90.0, 90.0), (rows - 1 - 90.0 - 54, columns - 1 - 90.0 - 94)):
        assert replace(plan, anchor=anchor).anchor == anchor
    for anchor, match in (
        ((89.0, 90.0), "z=0, y=0, x=0: expected rows from 0 to 4383, got rows from -1 to 179"),
        ((2000.0, columns - 184.0), "x=94: expected columns from 0 to 6575, got columns from 6396 to 6576"),
        ((rows - 90.0 - 54, 2000.0), "y=54, x=0"),
    ):
        with pytest.raises(InputError, match=match):
            replace(plan, anchor=anchor)


@given(cameras, st.data())
@QUICK
def test_json_gives_the_plan_back(camera: Camera, data: st.DataObject) -> None:
    far = 400 if isinstance(camera.optics, Microscope) else 3000  # of an objective's focal length, half at most
    planes = data.draw(st.lists(numbers(-far, far), min_size=1, max_size=4, unique=True).map(sorted))
    plan = ScanPlan(
        camera,
        (data.draw(st.integers(1, 60)), data.draw(st.integers(1, 60))),
        (data.draw(st.integers(0, 20)) * 2 + 1, data.draw(st.integers(0, 20)) * 2 + 1),
        tuple(planes[:: data.draw(st.sampled_from([1, -1]))]),
        (data.draw(numbers(400, 800)), data.draw(numbers(400, 800))),
        stage=StageAxes("-z", "+x", "-y", (1.0, -2.5, 3.0)),
        order=data.draw(st.sampled_from(["serpentine", "raster"])),
        exposure_s=data.draw(st.sampled_from([0.5, tuple(0.1 * (k + 1) for k in range(len(planes)))])),
        settle_s=data.draw(numbers(0, 1)),
        frames_averaged=data.draw(st.integers(1, 9)),
    )
    if data.draw(st.booleans()):
        # a period far from the lattice's would be scaled so much that its cutout may leave the sensor
        with contextlib.suppress(InputError):
            plan = replace(plan, resample=True)
    again = ScanPlan.from_json(plan.to_json())
    assert again == plan and again.exposures == plan.exposures


BAD: dict[str, tuple[Any, ...]] = {
    "depths_um": ((), (1.0, 1.0), (1.0, 3.0, 2.0), (math.nan,), ("a",), (-900e3,)),
    "period": ((0, 5), (5.5, 5), 5, (1 << 20, 1 << 20)),
    "cutout": ((180, 181), (181,), (9999, 9999)),
    "anchor": ((1.0,), (math.inf, 5.0)),
    "order": ("spiral",),
    "exposure_s": (0.0, (0.1, 0.2, 0.3), (), "fast"),
    "settle_s": (-1.0,),
    "frames_averaged": (0,),
    "resample": ("yes",),
    "camera": ("r29",),
    "stage": (None,),
}


def test_bad_values_are_refused() -> None:
    sound = ScanPlan(preset("r29"), (55, 95), (181, 181), (-50e3, 0.0), (2000.0, 3000.0))
    for name, values in BAD.items():
        for value in values:
            with pytest.raises(InputError, match="expected") as caught:
                replace(sound, **{name: value})
            assert "\n" not in str(caught.value), (name, value)
    for planes in ({}, {"depths_um": [0.0], "virtual_depths": [2.0]}):
        with pytest.raises(InputError, match="depth planes"):
            ScanPlan.for_camera(preset("r29"), **planes)


def test_numpy_numbers_are_as_good_as_lists() -> None:
    planes = np.linspace(2.0, 4.0, 3)
    exposures = np.array([0.01, 0.02, 0.04])
    plan = r29(virtual_depths=planes, cutout=np.int64(181), exposure_s=exposures)
    assert plan == r29(virtual_depths=planes.tolist(), cutout=181, exposure_s=exposures.tolist())
    assert plan == ScanPlan.from_json(plan.to_json()) and plan.virtual_depths == pytest.approx((2.0, 3.0, 4.0))


def test_depths_lie_near_the_focus_by_the_focal_length_of_the_objective() -> None:
    camera = preset("lfm_20x05")  # an objective of 10 mm
    for depth in (-9000.0, -20000.0, 1e9):
        with pytest.raises(
            InputError, match=r"within 5000 µm of the focal plane.* got .*choose a plane nearer"
        ) as error:
            checked_depths(camera, (depth,))
        assert "\n" not in str(error.value)
    assert checked_depths(camera, (-4900.0, 4900.0)) == (-4900.0, 4900.0)
    # in water a focal length is longer by the index
    immersed = replace(camera, optics=replace(camera.optics, medium_index=1.33))
    assert checked_depths(immersed, (-6500.0,)) == (-6500.0,)


def camera_of(period: tuple[float, float], types: int = 3, kind: str = "hexagonal", **more: float) -> Camera:
    """Return a bench camera whose array has this period ``(y, x)`` in pixels."""
    camera = preset("bench")
    pixel = camera.sensor.pixel_um
    pitch = period[1] * pixel / (types if kind == "hexagonal" else 1)
    row = period[0] * pixel / (2 if kind == "hexagonal" else 1)
    kinds = tuple(LensType(f) for f in (580.8, 435.6, 363.0)[:types])
    lattice = replace(camera.lattice, kind=kind, pitch_um=pitch, row_pitch_um=row, types=kinds, clear_um=None, **more)
    return replace(camera, lattice=lattice, sensor=replace(camera.sensor, shape=(160, 160)))


def plan_of(camera: Camera, **more: object) -> ScanPlan:
    return ScanPlan.for_camera(camera, virtual_depths=[3.0], cutout=31, **more)


def same_lattice(lattice: LensletLattice, shift_um: np.ndarray) -> bool:
    """Return whether every lenslet, moved by (x, y), falls on one of its type, by distances instead of indices."""
    centres, types = lattice.lenslets_within(300.0, 300.0)
    wide, wide_types = lattice.lenslets_within(900.0, 900.0)
    for centre, kind in zip(centres + shift_um, types, strict=True):
        away = np.hypot(*(wide - centre).T)
        if away.min() > 1.0 or wide_types[int(away.argmin())] != kind:
            return False
    return True


@pytest.mark.parametrize(
    ("types", "period"), [(3, (20.0, 34.0)), (3, (20.06, 34.04)), (1, (12.0, 20.0)), (1, (20.0, 12.0))]
)
@pytest.mark.parametrize("step", [1, 2])
def test_half_a_hexagonal_period_is_a_period(types: int, period: tuple[float, float], step: int) -> None:
    camera = camera_of(period, types)
    plan = plan_of(replace(camera, lattice=replace(camera.lattice, type_step=step)))
    found = half_cell(plan)
    ny, nx = plan.period
    assert found.shift == (ny // 2, nx // 2) and np.abs(found.residual_px).max() <= 0.05
    np.testing.assert_allclose(found.residual_px, np.array(period) / 2 - found.shift, atol=1e-9)
    pixel = camera.sensor.pixel_um
    assert same_lattice(plan.camera.lattice, np.array([nx / 2, ny / 2]) * pixel)
    assert same_lattice(plan.camera.lattice, np.array([-nx / 2, ny / 2]) * pixel)
    half = found.half(plan)
    assert len(half) == ny * nx // 2
    both = np.concatenate([half, found.partners(half)])
    assert len(np.unique(both, axis=0)) == ny * nx and (found.partners(found.partners(half)) == half).all()


def test_a_period_of_two_cells_is_halved_into_cells_and_a_turned_array_counts_with_its_turn() -> None:
    plan = plan_of(camera_of((10.0, 18.0), 3))
    assert half_cell(replace(plan, period=(20, 36))).shift == (10, 18)
    # one cell longer along x alone: half of it is no vector of the lattice
    with pytest.raises(InputError, match="a lenslet half a period from each"):
        half_cell(replace(plan, period=(10, 36)))
    camera = camera_of((20.0, 34.0))
    small, large = (plan_of(replace(camera, lattice=replace(camera.lattice, rotation_rad=a))) for a in (0.0015, 0.006))
    assert 0.01 < max(map(abs, half_cell(small).residual_px)) < 0.05
    with pytest.raises(InputError, match=r"within 0\.05 px of a whole number of pixels"):
        half_cell(large)


def test_where_half_a_period_is_not_a_period() -> None:
    half_types = replace(plan_of(camera_of((20.0, 36.0))), period=(20, 12))
    for plan, match in (
        (plan_of(preset("r29")), "got 55 x 95, half of which is not a whole number of pixels"),
        (plan_of(preset("bench")), "got 19 x 33"),
        (
            plan_of(camera_of((20.2, 34.0))),
            r"within 0\.05 px of a whole number of pixels, got deviations of \+0\.100 rows",
        ),
        (plan_of(camera_of((20.0, 34.24))), r"\+0\.120 columns"),
        (plan_of(camera_of((20.0, 20.0), 1, "square")), "a lenslet half a period from each"),
        (plan_of(camera_of((20.0, 34.0)), resample=True), "resampled frames"),
        # a period of one lenslet, as of an array of one type: half a period away is another type
        (half_types, "lenslets of the same type half a period away, got another type"),
    ):
        with pytest.raises(InputError, match=match):
            half_cell(plan)


BENCH = preset("bench")


def plan_at(row: float, column: float, **options: bool) -> ScanPlan:
    return ScanPlan.for_camera(BENCH, virtual_depths=(3.0,), cutout=41, anchor=(row, column), **options)


@pytest.mark.parametrize("cutout", [(41, 41), (101, 41), (61, 141), (251, 201)])
def test_the_scan_moves_to_the_nearest_place_of_the_same_phase(cutout: tuple[int, int]) -> None:
    for anchor in ((20.0, 20.0), (150.0, 144.0), (281.0, 20.25), (280.5, 267.0)):
        plan = plan_at(*anchor)
        moved = moved_onto_sensor(plan, cutout=cutout)
        assert moved == replace(plan, cutout=cutout, anchor=moved.anchor)
        for axis in (0, 1):
            exact, shift = plan.cell_camera.period_px[axis], moved.anchor[axis] - plan.anchor[axis]
            pixel, half = np.floor(plan.anchor[axis] + 0.5), (cutout[axis] - 1) // 2
            free = np.arange(half, 320 - half - plan.period[axis] + 1)
            # by whole periods to the nearest free pixel, by brute force; else to the nearest one at all
            steps = {round(k * exact) for k in range(-30, 31)}
            same_phase = [p for p in free if p - pixel in steps]
            wanted = pixel if pixel in free else min(same_phase or free, key=lambda p, at=pixel: abs(p - at))
            assert shift == wanted - pixel, (anchor, axis)


def test_places_off_the_sensor_and_resampled_frames_move_by_whole_periods() -> None:
    moved = moved_onto_sensor(plan_at(150.0, 144.0), anchor=(-40.0, 5000.0))
    # 3 periods of 19 rows lead to 17, which is 3 px too far up: 4 are needed
    assert moved.anchor[0] == -40 + round(4 * moved.cell_camera.period_px[0])
    assert moved.anchor[1] <= 320 - 33 - 20 and (5000 - moved.anchor[1]) % 33 == 0
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


def test_the_ends_of_the_rows_are_in_scan_order() -> None:
    depths = tuple(BENCH.depth_of(v) for v in (3.0, 4.0, 5.0))
    for order in ("serpentine", "raster"):
        for period in ((3, 4), (4, 3), (1, 5), (5, 1), (2, 2), (19, 33)):
            plan = ScanPlan(BENCH, period, (41, 41), depths, (150, 144), order=order, resample=period == (19, 33))
            ends, every = plan.row_ends(), plan.order_indices()
            assert (ends == every[(every[:, 2] == 0) | (every[:, 2] == period[1] - 1)]).all(), (order, period)
            way, whole = (np.abs(np.diff(plan.stage_um(p), axis=0)).max(axis=1).sum() for p in (ends, every))
            assert way == pytest.approx(whole, rel=1e-12)


def session_of(**options: object) -> ScanPlan:
    return ScanPlan(preset("r29"), (55, 95), (181, 181), (-50e3, -40e3), (2000.0, 3000.0), **options)


def test_counts_and_bytes_follow_from_the_shape() -> None:
    cost = Forecast.of(session_of(frames_averaged=3, exposure_s=(0.1, 0.2), settle_s=0.5))
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
    scan = session_of()
    camera = scan.camera
    lateral = sum((55 * 95 - 1) * camera.step_um(z) for z in scan.depths_um)
    cost = Forecast.of(scan, stage_um_per_s=500.0)
    assert cost.move_hours * 3600 * 500.0 == pytest.approx(lateral + 10e3, rel=1e-9)
    back = Forecast.of(session_of(order="raster"), stage_um_per_s=500.0)
    assert 1.5 < back.move_hours / cost.move_hours < 2.0


def test_each_frame_is_read_out_after_its_exposure() -> None:
    """The stage waits for the frame: the camera's least time between frames is added to all other times."""
    scan = session_of(frames_averaged=3, exposure_s=0.1)
    unknown, known = Forecast.of(scan), Forecast.of(scan, frames_per_s=5.0)
    assert unknown.readout_hours is None and known.readout_hours == pytest.approx(known.frames / 5 / 3600)
    assert known.hours - unknown.hours == pytest.approx(known.readout_hours)
    assert unknown.bytes_per_s == pytest.approx(unknown.frame_bytes / (3600 * unknown.hours))
    assert known.bytes_per_s < 5.0 * known.frame_bytes / known.frames, "no more than the camera delivers"
    some = Forecast.of(scan, frames_per_s=5.0, positions=scan.order_indices()[:10])
    assert some.readout_hours == pytest.approx(30 / 5 / 3600)


def test_rates_of_camera_and_stage_are_checked() -> None:
    for rate in (0.0, -1.0, math.nan, math.inf, 1e-300):
        with pytest.raises(InputError, match=r"frame rate \(frames/s\)"):
            Forecast.of(session_of(), frames_per_s=rate)
    for speed in (0.0, 5e-324):  # it would never arrive
        with pytest.raises(InputError, match="stage speed"):
            Forecast.of(session_of(), stage_um_per_s=speed)
