import math

import numpy as np
import pytest
from scipy import ndimage, special

from lfcal.psf.aperture import fit_aperture
from lfcal.psf.aperture._synthetic import Disturbance, depth_sum_of
from lfcal.psf.aperture.shape import with_error


def diffracted_disc(radius, fringe_px, side=73, blur_px=1.5, over=5):
    """Return a disc behind whose edge light is diffracted as by a straight one (Born & Wolf 8.7.3), then blurred."""
    n = side * over
    at = (np.arange(n) + 0.5) / over - 0.5 - (side - 1) / 2
    inside = radius - np.hypot(at[:, None], at)
    s, c = special.fresnel(inside / fringe_px)
    light = 0.5 * ((0.5 + c) ** 2 + (0.5 + s) ** 2)
    fine = ndimage.gaussian_filter(light, blur_px * over)
    return fine.reshape(side, over, side, over).mean((1, 3))


@pytest.mark.parametrize(("radius", "fringe"), [(13.5, 2.0), (13.5, 3.0), (18.8, 2.5), (24.1, 3.0)])
def test_light_that_diffraction_takes_outwards_belongs_to_the_outline(radius, fringe):
    found = fit_aperture(diffracted_disc(radius, fringe))
    truth = math.pi * radius**2
    assert abs(found.area_px2 - truth) < 0.02 * truth
    assert abs(found.area_px2 - truth) < 2 * found.area_sigma_px2 < 0.08 * truth
    assert found.diameter_sigma_px == pytest.approx(found.area_sigma_px2 / (math.pi * found.diameter_px / 2), rel=1e-6)


@pytest.mark.long
@pytest.mark.few(1)
@pytest.mark.parametrize(("noise", "blur"), [(0.02, 2.0), (0.3, 2.0), (0.3, 4.0), (1.0, 1.0)])
def test_the_area_lies_within_its_stated_error_and_that_is_small(noise, blur):
    off = []
    for seed in range(8):
        image, truth = depth_sum_of(131, 7, 0.3, Disturbance(noise, blur), np.random.default_rng(seed))
        found = fit_aperture(image)
        assert found.area_sigma_px2 < 0.03 * truth.area_px2
        off.append((found.area_px2 - truth.area_px2) / found.area_sigma_px2)
    assert 0.05 < np.sqrt(np.mean(np.square(off))) < 1.6


def test_shading_is_no_loss_of_area():
    image, truth = depth_sum_of(131, 7, 0.3, Disturbance(0.0, 1.5, vignetting=0.25), np.random.default_rng(3))
    assert fit_aperture(image).area_px2 == pytest.approx(truth.area_px2, rel=2e-3)


def test_without_an_even_level_no_error_is_stated_and_no_size_corrected():
    spot = diffracted_disc(4.0, 2.0, side=41)
    found = fit_aperture(spot)
    assert found.seen and math.isnan(found.area_sigma_px2) and math.isnan(found.diameter_sigma_px)
    assert "±" not in found.describe()


def test_sizes_are_told_with_their_errors():
    found = fit_aperture(diffracted_disc(18.8, 2.5))
    assert f"diameter {found.diameter_px:.1f} ± {found.diameter_sigma_px:.1f} px" in found.describe()
    assert with_error(12.3, 0.0, 1) == "12.3 ± 0.0" and with_error(0.5, 0.00004, 1) == "0.500 ± 0.000"
