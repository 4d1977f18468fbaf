"""Simulated frames: they assemble to H, keep to their seed, and put the light where the plan says."""

from __future__ import annotations

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.frames import FrameSource, Position
from lfcal.psf import Cutout, assemble
from lfcal.simulate import SimulatedCamera, scene_for, simulate_psf
from lfcal.simulate import effects as fx
from lfcal.simulate.engines import lattice_passed
from lfcal.simulate.sensor import white_tile
from lfcal.simulate.sensor.responses import DISPLACED_CACHED
from tests.simulate.common import BASE, FAST, difference, long, small_camera, small_plan

NOISE = (fx.ShotNoise(), fx.ReadNoise(), fx.FixedPattern(), fx.DarkCurrent(), fx.Quantisation())


def corner(plan: ScanPlan, rows: int = 3, columns: int = 4) -> ScanPlan:
    """Return the plan with fewer positions."""
    return replace(plan, period=(rows, columns))


def assembled(source: SimulatedCamera) -> np.ndarray:
    plan = source.plan
    h = assemble(source, plan.shape[:3], Cutout(plan.cutout, plan.anchor)).matrix.plane(0)
    return (h - plan.camera.sensor.black_level) / source.counts_per_unit(0)


def test_is_a_frame_source_in_scan_order() -> None:
    plan = corner(small_plan(cutout=31))
    camera = SimulatedCamera(plan, ())
    assert isinstance(camera, FrameSource)
    assert len(camera) == 12 and camera.shape == (160, 160)
    assert [camera.info(k).position for k in range(12)] == list(plan.positions())
    assert camera.info(4).position == Position(0, 1, 3), "serpentine"
    assert camera.metadata.bit_depth == 12 and camera.info(3).exposure_s == plan.exposures[0]
    assert "y 1" in camera.info(4).label
    with pytest.raises(InputError):
        camera.read(12)


def test_frames_without_noise_assemble_to_h_exactly() -> None:
    plan = corner(small_plan())
    for effects in ((), (*BASE, fx.Crosstalk(0.02)), (*BASE, fx.FiniteSource(30.0))):
        h = simulate_psf(plan, effects, sampling=FAST).plane(0)
        assert difference(assembled(SimulatedCamera(plan, effects, sampling=FAST)), h) < 2e-6, effects


@pytest.mark.parametrize("anchor", [(70.4, 64.0), long((70.0, 64.5)), (69.7, 64.2)])
def test_anchor_between_pixels(anchor: tuple[float, float]) -> None:
    plan = corner(small_plan(anchor=anchor), 2, 2)
    h = simulate_psf(plan, BASE, sampling=FAST).plane(0)
    assert difference(assembled(SimulatedCamera(plan, BASE, sampling=FAST)), h) < 2e-6
    whole = corner(small_plan(anchor=tuple(float(np.ceil(v - 0.5)) for v in anchor)), 2, 2)
    assert difference(simulate_psf(whole, BASE, sampling=FAST).plane(0), h) > 0.01


def test_noisy_frames_assemble_to_h_within_the_noise() -> None:
    plan = corner(small_plan(), 4, 6)
    source = SimulatedCamera(plan, (*BASE, *NOISE), sampling=FAST, seed=2)
    assert source.dtype == np.uint16 and source.read(0).dtype == np.uint16
    h = simulate_psf(plan, BASE, sampling=FAST).plane(0)
    sensor = plan.camera.sensor
    electrons = h.astype(float) * source.electrons_per_unit(0)
    lsb = sensor.electrons_per_count
    dark = sensor.dark_current_e_s * plan.exposures[0]
    variance = electrons + dark + sensor.read_noise_e**2 + (sensor.prnu * electrons) ** 2 + lsb**2 / 12
    residual = (assembled(source) * source.electrons_per_unit(0) - electrons - dark) / np.sqrt(variance)
    assert residual.std() == pytest.approx(1.0, abs=0.02) and abs(residual.mean()) < 0.02
    shifted = np.roll(electrons, 1, axis=-1)
    assert ((electrons - shifted) / np.sqrt(variance)).std() > 5, "a slip of one pixel is seen through the noise"


def test_frames_depend_on_index_and_seed_alone() -> None:
    plan = corner(small_plan(cutout=31))
    one, two, other = (SimulatedCamera(plan, (*BASE, *NOISE), sampling=FAST, seed=s) for s in (5, 5, 6))
    frames = [one.read(k).tobytes() for k in range(12)]
    with ThreadPoolExecutor(3) as pool:
        assert [f.tobytes() for f in pool.map(two.read, reversed(range(12)))] == frames[::-1]
    assert other.read(3).tobytes() != frames[3]


