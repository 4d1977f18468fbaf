"""From a scan and a target to a plan: crosstalk of neighbours, coverage, time, and the error to expect."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.fft as sf
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import Camera, Forecast, ScanPlan, StageAxes, preset
from lfcal.simulate.accuracy.planner import plan_effects
from lfcal.simulate.sensor.camera_source import SimulatedCamera
from lfcal.simulate.sensor.noise import FrameKind
from lfcal.targets import Pose, Target, TargetPlan, Wishes, error_forecast, parse_target, plan_target, propose_target
from lfcal.targets.expected import TOLERANCE, noise_share
from lfcal.targets.images import hole_images
from lfcal.targets.phases import Phases
from lfcal.targets.planning import Tails, poses_within, proposed_axis, shown_within, simulated_tails
from tests.targets.common import bench, scan_of, small

PER_PX = 10
"""Samples of a rendered pixel along an axis: they hold light up to 30° from the axis."""


def round_iris(side: int) -> Camera:
    """Return the bench camera with a round iris."""
    camera = bench(side)
    return replace(camera, optics=replace(camera.optics, blades=0))


def rendered(camera: Camera, z_um: float, pixels: int, phase: tuple[float, float]) -> NDArray[np.float64]:
    """Return the light of a point on the axis, in so many pixels a side.

    Plane waves as the iris lets them through meet all lenslets, and go on to the sensor by their angular spectrum.
    The array is hexagonal, with three types that take turns along a row; ``phase`` (rows, columns) shifts it (periods).
    """
    optics, lattice, wave = camera.optics, camera.lattice, camera.wavelength_um
    step, size = camera.sensor.pixel_um / PER_PX, PER_PX * pixels
    to_array, to_image = (1 / (1 / optics.focal_length_um - 1 / (optics.working_distance_um + z)) for z in (0.0, z_um))
    away = np.abs(np.fft.fftfreq(size, step)[:, None] + 1j * np.fft.fftfreq(size, step)) * wave
    along = 2 * np.pi / wave * (np.sqrt(np.maximum(1 - away**2, 0)) - 1)
    axis = (np.arange(size) - (size - 1) / 2) * step

    # the edge of the iris within one step of the angle
    iris = np.clip((optics.focal_length_um / (2 * optics.f_number) / to_image - away) * size * step / wave + 0.5, 0, 1)
    middle = np.exp(2j * np.pi * np.fft.fftfreq(size, step) * axis[0])
    field = sf.ifft2(iris * np.exp(-1j * (to_image - to_array) * along) * middle[:, None] * middle)

    pitch = lattice.pitch_um * to_array / (to_array + lattice.gap_um)
    cell = (math.sqrt(3) * pitch, pitch)
    y, x = axis[:, None] - phase[0] * cell[0], axis[None, :] - phase[1] * 3 * pitch
    # a hexagonal array is two rectangular ones
    nearest, kind = np.full((size, size), np.inf), np.zeros((size, size), int)
    for half in (0, 1):
        row, column = np.round(y / cell[0] - half / 2), np.round(x / cell[1] - half / 2)
        distance = np.hypot(y - (row + half / 2) * cell[0], x - (column + half / 2) * cell[1])
        kind = np.where(distance < nearest, (column - half) % 3, kind).astype(int)
        nearest = np.minimum(distance, nearest)
    focal = np.array([one.focal_length_um for one in lattice.types])[kind]
    open_ = np.clip((lattice.clear_um / 2 - nearest) / step + 0.5, 0, 1)
    lens = open_ * np.exp(-1j * np.pi / wave / focal * nearest**2)
    light = np.abs(sf.ifft2(sf.fft2(field * lens) * np.exp(1j * lattice.gap_um * along))) ** 2
    return light.reshape(pixels, PER_PX, pixels, PER_PX).sum((1, 3))


def crosstalk(light: NDArray[np.float64], cutout: int, pitch: int) -> float:
    """Return the light of eight neighbours in a cutout over its own."""
    middle, half = light.shape[0] // 2, cutout // 2

    def held(row: int, column: int) -> float:
        top, left = middle + row * pitch - half, middle + column * pitch - half
        return float(light[max(top, 0) : top + cutout, max(left, 0) : left + cutout].sum())

    around = [(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column]
    return sum(held(*one) for one in around) / held(0, 0)


@pytest.mark.long
@pytest.mark.parametrize(
    ("depth", "window", "aside"),
    [(2.0, 101, (-2, 3, 12)), (4.0, 151, (-1, 6))],
)
def test_crosstalk_is_that_of_waves_through_the_whole_array(depth: float, window: int, aside: tuple[int, ...]) -> None:
    camera = round_iris(240)
    scan = ScanPlan.for_camera(camera, virtual_depths=(depth,))
    (cutout, _), found = scan.cutout, simulated_tails(scan, 0)
    # phases 0, 1/3 and 2/3, of which the last mirrors the second
    phases = ((0.0, 1), (1 / 3, 2))
    light = sum(a * b * rendered(camera, scan.depths_um[0], window, (y, x)) for y, a in phases for x, b in phases)
    assert isinstance(light, np.ndarray)
    # the rest is light beyond 27°, and how the edges of lenslets lie on samples
    for pitch in (cutout + px for px in aside):
        share = crosstalk(light, cutout, pitch)
        assert share > 1e-3 and found.grid((pitch, pitch)) == pytest.approx(share, rel=0.25), pitch


def test_the_window_of_crosstalk_is_limited_by_the_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    scan = ScanPlan.for_camera(round_iris(240), virtual_depths=(2.0,))
    whole = simulated_tails(scan, 0)
    assert simulated_tails(scan, 0) is whole and not whole.light.flags.writeable, "simulated once"
    simulated_tails.cache_clear()
    monkeypatch.setattr("lfcal.simulate.accuracy.sampling.MAX_SAMPLES", 320)
    less = simulated_tails(scan, 0)
    simulated_tails.cache_clear()
    assert less.light.shape < whole.light.shape == (101, 101)
    near = (scan.cutout[0], scan.cutout[0])
    assert less.grid(near) == pytest.approx(whole.grid(near), rel=0.4)


def test_the_smallest_pitch_is_searched_up_to_two_cutouts() -> None:
    """Cutouts of 5 px at multiples of the pitch contain light at one distance up to two pixels from their middle."""
    for away, least in ((6, 9), (4, 7), (7, None)):
        light = np.zeros((21, 21))
        light[10, 10], light[10 + away, 10] = 1.0, 0.01
        tails = Tails(light, (5, 5), "waves")
        if least is None:
            with pytest.raises(InputError, match="at most two cutouts apart"):
                tails.least_pitch(0.005)
        else:
            assert tails.least_pitch(0.005) == least


RAYS = Wishes(level="geometric")


def brute(scan: ScanPlan, plan: TargetPlan, tolerance: float) -> int:
    """Return how many phases a plan of an upright, straight array shows: distances modulo the true period, no tree."""
    period = np.array(scan.camera.period_px)
    rows, columns = np.indices(scan.period).reshape(2, -1)
    wanted = np.stack([rows, columns], axis=1) + np.array(scan.anchor)
    shown = np.zeros(len(wanted), np.bool_)
    for k in range(len(plan.offsets_px[0])):
        for place in plan.points(0, k).pixels:
            off = wanted - place
            off -= period * np.round(off / period)
            shown |= (np.abs(off) <= tolerance).all(axis=1)
    return int(shown.sum())


@pytest.mark.long
@pytest.mark.parametrize("cutout", [None, 181])
def test_an_r29_is_covered_with_nearly_the_fewest_frames(cutout: int | None) -> None:
    scan = ScanPlan.for_camera(preset("r29"), virtual_depths=(4.0,), cutout=cutout)
    plan = plan_target(scan, propose_target(scan, RAYS), RAYS)
    few, many = plan.points_a_frame(0)
    assert few == many > 600
    least = math.ceil(5225 / many)
    assert plan.least_frames(0) == least
    assert plan.coverage(0) == 1.0 and brute(scan, plan, 0.1001) == 5225
    assert len(plan.offsets_px[0]) <= 1.6 * least
    assert plan.crosstalk[0] <= RAYS.crosstalk
    assert plan.single().frames == 5225 and plan.single().hours > 100 * plan.forecast().hours
    assert len(plan.to_json()) < 20_000


@pytest.mark.long
def test_proposals_for_other_cameras() -> None:
    for camera, planes in ((bench(720), {"virtual_depths": (4.0,)}), (preset("lfm_20x05"), {"depths_um": (20.0,)})):
        scan = ScanPlan.for_camera(camera, **planes)
        plan = plan_target(scan, propose_target(scan, RAYS, hole_um=0.5), RAYS)
        assert plan.target.hole_um == 0.5 and plan.coverage(0) == 1.0
        # few frames are a product of two whole numbers, each rounded up
        assert len(plan.offsets_px[0]) <= 2 * plan.least_frames(0)


def test_a_vernier_covers_its_period_once() -> None:
    phases = Phases.of(ScanPlan.for_camera(preset("r29"), virtual_depths=(4.0,)))
    for axis, (length, count) in enumerate(((31.7 * math.sqrt(3), 55), (95.1, 95))):
        found = proposed_axis(phases, axis, 150.0, 0.1)
        assert (found.pitch_px - found.step) / length == pytest.approx(round((found.pitch_px - found.step) / length))
        assert found.pitch_px >= 150 and found.frames <= 1.6 * math.ceil(count / found.holes)
        # half a period of offsets, and a cutout at either end
        span = (found.holes - 1) * found.pitch_px + length + 129
        assert span <= (4384, 6576)[axis]


def test_no_proposal_without_room() -> None:
    with pytest.raises(InputError, match="room for two cutouts"):
        propose_target(scan_of(bench(64)), RAYS)


# -- crosstalk -------------------------------------------------------------------------------------------


def test_light_of_neighbours_adds_up_as_in_a_frame() -> None:
    scan = ScanPlan.for_camera(bench(), virtual_depths=(4.0,))
    rays, tails = simulated_tails(scan, 0, level="geometric"), simulated_tails(scan, 0)
    assert tails.level == "wave" and tails.light.shape == (4 * scan.cutout[0] + 1, 4 * scan.cutout[1] + 1)
    half = tails.light.shape[0] // 2
    # a frame of three by three patterns 47 px apart, added pixel by pixel
    size = tails.light.shape[0] + 2 * 47
    frame, alone = np.zeros((size, size)), np.zeros((size, size))
    for i, j in np.ndindex(3, 3):
        frame[47 * i : 47 * i + 2 * half + 1, 47 * j : 47 * j + 2 * half + 1] += tails.light
    alone[47 : 47 + 2 * half + 1, 47 : 47 + 2 * half + 1] += tails.light
    middle, reach = size // 2, (scan.cutout[0] - 1) // 2
    part = (slice(middle - reach, middle + reach + 1),) * 2
    crossing = frame[part].sum() / alone[part].sum() - 1
    index = np.mgrid[-1:2, -1:2].reshape(2, -1).T * 47.0
    assert tails.share(index[np.abs(index).any(axis=1)]).sum() == pytest.approx(crossing, rel=1e-6)
    assert tails.grid((47.0, 47.0)) == pytest.approx(crossing, rel=0.05)
    assert tails.share(np.zeros((1, 2)))[0] == pytest.approx(1.0)
    # waves have tails and rays do not
    far = (float(scan.cutout[0]),) * 2
    assert rays.grid(far) == 0 and 2e-3 < tails.grid(far) < 1e-2
    assert rays.least_pitch(0.001) < tails.least_pitch(0.001) > tails.least_pitch(0.02)


def test_crosstalk_among_holes_is_that_of_the_worst() -> None:
    light = np.zeros((27, 27))
    light[13, 13], light[13, 23] = 1.0, 0.25
    tails = Tails(light, (9, 9), "geometric")
    # a hole 10 px to the left throws a quarter into the cutout
    assert tails.share(np.array([[0.0, -10.0], [0.0, 10.0], [10.0, 0.0]])).tolist() == [0.25, 0.0, 0.0]
    camera = bench()
    step = camera.step_um(-26e3)
    images = hole_images(Target("square", (2, 3), (40 * step, 10 * step)), camera, -26e3)
    assert tails.among(images) == pytest.approx(0.25)
    assert tails.among(images.only(np.arange(6) == 0)) == 0.0


def test_holes_that_are_too_close_are_refused_with_the_needed_distance() -> None:
    scan = ScanPlan.for_camera(bench(), virtual_depths=(4.0,))
    with pytest.raises(InputError, match=r"crosstalk of holes 1 mm apart.*at most 0\.5 %.*choose holes .* apart"):
        plan_target(scan, parse_target("array:4x4@1mm"))
    with pytest.raises(InputError, match="is on the sensor"):
        plan_target(scan, replace(parse_target("array:4x4@2mm"), pose=Pose(right_um=1e5)))


def test_the_distance_that_a_refusal_asks_for_is_enough_in_all_planes() -> None:
    scan = ScanPlan.for_camera(bench(), virtual_depths=(2.0, 4.0), cutout=31)
    wishes = Wishes(most_frames=1, level="geometric", crosstalk=0.001)
    for pose in (Pose(), Pose(tilt_right_rad=math.radians(50))):
        target = replace(parse_target("array:3x3@700um"), pose=pose)
        with pytest.raises(InputError, match=r"in the plane at -\d.*choose holes ") as refused:
            plan_target(scan, target, wishes)
        apart = re.search(r"choose holes ([\d.]+) (mm|µm) apart", str(refused.value))
        assert apart is not None
        wide = float(apart[1]) * (1e3 if apart[2] == "mm" else 1.0) + 1
        assert wide > target.nearest_um
        plan = plan_target(scan, replace(target, pitch_um=(wide, wide)), wishes)
        assert max(plan.crosstalk) <= wishes.crosstalk


def test_crosstalk_is_checked_before_the_search_for_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last plane of a long search was found to have too much of it."""
    scan = ScanPlan.for_camera(bench(), virtual_depths=(2.0, 4.0), cutout=31)
    monkeypatch.setattr("lfcal.targets.planning.iter_cover", lambda *_, **__: pytest.fail("looked for frames"))
    with pytest.raises(InputError, match="choose holes"):
        plan_target(scan, parse_target("array:3x3@700um"), Wishes(level="geometric", crosstalk=0.1))


