"""The first guess of a lattice from its spectrum, and the mean micro-image that places each lenslet."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.lattice._kernels import Support
from lfcal.lattice._lit_part import blurred
from lfcal.lattice._micro_image import SAMPLES_PER_PIXEL, MicroImage, light_of, mean_micro_image, place_lenslets
from lfcal.lattice._spectrum import guess_lattice, upright
from lfcal.lattice.fit import fit_lattice
from tests.lattice.white_frames import WhiteFrame, draw_pupils, draw_white


def test_upright_undoes_any_choice_of_basis() -> None:
    # other bases of the same lattice with vectors of the shortest length
    square = [((0, 1), (-1, 0)), ((-1, 0), (0, -1)), ((1, 0), (0, 1)), ((0, -1), (1, 0))]
    hexagonal = [*square, ((0, 1), (-1, 1)), ((1, -1), (1, 0)), ((-1, 1), (-1, 0))]
    for kind, between, turns in (("square", 90, square), ("hexagonal", 60, hexagonal)):
        for degrees in (-1.0, 0.2, 12.0, 90.0):
            # a square lattice looks the same after a quarter turn; the smaller angle is taken
            angle = 0.0 if kind == "square" and degrees == 90.0 else math.radians(degrees)
            second = angle + math.radians(between)
            basis = 9.0 * np.array([[math.cos(angle), math.sin(angle)], [math.cos(second), math.sin(second)]])
            for choice in turns:
                assert upright(np.array(choice) @ basis, kind) == pytest.approx(basis), (kind, degrees, choice)


def test_neither_a_finer_nor_a_coarser_lattice_is_taken() -> None:
    """Touching discs have weak first-order peaks; three types add peaks of a coarser lattice."""
    for kind, edges in (("hexagonal", (0.6, 1.4, 2.2)), ("square", (0.4,))):
        truth = draw_white(kind=kind, fill=1.0, edges=edges, pitch=18.0)
        rough = guess_lattice(truth.frame.astype(np.float32), None, None)
        assert rough.kind == kind and np.allclose(rough.basis, truth.basis, atol=0.05)
        assert truth.distance_to_lattice((rough.centre[1], rough.centre[0])) < 0.1 * 18.0


@pytest.mark.few(4)
@pytest.mark.parametrize("shape", [(140, 140), (160, 170)])
@pytest.mark.parametrize("pupil", [0.75, 0.9, 0.95])
@pytest.mark.parametrize("snr", [20.0, 1e6])
def test_overlapping_micro_images_are_centred(shape: tuple[int, int], pupil: float, snr: float) -> None:
    """Overlaps brighten the rims: the points of the lattice are the centres of symmetry of the mean micro-image."""
    frame, origin, basis = draw_pupils((0.5, 0.33, 0.2), pitch=11.0, pupil=pupil, shape=shape, snr=snr)
    rough = guess_lattice(frame, "hexagonal", None)
    assert np.allclose(rough.basis, basis, atol=0.1)
    steps = (rough.centre - np.array(origin)[::-1]) @ np.linalg.inv(basis)
    assert np.hypot(*((steps - np.rint(steps)) @ basis)) < 0.05 * 11.0


def test_only_the_middle_of_a_large_frame_is_used() -> None:
    truth = draw_white((1700, 60), kind="square", pitch=10.0, rotation=0.0)
    rough = guess_lattice(truth.frame.astype(np.float32), None, None)
    assert truth.distance_to_lattice((rough.centre[1], rough.centre[0])) < 1.0


def test_a_wide_blur_keeps_planes_and_removes_ripple() -> None:
    y, x = np.mgrid[:200, :300].astype(np.float32)
    plane = (3 * x + y).astype(np.float32)
    inner = (slice(70, 130), slice(80, 220))
    ripple = (50 * np.sin(x)).astype(np.float32)
    assert np.abs(blurred(plane + ripple, 20.0) - plane)[inner].max() < 2.0


def test_the_bright_symmetric_place_of_a_square_cell_is_chosen() -> None:
    """Lenslets, not the gaps between four of them, wherever the middle of the frame lies."""
    for offset in ((0.0, 0.0), (7.5, 7.5), (3.0, -4.0)):
        truth = draw_white(kind="square", pitch=15.0, offset=offset)
        rough = guess_lattice(truth.frame.astype(np.float32), "square", None)
        assert truth.distance_to_lattice((rough.centre[1], rough.centre[0])) < 1.5


UNEQUAL = {
    "checkered": lambda q, r: (q + r) % 2 == 0,
    "alternate rows": lambda q, r: r % 2 == 0,
    "alternate columns": lambda q, r: q % 2 == 0,
    "all but one of four": lambda q, r: (q % 2 == 1) | (r % 2 == 1),
    "one of four": lambda q, r: (q % 2 == 0) & (r % 2 == 0),
    "one type of three": lambda q, r: (q - r) % 3 == 0,
    "two types of three": lambda q, r: (q - r) % 3 != 0,
}
"""Lenslets of full brightness; the others are dimmer."""


def unequal(share: Callable[[Any, Any], Any], kind: str = "square", **more: float) -> WhiteFrame:
    return draw_white((300, 340), pitch=16.4, kind=kind, fill=0.85, dead=0.0, dark=0.0, share=share, **more)


@pytest.mark.few(1)
@pytest.mark.parametrize("dim", [0.3, 0.5, 0.6, 0.7, 0.85])
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("bright", UNEQUAL)
def test_lenslets_of_unequal_brightness_are_all_found(bright: str, kind: str, dim: float) -> None:
    """Coatings, polarisers and types repeat over a coarser lattice, whose peaks are as strong as the array's own."""
    if kind == "square" and "three" in bright:
        pytest.skip("three types are of hexagonal arrays")
    truth = unequal(lambda q, r: np.where(UNEQUAL[bright](q, r), 1.0, dim), kind, rotation=0.01)
    fit = fit_lattice(truth.frame)
    assert fit.kind == kind and fit.pitch_px == pytest.approx(16.4, abs=0.02)
    assert np.hypot(*truth.errors(fit.centres_px(*fit.index.T)).T).max() < 0.15
    assert fit.dead.mean() < 0.01, "a dim class is not dead"
    assert len(fit.index) > 0.75 * 300 * 340 / (truth.pitch * truth.row_pitch), "none is left out"


