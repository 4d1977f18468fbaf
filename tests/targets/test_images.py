"""Where holes are imaged, and on which phases: against rays and lenslets followed one by one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, MainLens, preset
from lfcal.targets import Pose, Target, parse_target
from lfcal.targets.images import hole_images
from lfcal.targets.phases import Phases
from tests.targets.common import bench, distorted, scan_of, turned


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


def test_a_moved_target_is_a_target_moved() -> None:
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
    # 19.4 px is nearest to 19, whose cutout begins beside the sensor; 79.4 is nearest to 79
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
    scan = scan_of(camera)
    phases = Phases.of(scan)
    assert phases.period == pytest.approx(scan.cell_camera.period_px, rel=2e-3)
    wanted = phases.wanted()
    rng = np.random.default_rng(3)
    lattice = camera.lattice
    for k in rng.choice(len(wanted), 25, replace=False).tolist():
        place = scan.image_px([0, *divmod(k, scan.period[1])])
        index = lattice.lenslet_at(camera.sensor_um(place))
        # the same place in another cell: three lenslets on in the row, or two rows down and one back
        across, along = rng.integers(-3, 4, 2).tolist()
        elsewhere = camera.pixels(lattice.centres_um(*(index + across * np.array([-1, 2]) + along * np.array([3, 0]))))
        assert lattice.type_of(*np.rint(index).astype(int)) == lattice.type_of(
            *np.rint(index + across * np.array([-1, 2]) + along * np.array([3, 0])).astype(int)
        )
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
