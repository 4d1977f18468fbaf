from __future__ import annotations

import contextlib
import copy
import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.base.axes import Position
from lfcal.base.errors import InputError
from lfcal.camera import (
    PRESETS,
    Camera,
    LensletLattice,
    LensType,
    MainLens,
    Microscope,
    ScanPlan,
    Sensor,
    StageAxes,
    preset,
)
from lfcal.camera.plan import checked_depths, half_cell
from tests.camera.strategies import cameras, numbers

QUICK = settings(derandomize=True, deadline=None, max_examples=40)


def r29(**options: Any) -> ScanPlan:
    return ScanPlan.for_camera(preset("r29"), **{"virtual_depths": [4.0], **options})


def test_the_cell_of_the_paper() -> None:
    plan = r29()
    assert plan.period == (55, 95) and plan.shape[1:3] == (55, 95)
    assert plan.period_residual_px == pytest.approx((31.7 * math.sqrt(3) - 55, 0.1))
    assert plan.cells == (1, 1) and plan.tilt_residual_px == 0


def test_a_session_like_the_paper_s_is_listed_at_once() -> None:
    plan = r29(virtual_depths=np.linspace(1.1, 5.5, 11).tolist(), cutout=181)
    assert plan.n_positions == 57_475
    visited = list(plan.positions())
    assert len(visited) == len(set(visited)) == 57_475
    assert isinstance(visited[0], Position) and visited[0] == (0, 0, 0)
    assert np.array_equal(np.array(visited), plan.order_indices())


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_every_preset_can_be_planned(name: str) -> None:
    camera = preset(name)
    planes = {"depths_um": [-10.0, 5.0]} if isinstance(camera.optics, Microscope) else {"virtual_depths": [2.0, 3.0]}
    plan = ScanPlan.for_camera(camera, **planes)  # type: ignore[arg-type]
    assert ScanPlan.from_json(plan.to_json()) == plan
    centre = plan.image_px([0, (plan.period[0] - 1) / 2, (plan.period[1] - 1) / 2])
    assert np.abs(centre - camera.sensor.centre_px).max() <= 0.5
    assert all(n % 2 for n in plan.cutout)


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 4, 5), (3, 5, 4), (2, 3, 3), (4, 2, 6), (5, 1, 3)])
def test_serpentine_moves_one_step_at_a_time_and_raster_always_the_same_way(shape: tuple[int, int, int]) -> None:
    nz, ny, nx = shape
    for order in ("serpentine", "raster"):
        plan = ScanPlan(
            preset("bench"), (ny, nx), (9, 9), tuple(-1000.0 * k for k in range(nz)), (50.0, 50.0), order=order
        )
        index = plan.order_indices()
        assert sorted(map(tuple, index.tolist())) == list(np.ndindex(shape))
        if order == "serpentine":
            assert (np.abs(np.diff(index, axis=0)).sum(1) == 1).all()
        else:
            assert index.tolist() == [list(p) for p in np.ndindex(shape)]


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


def test_a_longer_period_counts_its_cells() -> None:
    camera = preset("lfm_60x12")
    one = ScanPlan(camera, (15, 15), (9, 9), (0.0,), (900.0, 900.0))
    many = ScanPlan(camera, (200, 200), (9, 9), (0.0,), (900.0, 900.0))
    assert one.period_residual_px == pytest.approx((5 / 13, 5 / 13))
    assert many.cells == (13, 13)
    assert many.period_residual_px == pytest.approx((0.0, 0.0), abs=1e-9)


def test_lattice_anchor_is_measured_from_a_type_0_lenslet() -> None:
    types = (LensType(900.0), LensType(1000.0), LensType(1100.0))
    lattice = LensletLattice("hexagonal", 110.0, 500.0, types, 0.001, (123.0, -45.0))
    camera = Camera("c", MainLens(), lattice, Sensor((801, 1001), 5.0))
    centre = lattice.centres_um(4, 1)  # 4 - 1 = 3: type 0
    row, column = camera.pixels(centre)
    plan = ScanPlan(camera, (9, 9), (9, 9), (0.0,), (row + 2.25, column - 7.5))
    assert plan.lattice_anchor == pytest.approx((2.25, -7.5))


