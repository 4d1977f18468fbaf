from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.lattice._kernels import Support
from lfcal.lattice._micro_image import SAMPLES_PER_PIXEL, MicroImage, light_of, mean_micro_image, place_lenslets


def disc(radius: float) -> Support:
    return Support.along(np.array([1.0, 0.0]), radius, radius)


def blobs(centres: NDArray[np.float64], shape: tuple[int, int], sigma: float, skew: float = 0.0) -> NDArray[np.float32]:
    y, x = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for cx, cy in centres:
        image += np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * sigma**2)) * (1 + skew * np.tanh(x - cx))
    return image.astype(np.float32)


def grid(n: int, pitch: float) -> NDArray[np.float64]:
    k = 12.0 + pitch * np.arange(n)
    x, y = np.meshgrid(k, k)
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def test_the_mean_micro_image_is_that_of_one_blob_finely_sampled() -> None:
    points = grid(14, 14.37)
    image = blobs(points, (220, 220), 2.5)
    micro = mean_micro_image(image, points, np.ones(len(points)), 8.0)
    n = micro.table.shape[0]
    u = (np.arange(n) - n // 2) / SAMPLES_PER_PIXEL
    width = np.hypot(2.5, 0.35)  # the smoothing that fills empty samples
    want = (2.5 / width) ** 2 * np.exp(-(u[:, None] ** 2 + u[None, :] ** 2) / (2 * width**2))
    near = np.hypot(u[:, None], u[None, :]) < 7
    assert np.abs(micro.table - want)[near].max() < 0.02
    slope = -u[None, :] / width**2 * want
    assert np.abs(micro.slopes[0] - slope)[near].max() < 0.02
    assert np.abs(micro.slopes[1] - slope.T)[near].max() < 0.02


def test_each_shift_and_contrast_is_found() -> None:
    rng = np.random.default_rng(1)
    points = grid(12, 14.37)
    moved = points + rng.uniform(-0.4, 0.4, points.shape)
    image = 2 * blobs(moved, (190, 190), 2.5) + 7
    micro = mean_micro_image(image - 7, points, np.full(len(points), 1.0), 9.5).symmetric()
    placed = place_lenslets(image, points, micro, disc(8.0), workers=2)
    assert np.abs(placed.shifts - (moved - points)).max() < 0.05
    assert placed.gains == pytest.approx(1.0, abs=0.1)
    assert placed.explained.min() > 0.98
    swapped = np.abs(placed.shifts[:, ::-1] - (moved - points)).max()
    assert swapped > 0.4  # counter-test: x and y are not interchanged


def test_the_centre_of_symmetry_is_found() -> None:
    points = grid(14, 14.37)
    image = blobs(points + np.array([0.6, -0.8]), (220, 220), 2.5)
    found = np.zeros(2)
    for _ in range(3):  # the fit is linear in the shift
        micro = mean_micro_image(image, points + found, np.ones(len(points)), 8.0)
        found = found + micro.off_centre(disc(6.5))
    assert found == pytest.approx((0.6, -0.8), abs=0.04)


def test_nothing_to_place_gives_nan_and_left_out_lenslets_do_not_count() -> None:
    points = grid(6, 14.0)
    image = blobs(points, (110, 110), 2.5)
    scales = np.ones(len(points))
    scales[::2] = 0.0
    part = mean_micro_image(image, points, scales, 8.0)
    rest = mean_micro_image(image, points[1::2], np.ones(len(points) // 2), 8.0)
    assert np.array_equal(part.table, rest.table)
    micro = mean_micro_image(np.ones_like(image), points, scales, 8.0)
    assert np.isnan(place_lenslets(image, points, micro, disc(6.0)).shifts).all()


def test_light_counts_pixels_and_gradients() -> None:
    y, x = np.mgrid[:40, :50]
    image = (3.0 * x + y).astype(np.float32)
    centres = np.array([[20.0, 15.0], [0.0, 0.0]])
    count, total, energy = light_of(image, centres, 5.0).T
    inside = np.hypot(x - 20, y - 15) <= 5
    assert count[0] == inside.sum() and total[0] == pytest.approx(image[inside].sum())
    assert energy[0] == pytest.approx(10.0 * inside.sum())
    corner = (np.hypot(x, y) <= 5) & (x >= 1) & (y >= 1)
    assert count[1] == corner.sum()


@pytest.mark.parametrize("width", [2.0, 3.0])
def test_light_that_grows_across_a_bell_draws_it_by_its_variance(width: float) -> None:
    # exp(-x²/2s²) (1 + g x) is to first order the bell moved by g s²
    places = (np.arange(161) - 80) / SAMPLES_PER_PIXEL
    bell = np.exp(-(places[:, None] ** 2 + places**2) / (2 * width**2))
    down, right = np.gradient(bell, 1 / SAMPLES_PER_PIXEL)
    micro = MicroImage(bell, np.stack([right, down]), 20.0)
    assert micro.draw(disc(18.0)) == pytest.approx(width**2, rel=0.01)
