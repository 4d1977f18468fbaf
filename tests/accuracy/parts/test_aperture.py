"""Aperture fit: the iris by a ray trace, the noise by its variance, and what a whole period shows."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.accuracy import PARTS, Subject, measure_curve
from lfcal.accuracy.parts.aperture import FULL, iris_diameter_px, noisy_sum
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset


def test_the_diameter_is_that_of_a_ray_trace() -> None:
    """A ray from the pupil's rim through the image point, cut with the sensor's plane behind the lenslets."""
    camera = preset("bench")
    z = camera.depth_of(4.0)
    optics = camera.optics
    focus = optics.image_distance_um + camera.image_shift_um(z)  # from the main lens to the image of the point
    array, gap = optics.image_distance_um, camera.lattice.gap_um
    rim = optics.focal_length_um / optics.f_number / 2
    at_array = rim * (1 - array / focus)
    # a lenslet's centre is where its chief ray goes straight on: the cone goes on behind the array
    at_sensor = rim + (0 - rim) / focus * (array + gap)
    assert abs(at_array) > 0
    assert iris_diameter_px(camera, z) == pytest.approx(2 * abs(at_sensor) / camera.sensor.pixel_um, rel=1e-9)


def test_what_has_no_iris_says_so() -> None:
    microscope = preset("lfm_20x05")
    plan = ScanPlan.for_camera(microscope, depths_um=(-10.0, 10.0))
    assert "the iris of a main lens" in measure_curve(PARTS.get("aperture"), Subject("lfm", plan)).stopped
    with pytest.raises(InputError, match="a shadow larger than a lenslet"):
        iris_diameter_px(preset("bench"), preset("bench").depth_of(1.2))


def test_noise_of_a_sum_is_that_of_its_photons_and_frames() -> None:
    sensor = replace(preset("bench").sensor, read_noise_e=30.0)
    total = np.full((300, 300), 0.05)
    found = noisy_sum(total, 100, sensor, np.random.default_rng(0))
    electrons = 0.05 * FULL * sensor.full_well_e
    assert found.mean() == pytest.approx(electrons, rel=0.01)
    assert found.std() == pytest.approx(math.sqrt(electrons + 100 * 30.0**2), rel=0.02)


@pytest.mark.long
def test_all_positions_show_the_iris_of_the_description() -> None:
    plan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,))
    curve = measure_curve(PARTS.get("aperture"), Subject("bench", plan), 1000)
    frames = [r.cost for r in curve.points]
    assert frames == sorted(frames) and frames[0] == 9 and frames[-1] == 33 * 19
    whole = curve.points[-1]
    assert whole.error < 0.05 and whole.others["blades found"] == 7 and whole.note == ""
    assert curve.points[0].error > whole.error, "nine positions show spots, not an iris"