def test_a_tilted_lattice_shows_its_residual_or_is_refused() -> None:
    def tilted(angle: float) -> ScanPlan:
        lattice = LensletLattice("hexagonal", 174.0, 870.0, rotation_rad=angle)
        return ScanPlan.for_camera(Camera("c", MainLens(), lattice, Sensor()), depths_um=[0.0])

    assert tilted(math.radians(0.05)).tilt_residual_px == pytest.approx(0.048, abs=1e-3)
    upright, turned = tilted(0.0).period, tilted(math.pi / 2).period
    assert turned == upright[::-1]
    with pytest.raises(InputError, match="lattice rotation"):
        tilted(math.radians(10))


def test_a_cutout_off_the_sensor_names_the_position() -> None:
    plan = r29(cutout=181)
    rows, columns = plan.camera.sensor.shape
    top = ScanPlan(plan.camera, plan.period, plan.cutout, plan.depths_um, (90.0, 90.0))
    assert top.anchor == (90.0, 90.0)
    with pytest.raises(InputError, match="z=0, y=0, x=0: expected rows from 0 to 4383, got rows from -1 to 179"):
        ScanPlan(plan.camera, plan.period, plan.cutout, plan.depths_um, (89.0, 90.0))
    ScanPlan(plan.camera, plan.period, plan.cutout, plan.depths_um, (rows - 1 - 90.0 - 54, columns - 1 - 90.0 - 94))
    with pytest.raises(
        InputError, match="z=0, y=0, x=94: expected columns from 0 to 6575, got columns from 6396 to 6576"
    ):
        ScanPlan(plan.camera, plan.period, plan.cutout, plan.depths_um, (2000.0, columns - 90.0 - 94))
    with pytest.raises(InputError, match="y=54, x=0"):
        ScanPlan(plan.camera, plan.period, plan.cutout, plan.depths_um, (rows - 90.0 - 54, 2000.0))


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


@pytest.mark.parametrize(
    "values",
    [
        {"depths_um": ()},
        {"depths_um": (1.0, 1.0)},
        {"depths_um": (1.0, 3.0, 2.0)},
        {"depths_um": (math.nan,)},
        {"depths_um": ("a",)},
        {"depths_um": (-900e3,)},
        {"period": (0, 5)},
        {"period": (5.5, 5)},
        {"period": 5},
        {"period": (1 << 20, 1 << 20)},
        {"cutout": (180, 181)},
        {"cutout": (181,)},
        {"cutout": (9999, 9999)},
        {"anchor": (1.0,)},
        {"anchor": (math.inf, 5.0)},
        {"order": "spiral"},
        {"exposure_s": 0.0},
        {"exposure_s": (0.1, 0.2, 0.3)},
        {"exposure_s": ()},
        {"exposure_s": "fast"},
        {"settle_s": -1.0},
        {"frames_averaged": 0},
        {"resample": "yes"},
        {"camera": "r29"},
        {"stage": None},
    ],
)
def test_bad_values_are_refused(values: dict[str, Any]) -> None:
    sound: dict[str, Any] = {
        "camera": preset("r29"),
        "period": (55, 95),
        "cutout": (181, 181),
        "depths_um": (-50e3, 0.0),
        "anchor": (2000.0, 3000.0),
    }
    ScanPlan(**sound)
    with pytest.raises(InputError) as caught:
        ScanPlan(**{**sound, **values})
    assert "\n" not in str(caught.value) and "expected" in str(caught.value)


def test_planes_are_given_one_way() -> None:
    for planes in ({}, {"depths_um": [0.0], "virtual_depths": [2.0]}):
        with pytest.raises(InputError, match="depth planes"):
            ScanPlan.for_camera(preset("r29"), **planes)
    assert r29(virtual_depths=[2.0, 3.0]).virtual_depths == pytest.approx((2.0, 3.0))


LEAVES = st.one_of(
    st.none(), st.booleans(), st.integers(-5, 5), st.floats(), st.text(max_size=3), st.lists(st.integers(), max_size=2)
)
WHOLE: Any = json.loads(r29().to_json())


@given(st.sampled_from(sorted(WHOLE)), LEAVES)
@settings(derandomize=True, deadline=None, max_examples=150)
def test_a_spoilt_entry_is_one_clear_error_or_a_sound_plan(key: str, leaf: Any) -> None:
    data = copy.deepcopy(WHOLE)
    data[key] = leaf
    try:
        plan = ScanPlan.from_dict(data)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert ScanPlan.from_json(plan.to_json()) == plan


