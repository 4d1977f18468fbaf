import math
from dataclasses import replace

import pytest

from lfcal.camera import preset
from lfcal.psf.aperture import expected_aperture, footprint_px

BENCH = preset("bench")


@pytest.mark.parametrize("virtual_depth", [4.0, -3.0])
def test_the_expected_shadow_follows_rays(virtual_depth):
    depth = BENCH.depth_of(virtual_depth)
    found = expected_aperture(BENCH, depth, (61, 71))
    shift, gap, optics = BENCH.image_shift_um(depth), BENCH.lattice.gap_um, BENCH.optics
    # a ray from the pupil's rim to the image, met by the sensor on its way
    rim, image = optics.focal_length_um / optics.f_number / 2, optics.image_distance_um + shift
    height = rim + (0 - rim) * (optics.image_distance_um + gap) / image
    assert found.diameter_px == pytest.approx(2 * abs(height) / BENCH.sensor.pixel_um)
    assert found.centre == (30, 35) and found.blades == optics.blades
    step = 2 * math.pi / optics.blades
    # rays that have crossed the axis draw the iris turned by half
    turned = 0.0 if height > 0 else math.pi
    assert found.rotation_rad == pytest.approx((optics.blade_rotation_rad + turned) % step)


def test_a_microscope_and_an_open_lens_are_round():
    scope = preset("lfm_20x05")
    assert expected_aperture(scope, 22.0, (101, 101)).kind == "round"
    open_lens = replace(BENCH, optics=replace(BENCH.optics, blades=0))
    assert expected_aperture(open_lens, open_lens.depth_of(3.0), (61, 61)).blades == 0


def test_a_lenslet_spreads_light_over_its_own_image():
    # 58.3 µm, of which the strongest type's lenslets leave four fifths on a sensor of 5.5 µm
    assert footprint_px(BENCH) == pytest.approx(0.8 * 58.3 / 5.5)
    assert footprint_px(BENCH, (2.0, 2.0)) == pytest.approx(2 * footprint_px(BENCH))
    assert footprint_px(None) == 0