def test_a_mosaic_of_four_polarisers_is_found() -> None:
    share = np.array([[1.0, 0.85], [0.7, 0.55]])
    fit = fit_lattice(unequal(lambda q, r: share[q % 2, r % 2]).frame)
    assert fit.pitch_px == pytest.approx(16.4, abs=0.02) and not fit.dead.any()


@pytest.mark.few(3)
@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("fill", [0.15, 0.3, 0.6, 0.95])
def test_gaps_are_no_lenslets(kind: str, fill: float) -> None:
    """A stopped-down main lens leaves small spots: the places of a finer lattice between them are dark."""
    truth = draw_white((300, 340), pitch=24.8, kind=kind, rotation=0.009, fill=fill, dead=0.0, dark=0.0)
    fit = fit_lattice(truth.frame)
    assert fit.kind == kind and fit.pitch_px == pytest.approx(24.8, abs=0.02)


def test_a_stated_pitch_decides_between_a_lattice_and_its_sublattice() -> None:
    """If half of the lenslets are nearly dark, the image alone cannot decide."""
    frame = unequal(lambda q, r: np.where((q + r) % 2 == 0, 1.0, 0.12)).frame.astype(np.float32)
    assert np.linalg.norm(guess_lattice(frame, None, 16.4).basis[0]) == pytest.approx(16.4, abs=0.1)
    assert np.linalg.norm(guess_lattice(frame, None, 16.4 * math.sqrt(2)).basis[0]) == pytest.approx(23.19, abs=0.1)
    with pytest.raises(InputError, match=r"a pitch within 10 % of 19 px"):
        guess_lattice(frame, None, 19.0)


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


def test_blank_micro_images_have_no_place_and_excluded_lenslets_do_not_count() -> None:
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


def test_light_that_grows_across_a_bell_moves_it_by_its_variance() -> None:
    # exp(-x²/2s²) (1 + g x) is to first order the bell moved by g s²
    places = (np.arange(161) - 80) / SAMPLES_PER_PIXEL
    for width in (2.0, 3.0):
        bell = np.exp(-(places[:, None] ** 2 + places**2) / (2 * width**2))
        down, right = np.gradient(bell, 1 / SAMPLES_PER_PIXEL)
        micro = MicroImage(bell, np.stack([right, down]), 20.0)
        assert micro.draw(disc(18.0)) == pytest.approx(width**2, rel=0.01)