@pytest.mark.parametrize("text", ["", "null", "[1]", '{"format": "lfcal-camera"}', "[" * 100_000])
def test_other_text_is_refused(text: str) -> None:
    with pytest.raises(InputError):
        ScanPlan.from_json(text)


def test_numpy_numbers_are_as_good_as_lists() -> None:
    planes = np.linspace(2.0, 4.0, 3)
    exposures = np.array([0.01, 0.02, 0.04])
    plan = r29(virtual_depths=planes, cutout=np.int64(181), exposure_s=exposures)
    assert plan == r29(virtual_depths=planes.tolist(), cutout=181, exposure_s=exposures.tolist())
    assert plan == ScanPlan.from_json(plan.to_json())


@pytest.mark.parametrize("depth", [-9000.0, -20000.0, 1e9])
def test_depths_in_the_objective_or_far_from_its_focus_are_refused(depth: float) -> None:
    with pytest.raises(InputError, match=r"within 5000 µm of the focal plane.* got .*choose a plane nearer") as caught:
        checked_depths(preset("lfm_20x05"), (depth,))  # an objective of 10 mm
    assert "\n" not in str(caught.value)


def test_depths_near_the_focus_are_taken_by_the_objective_s_focal_length() -> None:
    camera = preset("lfm_20x05")
    assert checked_depths(camera, (-4900.0, 4900.0)) == (-4900.0, 4900.0)
    # in water a focal length is longer by the index
    immersed = replace(camera, optics=replace(camera.optics, medium_index=1.33))
    assert checked_depths(immersed, (-6500.0,)) == (-6500.0,)


def test_a_wavelength_of_another_unit_is_refused_with_both() -> None:
    with pytest.raises(InputError, match=r"0\.00052; give it in µm \(--wavelength takes nm\)"):
        replace(preset("lfm_20x05"), wavelength_um=0.00052)


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
    return ScanPlan.for_camera(camera, virtual_depths=[3.0], cutout=31, **more)  # type: ignore[arg-type]


def same_lattice(lattice: LensletLattice, shift_um: np.ndarray) -> bool:
    """Return whether every lenslet, moved by (x, y), falls on one of its type: by looking, not by indices."""
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


def test_a_period_of_two_cells_is_halved_into_cells() -> None:
    plan = plan_of(camera_of((10.0, 18.0), 3))
    twice = replace(plan, period=(20, 36))
    assert half_cell(twice).shift == (10, 18)
    # one cell longer along x alone: half of it is no vector of the lattice
    with pytest.raises(InputError, match="a lenslet half a period from each"):
        half_cell(replace(plan, period=(10, 36)))


def test_a_turned_array_counts_with_its_turn() -> None:
    camera = camera_of((20.0, 34.0))
    small = plan_of(replace(camera, lattice=replace(camera.lattice, rotation_rad=0.0015)))
    assert 0.01 < max(map(abs, half_cell(small).residual_px)) < 0.05
    with pytest.raises(InputError, match=r"within 0\.05 px of a whole number of pixels"):
        half_cell(plan_of(replace(camera, lattice=replace(camera.lattice, rotation_rad=0.006))))


@pytest.mark.parametrize(
    ("camera", "what"),
    [
        (preset("r29"), "got 55 x 95, half of which is not a whole number of pixels"),
        (preset("bench"), "got 19 x 33"),
        (camera_of((20.2, 34.0)), r"within 0\.05 px of a whole number of pixels, got deviations of \+0\.100 rows"),
        (camera_of((20.0, 34.24)), r"\+0\.120 columns"),
        (camera_of((20.0, 20.0), 1, "square"), "a lenslet half a period from each"),
    ],
)
def test_where_half_is_not_enough(camera: Camera, what: str) -> None:
    plan = ScanPlan.for_camera(camera, virtual_depths=[3.0], cutout=31)
    with pytest.raises(InputError, match=what):
        half_cell(plan)


def test_types_that_differ_and_resampled_frames_are_refused() -> None:
    # six lenslets along the row: half of them is the next type's place in the next row
    plan = plan_of(camera_of((20.0, 34.0)))
    with pytest.raises(InputError, match="resampled frames"):
        half_cell(replace(plan, resample=True))
    # a period of one lenslet, as of an array of one type: the type half a period away is another one
    one = replace(plan_of(camera_of((20.0, 36.0))), period=(20, 12))
    with pytest.raises(InputError, match="lenslets of the same type half a period away, got another type"):
        half_cell(one)