# -- plans -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def tilted() -> TargetPlan:
    """Return a plan of two planes, of a target that is turned and tilted."""
    camera = small()
    scan = ScanPlan.for_camera(
        camera, virtual_depths=(4.0, 3.0), cutout=31, stage=StageAxes("-x", "+y", "+z", (1.0, 2.0, 3.0))
    )
    pose = Pose(math.radians(1), math.radians(2), 0.0, right_um=50.0)
    target = Target("square", (6, 6), (1021.3, 1021.3), 20.0, pose=pose, within=Pose(rotation_rad=0.01))
    return plan_target(scan, target, Wishes(level="geometric", most_frames=20))


def test_every_plane_is_planned_for_its_own_magnification(tilted: TargetPlan) -> None:
    assert [len(plane) for plane in tilted.offsets_px] == [20, 20] and len(tilted.frames) == 40
    assert tilted.offsets_px[0] != tilted.offsets_px[1]
    for z in (0, 1):
        assert 0.3 < tilted.coverage(z) < 1
        counts = tilted.shown(z)
        assert counts.shape == tilted.scan.period and (counts > 0).mean() == tilted.coverage(z)
        assert tilted.coverage(z, tolerance_px=0.5) > tilted.coverage(z)


def test_points_of_a_frame_follow_the_stage(tilted: TargetPlan) -> None:
    scan, stage = tilted.scan, tilted.stage_um()
    assert stage.shape == (40, 3)
    for number in (0, 19, 20, 39):
        z, k = tilted.frames[number]
        right, down, away = scan.stage.to_object(stage[number])
        assert away == pytest.approx(scan.depths_um[z])
        pose = replace(tilted.target.pose, right_um=tilted.target.pose.right_um + right, down_um=down)
        images = hole_images(replace(tilted.target, pose=pose), scan.camera, scan.depths_um[z])
        points = tilted.points(z, k)
        on = images.whole(scan.camera.sensor.shape, scan.cutout)
        assert points.holes.tolist() == images.holes[on].tolist()
        assert points.pixels == pytest.approx(images.pixels[on], abs=1e-6)