@pytest.mark.long
def test_brightest_pixel_reaches_the_peak() -> None:
    plan = small_plan()
    camera = SimulatedCamera(plan, BASE, sampling=FAST, peak=0.5)
    brightest = max(camera.light(k).max() for k in range(0, len(camera), 7))
    assert brightest == pytest.approx(0.5 * plan.camera.sensor.full_well_e, rel=0.12)


def test_light_follows_the_plan_and_lenslets_stay_on_the_sensor() -> None:
    """A whole period away the pattern is the same, moved by it: the lattice is fixed to the sensor."""
    plan = small_plan(camera=small_camera(200, 220), cutout=41)
    ny, nx = plan.period
    moved = replace(plan, anchor=(plan.anchor[0] - ny, plan.anchor[1] - nx))
    a = SimulatedCamera(plan, BASE, sampling=FAST).light(40)
    b = SimulatedCamera(moved, BASE, sampling=FAST).light(40)
    # the period is 19.05 x 33.0 px, which leaves 0.05 px
    assert difference(np.roll(b, (ny, nx), (0, 1)), a) < 0.12
    half = replace(plan, anchor=(plan.anchor[0], plan.anchor[1] - 5))
    assert difference(np.roll(SimulatedCamera(half, BASE, sampling=FAST).light(40), (0, 5), (0, 1)), a) > 0.5


def test_motion_displaces_the_source_and_is_not_recorded() -> None:
    plan = corner(small_plan(), 2, 6)
    step = plan.camera.step_um(plan.depths_um[0])
    camera = SimulatedCamera(plan, (*BASE, fx.Drift(0.0, 11 * step)), sampling=FAST)
    still = SimulatedCamera(replace(plan, anchor=(plan.anchor[0], plan.anchor[1] + 1)), BASE, sampling=FAST)
    assert camera.displacement_um(1) == pytest.approx((0.0, 0.0, step))
    k = 1  # one step of drift: the frame is that of the neighbour to the right
    scale = camera.electrons_per_unit(0) / still.electrons_per_unit(0)
    assert difference(camera.light(k), still.light(k) * np.float32(scale)) < 1e-4
    assert camera.info(k).position == still.info(k).position == Position(0, 0, 1)


def test_motion_is_seeded_and_serpentine_backlash_lags_every_other_row() -> None:
    plan = corner(small_plan(), 4, 6)
    step = plan.camera.step_um(plan.depths_um[0])
    noisy = [SimulatedCamera(plan, (fx.PositioningError(3.0),), seed=s) for s in (1, 1, 2)]
    moves = [np.array([c.displacement_um(k) for k in range(len(c))]) for c in noisy]
    assert np.array_equal(moves[0], moves[1]) and not np.array_equal(moves[0], moves[2])
    assert moves[0][:, 1:].std() == pytest.approx(3.0, rel=0.3) and not moves[0][:, 0].any()
    play = SimulatedCamera(plan, (fx.Backlash(2.5 * step),))
    lag = np.array([play.displacement_um(k)[2] for k in range(24)]).reshape(4, 6) / step
    assert np.allclose(lag[0], 0) and np.allclose(lag[1, 3:], 2.5) and lag[1, 1] == pytest.approx(1.0)


def test_depth_error_changes_the_plane() -> None:
    plan = corner(small_plan(), 1, 2)
    camera = SimulatedCamera(plan, (*BASE, fx.DepthError(2e4)), sampling=FAST, seed=3)
    dz = camera.displacement_um(0)[0]
    assert dz != 0 and camera.displacement_um(1)[0] == dz
    true = SimulatedCamera(replace(plan, depths_um=(plan.depths_um[0] + dz,)), BASE, sampling=FAST)
    scale = camera.electrons_per_unit(0) / true.electrons_per_unit(0)
    assert difference(camera.light(0), true.light(0) * np.float32(scale)) < 0.05
    assert difference(SimulatedCamera(plan, BASE, sampling=FAST).light(0), true.light(0)) > 0.2


def test_light_of_a_source_anywhere_is_that_of_a_plan_with_a_plane_there() -> None:
    plan = corner(small_plan(), 2, 3)
    camera = SimulatedCamera(plan, BASE, sampling=FAST)
    here = plan.object_um(camera.position(4))
    assert difference(camera.light_of(tuple(here.tolist())), camera.light(4)) < 1e-4
    between = plan.camera.depth_of(plan.camera.virtual_depth(plan.depths_um[0]) + 0.5)
    other = SimulatedCamera(replace(plan, depths_um=(between,)), BASE, sampling=FAST)
    there = other.plan.object_um(other.position(4))
    scale = camera.electrons_per_unit(0) / other.electrons_per_unit(0)
    seen = camera.light_of(tuple(there.tolist()))
    assert difference(seen, other.light(4) * np.float32(scale)) < 1e-3
    assert difference(seen, camera.light(4)) > 0.2


