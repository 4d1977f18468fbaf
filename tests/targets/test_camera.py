"""Frames of a target: the light of every hole is that of a single source there, and the plan moves them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.camera import ScanPlan
from lfcal.frames import FrameSource
from lfcal.simulate.effects import Backlash, FieldCurvature, FiniteSource, Quantisation, ReadNoise, ShotNoise
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.targets import Pose, Target, TargetCamera, TargetPlan, uneven
from lfcal.targets.images import hole_images
from tests.simulate.common import BASE, FAST, difference
from tests.targets.common import scan_of, small


@pytest.fixture(scope="module")
def scan() -> ScanPlan:
    return scan_of(small(200))


def plan_of(scan: ScanPlan, target: Target, *offsets: tuple[float, float]) -> TargetPlan:
    planes = len(scan.depths_um)
    return TargetPlan(scan, target, (offsets or ((0.0, 0.0),),) * planes, 0.1, (0.0,) * planes, "not computed")


def array(scan: ScanPlan, pitch_px: float = 60.0, **more: object) -> Target:
    pitch = pitch_px * scan.camera.step_um(scan.depths_um[0])
    return Target("square", (2, 3), (pitch, pitch), **more)


def camera_of(plan: TargetPlan, *effects: object, **more: object) -> TargetCamera:
    return TargetCamera(plan, (*BASE, *effects), sampling=FAST, **more)


def at(plan: TargetPlan, hole: int) -> tuple[float, float, float]:
    """Return where a hole stands in object space, by the pose alone."""
    target = plan.target
    right, down, away = target.pose.points(target.flat_um(target.holes))[hole].tolist()
    return right, down, plan.scan.depths_um[0] + away


def test_a_hole_is_the_source_of_a_scan(scan: ScanPlan) -> None:
    single = SimulatedCamera(scan, BASE, sampling=FAST)
    right, down, _ = scan.object_um(single.position(17)).tolist()
    plan = plan_of(scan, Target("point", pose=Pose(right_um=right, down_um=down)))
    frames = camera_of(plan)
    assert isinstance(frames, FrameSource) and len(frames) == 1 and frames.shape == scan.camera.sensor.shape
    assert difference(frames.light(0), single.light(17)) < 1e-5
    assert frames.info(0).points == () and frames.info(0).exposure_s == scan.exposures[0]


def test_light_of_holes_adds_up(scan: ScanPlan) -> None:
    plan = plan_of(scan, array(scan, pose=Pose(rotation_rad=0.02)))
    light = uneven(plan.target, 0.3, seed=2)
    assert len(set(light.tolist())) == 6 and abs(light.mean() - 1) < 0.5
    frames = camera_of(plan, brightness=light)
    wanted = sum(light[k] * frames.single.light_of(at(plan, k)) for k in range(6))
    assert difference(frames.light(0), wanted) < 1e-5
    gone = replace(plan.target, absent=((0, 0), (0, 1), (0, 2)))
    left = camera_of(plan, really=gone, brightness=light[3:])
    wanted = sum(light[k] * frames.single.light_of(at(plan, k)) for k in range(3, 6))
    assert difference(left.light(0), wanted) < 1e-5
    dark = camera_of(plan, brightness=np.zeros(6))
    assert not dark.light(0).any()


@pytest.mark.long
def test_light_of_many_frames_at_once_is_that_of_each(scan: ScanPlan) -> None:
    plan = plan_of(
        scan, array(scan, hole_um=20.0, pose=Pose(tilt_right_rad=0.05)), (0.0, 0.0), (3.3, -2.0), (40.0, 1.0)
    )
    frames = camera_of(plan, brightness=uneven(plan.target, 0.3))
    found = drain(frames.iter_lights([2, 0], workers=2))
    assert found.shape == (2, *frames.shape)
    for own, index in zip(found, (2, 0), strict=True):
        assert difference(own, frames.light(index)) < 1e-6
    assert np.array_equal(frames.exposed(frames.light(1), 1), frames.read(1))
    with pytest.raises(InputError, match="frame index"):
        drain(frames.iter_lights([3]))


def test_holes_of_a_tilted_target_are_at_their_depths(scan: ScanPlan) -> None:
    plan = plan_of(scan, array(scan, pose=Pose(tilt_right_rad=0.12)))
    frames = camera_of(plan)
    away = frames.points(0).away_um
    assert np.ptp(away) > 0.05 * abs(scan.depths_um[0] - scan.camera.depth_of(5.0))
    exact = sum(frames.single.light_of(at(plan, k)) for k in range(6))
    flat = sum(frames.single.light_of((*at(plan, k)[:2], scan.depths_um[0])) for k in range(6))
    assert difference(frames.light(0), exact) < 0.2 * difference(flat, exact)


def test_the_plan_moves_the_images(scan: ScanPlan) -> None:
    plan = plan_of(scan, array(scan, 30.0), (0.0, 0.0), (5.0, -3.0), (0.25, 0.0))
    frames = camera_of(plan)
    first, second, third = (frames.points(k).pixels for k in range(3))
    np.testing.assert_allclose(second - first, np.broadcast_to([5.0, -3.0], (6, 2)), atol=1e-9)
    np.testing.assert_allclose(third - first, np.broadcast_to([0.25, 0.0], (6, 2)), atol=1e-9)
    np.testing.assert_allclose(first, hole_images(plan.target, scan.camera, scan.depths_um[0]).pixels)
    # the lenslets stand still: the picture changes, the place of its light moves along
    rows, columns = np.mgrid[: frames.shape[0], : frames.shape[1]]
    centres = [[(light * r).sum() / light.sum() for r in (rows, columns)] for light in map(frames.light, range(2))]
    np.testing.assert_allclose(np.subtract(*centres[::-1]), [5.0, -3.0], atol=0.7)
    assert difference(np.roll(frames.light(0), (5, -3), (0, 1)), frames.light(1)) > 0.2


@pytest.mark.long
def test_large_holes_are_finite_sources(scan: ScanPlan) -> None:
    step = scan.camera.step_um(scan.depths_um[0])
    plan = plan_of(scan, array(scan, hole_um=3 * step))
    wide = camera_of(plan)
    assert FiniteSource(3 * step) in wide.single.effects
    named = camera_of(plan_of(scan, array(scan)), FiniteSource(3 * step))
    assert difference(wide.light(0), named.light(0)) < 1e-6
    assert difference(wide.light(0), camera_of(plan_of(scan, array(scan))).light(0)) > 0.05


def test_optics_act_on_each_hole_at_its_field(scan: ScanPlan) -> None:
    plan, curved = plan_of(scan, array(scan, 60.0)), FieldCurvature(-3000.0)
    bent, flat = camera_of(plan, curved).light(0), camera_of(plan).light(0)
    outer, inner = (
        float(np.abs(bent - flat)[:, part].sum() / flat[:, part].sum()) for part in (slice(0, 70), slice(70, 130))
    )
    assert outer > 3 * inner and outer > 0.05
    # the same by a scan of the region about one hole
    row, column = camera_of(plan).points(0).pixels[0].tolist()
    middle = [a + (n - 1) / 2 for a, n in zip(scan.anchor, scan.period, strict=True)]
    there = (scan.anchor[0] + round(row - middle[0]), scan.anchor[1] + round(column - middle[1]))
    region = SimulatedCamera(replace(scan, anchor=there), (*BASE, curved), sampling=FAST)
    alone = camera_of(plan, curved, brightness=[1, 0, 0, 0, 0, 0])
    scale = alone.single.electrons_per_unit(0) / region.electrons_per_unit(0)
    wanted = region.light_of(at(plan, 0)) * np.float32(scale)
    assert difference(alone.light(0), wanted) < 0.03 < 0.1 < difference(flat[:, :70], bent[:, :70])


def test_the_sensor_is_that_of_the_scan(scan: ScanPlan) -> None:
    plan = plan_of(scan, array(scan), (0.0, 0.0), (1.0, 1.0))
    frames = camera_of(plan, ShotNoise(), ReadNoise(), Quantisation(), seed=4)
    sensor = scan.camera.sensor
    read = frames.read(1)
    assert read.dtype == np.uint16 and frames.dtype == np.uint16
    np.testing.assert_array_equal(read, frames.read(1))
    np.testing.assert_array_equal(frames.read(1, (slice(10, 40), slice(5, 60))), read[10:40, 5:60])
    sums = read.astype(float).sum() - sensor.black_level * read.size
    wanted = frames.light(1).sum() / sensor.electrons_per_count
    noise = np.sqrt(wanted / sensor.electrons_per_count + read.size * frames.metadata.noise.constant)
    assert abs(sums - wanted) < 5 * noise + 0.01 * wanted
    assert frames.metadata.plan_shape is None and frames.metadata.black_level == sensor.black_level


def test_wrong_arguments_are_refused(scan: ScanPlan) -> None:
    plan = plan_of(scan, array(scan))
    for effects, more, what in (
        ((), {"brightness": np.ones(5)}, r"6 values of 0 or more, one for each hole, got shape \(5,\)"),
        ((), {"brightness": [1, 1, 1, 1, 1, -1]}, "values of 0 or more"),
        ((Backlash(1.0),), {}, "effects of a target's frames: expected no effect of stage motion"),
    ):
        with pytest.raises(InputError, match=what):
            camera_of(plan, *effects, **more)
    frames = TargetCamera(plan, tolerance=0.3)
    with pytest.raises(InputError, match=r"frame index: expected 0 to 0, got 1"):
        frames.read(1)
    # effects are chosen where none are given
    assert frames.single.effects and frames.read(0).max() > frames.metadata.black_level


def test_holes_at_the_sensors_rim_are_simulated(scan: ScanPlan) -> None:
    # the optics of a region at the rim are those of the nearest place at which a scan fits on the sensor
    half = scan.camera.sensor.shape[1] / 2 * scan.camera.step_um(scan.depths_um[0])
    for right, down in ((-half, -half), (half, half), (0.97 * half, 0.0)):
        plan = plan_of(scan, Target("point", pose=Pose(right_um=right, down_um=down)))
        frames = camera_of(plan)
        wanted = frames.single.light_of((right, down, scan.depths_um[0]))
        assert frames.light(0).sum() > 0 and difference(frames.light(0), wanted) < 0.05