def test_the_time_of_a_plan_is_that_of_a_scan(tilted: TargetPlan) -> None:
    got = tilted.forecast(500.0)
    moves = np.abs(np.diff(tilted.stage_um(), axis=0)).max(axis=1).sum()
    assert got.frames == 40 and got.exposure_hours == pytest.approx(40 * 0.02 / 3600)
    assert got.settle_hours == pytest.approx(40 * 0.05 / 3600) and got.move_hours == pytest.approx(moves / 500 / 3600)
    assert tilted.single(500.0) == Forecast.of(tilted.scan, stage_um_per_s=500.0)
    scan = replace(scan_of(small()), exposure_s=0.5, frames_averaged=3)
    single = plan_target(scan, Target(), RAYS)
    # a target of one point is the scan itself, up to the order of its moves
    assert single.forecast().frames == single.single().frames == 3 * 252
    assert single.forecast().exposure_hours == pytest.approx(single.single().exposure_hours)
    assert single.forecast().settle_hours == pytest.approx(single.single().settle_hours)
    with pytest.raises(InputError, match="speed"):
        single.forecast(0.0)


def test_a_plan_is_written_and_read(tilted: TargetPlan) -> None:
    assert TargetPlan.from_json(tilted.to_json()) == tilted
    with pytest.raises(InputError, match="scan plan"):
        ScanPlan.from_json(tilted.to_json())