def test_a_stage_that_is_moved_along_leaves_no_responses_behind() -> None:
    plan = corner(small_plan(), 1, 1)
    camera = SimulatedCamera(plan, BASE, sampling=FAST)
    x, y, z = plan.object_um(camera.position(0)).tolist()
    for k in range(1, 3 + DISPLACED_CACHED):
        camera.light_of((x, y, z + 10.0 * k))
    assert len(camera._responses.cached) == DISPLACED_CACHED + 1


def test_dark_frames() -> None:
    plan = corner(small_plan(cutout=31))
    camera = SimulatedCamera(plan, NOISE, seed=1)
    dark = camera.dark_frame(0)
    assert dark.dtype == np.uint16 and dark.mean() == pytest.approx(64, abs=0.2)
    assert dark.std() == pytest.approx(8.0 / plan.camera.sensor.electrons_per_count, rel=0.05)
    assert not np.array_equal(dark, camera.dark_frame(1)) and np.array_equal(dark, camera.dark_frame(0))


def test_white_frames_show_the_lattice() -> None:
    plan = small_plan(camera=small_camera(240, 260))
    white = SimulatedCamera(plan, (*BASE, fx.CosFourth()), sampling=FAST).white_frame()
    sensor = plan.camera.sensor
    level = (white - sensor.black_level) * sensor.electrons_per_count / sensor.full_well_e
    assert level.max() == pytest.approx(0.6, rel=0.02) and level.min() > 0
    centres, _ = plan.camera.lattice.lenslets_within(400.0, 400.0)
    at = plan.camera.pixels(centres)
    inside = np.rint(at).astype(int)
    gap = np.rint(at + plan.camera.pitch_px * np.array([1 / np.sqrt(12), 0.5])).astype(int)
    middle = level[inside[:, 0], inside[:, 1]]
    assert middle.mean() > 1.3 * level[gap[:, 0], gap[:, 1]].mean()
    # three types differ in the sharpness of their rims, not in the light they pass
    tile = white_tile(plan, BASE)
    assert tile.mean() == pytest.approx(np.pi * (5.3 / 11) ** 2 / (np.sqrt(3) / 2), rel=0.02)


def test_the_light_that_lenslets_pass_is_that_of_a_uniform_scene() -> None:
    """A product of areas, compared with the rays of all points of a cell; none where pixels respond to angles."""
    plan = small_plan()
    for more in ((), (fx.MechanicalVignetting(0.3, 0.3),), (fx.PitchError(0.3),)):
        passed = lattice_passed(scene_for(plan, 0, (*BASE, *more)))
        assert passed == pytest.approx(white_tile(plan, (*BASE, *more)).mean(), rel=1e-3), more
    assert lattice_passed(scene_for(plan, 0, (*BASE, fx.AngularResponse(0.3)))) is None


@pytest.mark.parametrize("v", [2.0, *(long(v) for v in (3.0, -2.0))])
def test_a_white_frame_has_no_bars_where_a_lens_type_is_in_focus(v: float) -> None:
    """Micro-images of an even scene are flat inside: 24 to 158 % of their median were seen at v = 2."""
    plan = small_plan(v, small_camera(120, 130))
    white = SimulatedCamera(plan, BASE, sampling=FAST).white_frame().astype(float) - plan.camera.sensor.black_level
    pixels = np.stack(np.indices(white.shape), axis=-1)
    centres = plan.camera.pixels(plan.camera.lattice.lenslets_within(300.0, 300.0)[0])
    nearest = np.min([np.hypot(*np.moveaxis(pixels - centre, -1, 0)) for centre in centres], axis=0)
    inside = white[nearest < 0.2 * plan.camera.pitch_px]
    assert inside.size > 500
    assert 0.95 < inside.min() / np.median(inside) and inside.max() / np.median(inside) < 1.05


def test_impossible_peaks_seeds_and_effects_are_refused() -> None:
    plan = corner(small_plan(cutout=31))
    for options in ({"peak": 0.0}, {"seed": -1}, {"effects": "all"}, {"effects": (3,)}):
        with pytest.raises(InputError):
            SimulatedCamera(plan, **options)


def test_a_camera_is_pickled_as_its_description() -> None:
    """With planned effects, with given ones, and one that has computed frames already."""
    plan = replace(ScanPlan.for_camera(small_camera(), virtual_depths=[3.0, 4.0], cutout=31), period=(2, 2))
    first = SimulatedCamera(plan, seed=5, peak=0.6, tolerance=0.1)
    wanted = first.read(3)
    pickled = pickle.dumps(first)
    assert len(pickled) < 10_000
    other = pickle.loads(pickled)
    np.testing.assert_array_equal(other.read(3), wanted)
    assert other.metadata == first.metadata
    given = SimulatedCamera(plan, first.effects[:2], level="geometric", seed=6)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(given)).read(0), given.read(0))
