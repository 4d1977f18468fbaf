"""Profiles, regions and histograms against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal_gui.models.measure import MOST, fwhm, line_profile, region_numbers, value_histogram


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0, 200.0])
def test_the_width_of_a_round_spot_is_the_same_along_every_line(angle: float) -> None:
    r, c = np.mgrid[:61, :61]
    sigma, centre = 4.0, (30.0, 30.0)
    image = 50 + 1000 * np.exp(-((r - centre[0]) ** 2 + (c - centre[1]) ** 2) / (2 * sigma**2))
    along = 25 * np.array([math.sin(math.radians(angle)), math.cos(math.radians(angle))])
    found = line_profile(image, tuple(centre - along), tuple(centre + along))
    assert found.distance[-1] == pytest.approx(50)
    assert found.fwhm == pytest.approx(2 * math.sqrt(2 * math.log(2)) * sigma, rel=0.02)
    assert found.fwhm is not None and f"FWHM {found.fwhm:.2f} px" in found.words()


def test_values_between_pixels_are_linear_and_outside_there_are_none() -> None:
    image = np.add.outer(10.0 * np.arange(5), np.arange(6))
    found = line_profile(image, (1.5, 0.0), (1.5, 8.0))
    np.testing.assert_allclose(found.values[:6], 15 + np.arange(6))
    assert np.isnan(found.values[6:]).all() and found.fwhm is None
    assert "no peak" in found.words()


def test_a_peak_that_does_not_fall_to_half_has_no_width() -> None:
    x = np.arange(5.0)
    assert fwhm(x, x) is None and fwhm(x, np.ones(5)) is None and fwhm(x[:2], x[:2]) is None
    assert fwhm(x, np.array([0.0, 0, 1, 0, 0])) == pytest.approx(1.0)


def test_a_region_has_the_numbers_of_its_pixels() -> None:
    image = np.random.default_rng(1).random((20, 30)) * 1000
    part = image[4:9, 10:16]
    found = region_numbers(image, (3.2, 8.4), (9.5, 15.0))
    assert found is not None and (found.rows, found.columns) == ((4, 9), (10, 16))
    assert (found.mean, found.deviation) == (pytest.approx(part.mean()), pytest.approx(part.std()))
    assert (found.low, found.high, found.total) == (part.min(), part.max(), pytest.approx(part.sum()))
    size, statistics = found.words("light (counts)").splitlines()[:2]
    assert size == "6 × 5 px, rows 4 to 8, columns 10 to 15", "width × height, as of a frame"
    assert statistics.startswith(f"light (counts): mean {part.mean():.5g}, ")
    assert region_numbers(image, (-5, -1), (0, 5)) is None and region_numbers(image, (3.1, 3.9), (0, 5)) is None


def test_the_centroid_is_where_the_light_is() -> None:
    image = np.full((9, 9), 7.0)
    image[2, 5], image[3, 5] = 8.0, 10.0
    found = region_numbers(image, (0, 8), (0, 8))
    assert found is not None and found.centre == (pytest.approx(2.75), pytest.approx(5.0))
    flat = region_numbers(np.ones((3, 3)), (0, 2), (0, 2))
    assert flat is not None and flat.centre is None and "centroid" not in flat.words("light")


def test_a_histogram_leaves_out_what_is_no_number() -> None:
    image = np.array([[0.0, 1.0, 1.0], [np.nan, 4.0, np.inf]])
    middles, counts = value_histogram(image, 4)
    assert counts.tolist() == [1, 2, 0, 1] and middles[0] == 0.5
    assert len(value_histogram(np.full((2, 2), np.nan))[0]) == 0
    assert 1 << 16 < value_histogram(np.zeros((3000, 2000), np.uint16))[1].sum() <= MOST, "quick for a large frame"