def test_damaged_plans_are_refused(tilted: TargetPlan) -> None:
    data = json.loads(tilted.to_json())
    for change in (
        {"format": "lfcal-plan"},
        {"version": 7},
        {"scan": None},
        {"scan_version": 9},
        {"offsets_px": [[[0.0, 0.0]]]},
        {"offsets_px": [[[0.0]], [[0.0, 0.0]]]},
        {"crosstalk": [0.1]},
        {"tolerance_px": 0},
        {"extra": 1},
    ):
        with pytest.raises(InputError, match=r"^[^\n]*$"):
            TargetPlan.from_dict({**data, **change})
            pytest.fail(f"accepted {change}")


# -- poses that are not known ----------------------------------------------------------------------------


def test_a_wrong_pose_shows_other_phases() -> None:
    scan = scan_of(small())
    target = Target("square", (6, 6), (1021.3, 1021.3), pose=Pose(rotation_rad=math.radians(1)))
    plan = plan_target(scan, target, RAYS)
    assert plan.coverage(0) == 1.0
    # bounds that move no hole by more than what its phase was off already lose little
    near = replace(plan, target=replace(target, within=Pose(right_um=0.1)))
    assert (shown_within(near, 0) > 0.9).all()
    far = replace(plan, target=replace(target, within=Pose(rotation_rad=math.radians(0.5))))
    drawn = shown_within(far, 0, count=6)
    assert drawn.mean() < 0.5 and drawn.min() < 0.2 and (drawn > 0.05).all()
    assert shown_within(far, 0, count=6).tolist() == drawn.tolist()
    # what the first frame tells: the plan of the measured pose covers all
    measured = replace(target, pose=next(poses_within(far.target, 1, seed=5)))
    assert plan_target(scan, measured, RAYS).coverage(0) == 1.0


