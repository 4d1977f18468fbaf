"""Targets in words and files, where their holes are imaged, and on which phases."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, MainLens, preset
from lfcal.targets import Pose, Target, parse_target, target_words
from lfcal.targets.images import hole_images
from lfcal.targets.phases import Phases
from lfcal.targets.target import proposed_hole
from tests.targets.common import bench, distorted, scan_of, turned

TARGETS = {
    "point": Target(),
    "point,hole=50um": Target(hole_um=50.0),
    "array:12x12@1.2mm": Target("square", (12, 12), (1200.0, 1200.0)),
    "array:3x4@800umx1.5mm,hole=20": Target("square", (3, 4), (800.0, 1500.0), 20.0),
    "array:5x4@1mm,hex": Target("hexagonal", (5, 4), (1000 * math.sqrt(3) / 2, 1000.0)),
    "array:5x4@1mm,absent=0:0+0:1": Target("square", (5, 4), (1000.0, 1000.0), absent=((0, 0), (0, 1))),
}


def test_words_describe_the_target() -> None:
    for words, target in TARGETS.items():
        assert parse_target(words) == target
        again = parse_target(target_words(target))
        assert again.pitch_um == pytest.approx(target.pitch_um, rel=1e-9)
        assert replace(again, pitch_um=target.pitch_um) == target


def test_a_pitch_may_be_left_to_be_proposed() -> None:
    assert proposed_hole("array") == 0 and proposed_hole("array,hole=20um") == 20
    assert proposed_hole("array:2x2@1mm") is None
    with pytest.raises(InputError, match="where the pitch is proposed"):
        proposed_hole("array,hex")


WRONG = [
    *("", "line", "array:12x12", "array:12@1mm", "array:12x12@", "array:12x12@1cm", "array:0x12@1mm"),
    *("array:12x12@-1mm", "array:12x12@nan", "array:1x1@1mm", "array:999999x999999@1mm", "array:4x4@1mm,hole=1.1mm"),
    *("array:4x4@1mmx2mm,hex", "array:4x4@1mm,hex,hex", "array:4x4@1mm,absent=4:0", "array:4x4@1mm,absent=1:0+1:0"),
    *("array:4x4@1mm,size=3", "point,hex", "point,hole=-3"),
]


def test_wrong_words_are_refused_in_a_line() -> None:
    for words in WRONG:
        with pytest.raises(InputError, match=r"^[^\n]*expected[^\n]*$"):
            parse_target(words)


def test_targets_are_written_and_read_and_wrong_files_are_refused() -> None:
    pose = Pose(0.1, 0.02, -0.03, 5.0, -7.0, 100.0)
    target = Target("hexagonal", (7, 5), (900.0, 1000.0), 20.0, ((1, 2),), pose, Pose(rotation_rad=0.01))
    for one in (target, Target()):
        assert Target.from_json(one.to_json()) == one
    data = json.loads(parse_target("array:3x4@1mm").to_json())
    for change in (
        {"format": "lfcal-plan"},
        {"version": 2},
        {"kind": "round"},
        {"shape": [3]},
        {"shape": [3.5, 2]},
        {"pitch_um": [1000.0]},
        {"hole_um": "20"},
        {"pose": {"rotation_rad": 0.1}},
        {"within": None},
        {"colour": "red"},
    ):
        with pytest.raises(InputError):
            Target.from_dict({**data, **change})
            pytest.fail(f"accepted {change}")
    with pytest.raises(InputError, match="bound"):
        Target(within=Pose(right_um=-1.0))


def test_holes_lie_about_the_middle() -> None:
    square = parse_target("array:3x4@2mmx1mm")
    flat = square.flat_um(square.holes)
    assert flat.mean(axis=0) == pytest.approx([0, 0])
    assert flat[0].tolist() == [-1500.0, -2000.0] and flat[1].tolist() == [-500.0, -2000.0]
    hexagonal = parse_target("array:4x4@1mm,hex")
    flat = hexagonal.flat_um(hexagonal.holes)
    assert flat.mean(axis=0) == pytest.approx([0, 0])
    # every hole but those of the rim has six neighbours at one pitch
    distance = np.hypot(*(flat[:, None] - flat[None]).transpose(2, 0, 1))
    assert (np.abs(distance - 1000) < 1e-6).sum(axis=1).max() == 6
    assert np.sort(distance, axis=1)[:, 1] == pytest.approx(1000.0)
    assert hexagonal.nearest_um == pytest.approx(1000.0) and Target().nearest_um == math.inf
    for shape, nearest in (((1, 5), 1000.0), ((5, 1), 700.0), ((5, 5), 700.0)):
        assert Target("square", shape, (700.0, 1000.0)).nearest_um == nearest
    absent = parse_target("array:2x3@1mm,absent=0:1")
    assert absent.holes.tolist() == [[0, 0], [0, 2], [1, 0], [1, 1], [1, 2]]


def test_poses_in_words() -> None:
    pose = Pose.parse("rotation=90, tilt_right=30,right=1mm,down=-20um,away=5")
    assert pose.rotation_rad == pytest.approx(math.pi / 2) and pose.tilt_right_rad == pytest.approx(math.pi / 6)
    assert (pose.right_um, pose.down_um, pose.away_um, pose.tilt_down_rad) == (1000.0, -20.0, 5.0, 0.0)
    for wrong in ("turn=1", "rotation", "rotation=1,rotation=2", "tilt_down=80", "right=1m", "rotation=inf"):
        with pytest.raises(InputError):
            Pose.parse(wrong)


def test_directions_of_turns_and_tilts() -> None:
    right = np.array([[1.0, 0.0]])
    assert Pose.parse("rotation=90").points(right)[0] == pytest.approx([0, 1, 0], abs=1e-12)
    assert Pose.parse("tilt_right=30").points(right)[0] == pytest.approx([math.sqrt(0.75), 0, 0.5])
    assert Pose.parse("tilt_down=30").points(np.array([[0.0, 1.0]]))[0] == pytest.approx([0, math.sqrt(0.75), 0.5])
    turn = Pose(0.3, 0.2, -0.1).turn()
    assert turn @ turn.T == pytest.approx(np.eye(3)) and np.linalg.det(turn) == pytest.approx(1.0)


def ray(camera: Camera, point: tuple[float, float, float]) -> tuple[float, float]:
    """Follow the ray through the middle of the main lens to the sensor (pixels): similar triangles, nothing else."""
    assert isinstance(camera.optics, MainLens)
    f, distance = camera.optics.focal_length_um, camera.optics.working_distance_um
    to_sensor = 1 / (1 / f - 1 / distance) + camera.lattice.gap_um
    right, down, away = point
    scale = to_sensor / (distance + away) / camera.sensor.pixel_um
    rows, columns = camera.sensor.shape
    return (rows - 1) / 2 + down * scale, (columns - 1) / 2 + right * scale


def test_a_tilted_target_is_seen_in_perspective() -> None:
    camera, z = bench(), -26e3
    pose = Pose(rotation_rad=0.3, tilt_right_rad=0.2, tilt_down_rad=-0.1, right_um=300.0, down_um=-500.0, away_um=40.0)
    target = Target("square", (3, 5), (1500.0, 1300.0), pose=pose)
    images = hole_images(target, camera, z)
    for (row, column), pixel, away in zip(images.holes, images.pixels, images.away_um, strict=True):
        u, v = (column - 2) * 1300.0, (row - 1) * 1500.0
        u, v = u * math.cos(0.3) - v * math.sin(0.3), u * math.sin(0.3) + v * math.cos(0.3)
        u, w = u * math.cos(0.2), u * math.sin(0.2)
        v, w = v * math.cos(-0.1) - w * math.sin(-0.1), v * math.sin(-0.1) + w * math.cos(-0.1)
        point = (u + 300, v - 500, z + w + 40)
        assert pixel == pytest.approx(ray(camera, point), abs=1e-6)
        assert away == pytest.approx(point[2])


def test_a_microscope_sees_no_perspective() -> None:
    camera = preset("lfm_20x05")
    target = Target("square", (2, 2), (20.0, 30.0), pose=Pose(tilt_right_rad=0.4))
    images = hole_images(target, camera, 5.0)
    step = camera.sensor.pixel_um / 20
    assert np.ptp(images.pixels[:, 1]) == pytest.approx(30 * math.cos(0.4) / step)
    assert np.ptp(images.pixels[:, 0]) == pytest.approx(20 / step)
    assert images.shift == pytest.approx(1.0)


def test_images_of_a_moved_target_move() -> None:
    camera, z = bench(), -26e3
    target = Target("square", (4, 4), (1500.0, 1500.0), pose=Pose(tilt_right_rad=0.03))
    step = camera.step_um(z)
    pose = replace(target.pose, right_um=7.3 * step, down_um=-4.1 * step)
    moved = hole_images(replace(target, pose=pose), camera, z)
    assert hole_images(target, camera, z).moved(np.array([-4.1, 7.3])) == pytest.approx(moved.pixels, abs=1e-9)


def test_cutouts_that_leave_the_sensor_are_not_whole() -> None:
    camera = bench(100)
    step = camera.step_um(-26e3)
    target = Target("square", (1, 3), (1.0, 30 * step))
    images = hole_images(target, camera, -26e3)
    assert images.pixels[:, 1] == pytest.approx([19.5, 49.5, 79.5])
    # about the pixel 20 a cutout of 41 begins at column 0; 80 + 20 is column 100, which is not there
    assert images.whole((100, 100), (41, 41)).tolist() == [True, True, False]
    assert images.whole((100, 100), (41, 43)).tolist() == [False, True, False]
    assert images.whole((100, 100), (41, 41), (0.0, -1.0)).tolist() == [False, True, True]
    # 19.4 px is nearest to 19, whose cutout begins outside the sensor; 79.4 is nearest to 79
    assert images.whole((100, 100), (41, 41), (0.0, -0.1)).tolist() == [False, True, True]


def test_a_target_behind_the_lens_is_refused() -> None:
    with pytest.raises(InputError, match="depth"):
        hole_images(parse_target("point"), bench(), -299e3)


CAMERAS = {
    "upright": bench(),
    "turned": turned(bench(), 0.02),
    "on end": turned(bench(), math.pi / 2 + 0.01),
    "upside down": turned(bench(), math.pi),
    "distorted": distorted(bench()),
}


@pytest.mark.parametrize("name", CAMERAS)
def test_phases_repeat_with_the_lenslets_not_with_pixels(name: str) -> None:
    camera = CAMERAS[name]
    scan, lattice, rng = scan_of(camera), camera.lattice, np.random.default_rng(3)
    phases = Phases.of(scan)
    assert phases.period == pytest.approx(scan.cell_camera.period_px, rel=2e-3)
    for k in rng.choice(len(phases.wanted()), 25, replace=False).tolist():
        place = scan.image_px([0, *divmod(k, scan.period[1])])
        index = lattice.lenslet_at(camera.sensor_um(place))
        # the same place in another cell: three lenslets on in the row, or two rows down and one back
        across, along = rng.integers(-3, 4, 2).tolist()
        other = index + across * np.array([-1, 2]) + along * np.array([3, 0])
        assert len({lattice.type_of(*np.rint(one).astype(int)) for one in (index, other)}) == 1
        elsewhere = camera.pixels(lattice.centres_um(*other))
        assert phases.covered(elsewhere[None], 1e-6).tolist() == [k]
        # whole pixels modulo the whole period are another phase six cells away
        naive = np.array(place) + np.array(scan.period) * 6
        assert k not in phases.covered(naive[None], 0.1)


def test_a_phase_is_met_within_the_tolerance_and_not_beyond() -> None:
    phases = Phases.of(scan_of(bench()))
    place = phases.plan.image_px([0, 4, 7])
    k = 4 * phases.plan.period[1] + 7
    assert phases.covered(place[None] + np.array([0.099, -0.099]), 0.1).tolist() == [k]
    assert not len(phases.covered(place[None] + np.array([0.101, 0.0]), 0.1))
    assert not len(phases.covered(np.zeros((0, 2)), 0.1))
    # the last row lies next to the first of the cell below: 19.05 rows are a cell
    below = phases.plan.image_px([0, 0, 7]) + np.array([19.0, 0.0])
    assert phases.covered(below[None], 0.1).tolist() == [7]


def test_rates_are_how_phases_change() -> None:
    for camera in (CAMERAS["turned"], CAMERAS["distorted"]):
        phases = Phases.of(scan_of(camera))
        places = np.array([[100.0, 120.0], [300.0, 200.0]])
        rates = phases.rates(places)
        moved = phases.cells(places + np.array([0.3, 0.2])) - phases.cells(places)
        assert moved * phases.period == pytest.approx(rates @ [0.3, 0.2], abs=1e-4)