def test_poses_are_drawn_within_their_bounds() -> None:
    within = Pose(0.01, 0.02, 0.0, 3.0, 4.0, 5.0)
    target = Target("square", (2, 2), (9.0, 9.0), pose=Pose(right_um=100.0), within=within)
    drawn = list(poses_within(target, 200))
    right = np.array([pose.right_um for pose in drawn])
    assert abs(right - 100).max() <= 3 and np.ptp(right) > 5
    assert all(pose.tilt_down_rad == 0 for pose in drawn) and Pose().known and not within.known


SMALL = scan_of(small(160))


def test_the_share_of_noise_is_that_of_exposed_frames() -> None:
    noise = {"shot_noise": "on", "read_noise": "on"}
    effects = plan_effects(SMALL, TOLERANCE, noise, frames=True, peak=0.8).effects
    camera = SimulatedCamera(SMALL, effects, tolerance=TOLERANCE)
    sensor, shares = SMALL.camera.sensor, []
    for index in (0, 60, 130, 200, 250):
        light = camera.light(index)
        row, column = np.floor(np.array(camera.image_px(index)) + 0.5).astype(int)
        box = np.s_[row - 15 : row + 16, column - 15 : column + 16]
        frame = camera.expose(light, SMALL.exposures[0], FrameKind.LIGHT, index)[box].astype(float)
        electrons = (frame - sensor.black_level) * sensor.electrons_per_count
        shares.append(np.abs(electrons - light[box]).sum() / light[box].sum())
    # rounding to counts and the sensor's other traits are no part of it
    assert noise_share(SMALL, 0) == pytest.approx(np.mean(shares), rel=0.1)


def test_the_noise_of_means_falls_with_the_root_of_the_frames() -> None:
    four = replace(SMALL, frames_averaged=4)
    assert noise_share(four, 0) == pytest.approx(noise_share(SMALL, 0) / 2, rel=1e-6)


def test_error_and_coverage_of_more_frames() -> None:
    step = SMALL.camera.step_um(SMALL.depths_um[0])
    target = Target("square", (3, 3), (41 * step, 43 * step))
    plan = plan_target(SMALL, target, Wishes(most_frames=12, level="geometric"))
    found = error_forecast(plan, 0, single=0.1)
    assert found.single == 0.1 and len(found.shown) == len(found.error) == 12
    assert (np.diff(found.shown) >= 0).all() and found.shown[-1] == pytest.approx(plan.coverage(0))
    assert (found.error <= 0.1 + 1e-12).all()
    # the same frames again: twice the measurements of each position
    twice = replace(plan, offsets_px=(plan.offsets_px[0] * 2,))
    again = error_forecast(twice, 0, single=0.1)
    assert again.shown[-1] == found.shown[-1]
    assert again.error[-1] == pytest.approx(found.error[-1] / np.sqrt(2))
    none = error_forecast(replace(plan, offsets_px=((),)), 0, single=0.1)
    assert len(none.shown) == 0
