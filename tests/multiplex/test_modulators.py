"""Modulators as separable bases: what each pixel measures, and what cannot be recovered."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.multiplex import (
    CFA_PATTERNS,
    cfa,
    mask,
    mask_at_distance,
    mask_pattern,
    modulator_from_matrix,
    shadow_shift_px,
)
from lfcal.multiplex.masks import dirichlet_minimum
from lfcal.multiplex.summary import describe

CODES = "100 010 001 011 101 110 111 011".split()
FILTERS = {letter: tuple(map(int, code)) for letter, code in zip("RGBCMYWE", CODES, strict=True)}


def test_each_pixel_of_a_cfa_sees_its_filter() -> None:
    for name, rows in (
        ("Bayer", "RGGB"),
        ("CYMG", "CYMG"),
        ("cyym", "CYYM"),
        ("Sony", "RGEB"),
        ("RGBE", "RGBE"),
        ("RGBW 2x2", "RGBW"),
        ("CMYW", "CMYW"),
        ("RGBW 4x4", "WBWGBWGWWGWRGWRW"),
        ("x-trans", "GBGGRGRGRBGBGBGGRGGRGGBGBGBRGRGRGGBG"),
        ("grbg", "GRBG"),
        ("RGB/GBR", "RGBGBR"),
    ):
        m = cfa(name)
        np.testing.assert_array_equal(m.matrix, [FILTERS[letter] for letter in rows])
        np.testing.assert_allclose(m.matrix, m.spatial @ m.plenoptic.T)
        assert set(np.unique(m.spatial)) == {0, 1} and m.natural_samples == m.side
    for name in CFA_PATTERNS:  # a name of letters has the layout that it reads
        assert name == CFA_PATTERNS[name].replace("/", "") or not set(name) <= set(FILTERS)


def test_mask_at_one_pixel_per_view_is_the_shifted_pattern() -> None:
    for kind, p in itertools.product(("MURA", "sum_of_sinusoids"), (3, 5, 11)):
        pattern, m = mask_pattern(kind, p), mask(kind, p)
        y, x = np.divmod(np.arange(p * p), p)
        shifted = pattern[(y[:, None] - y[None]) % p, (x[:, None] - x[None]) % p]
        np.testing.assert_allclose(m.matrix, shifted, atol=1e-12)
        # Pi^T is the Fourier basis and Sigma the weighted inverse one
        dft = np.fft.fft(np.eye(p))
        np.testing.assert_allclose(m.plenoptic.T, np.kron(dft, dft), atol=1e-9)
        np.testing.assert_allclose(m.spectrum(), np.diag(np.fft.fft2(pattern).ravel()), atol=1e-9)
        np.testing.assert_allclose(m.pattern()[p // 2, p // 2, 0], pattern[0, 0], atol=1e-12)


def shadows(n: int, shift: float, width: float, parts: int) -> np.ndarray:
    """Return which share ``(pixel, view, cell)`` of a pixel each cell of a mask covers, by counting points."""
    points = (np.arange(parts) + 0.5) / parts - 0.5
    grid = np.arange(n, dtype=float)
    ray = grid[:, None, None, None] + points - shift * (grid[:, None, None] + width * points[:, None])
    cells = np.floor(ray + 0.5).astype(int) % n
    return (cells[..., None] == np.arange(n)).mean((2, 3))


@pytest.mark.parametrize("width", [*(pytest.param(w, marks=pytest.mark.long) for w in (0.0, 0.4)), 1.0])
def test_mask_at_a_distance_by_counting_rays(width: float) -> None:
    """Equation 9 over the areas of pixels and views; a transmission is a share, and no light is lost or made."""
    pattern = (np.random.default_rng(3).random((5, 4)) < 0.5) * 1.0
    for shift in (0.0, 0.37, 0.5, 1.0, 1.6, -0.7, 3.25):
        found = mask_at_distance(pattern, shift, view_width=width).matrix
        down, across = (shadows(n, shift, width, 200) for n in pattern.shape)
        wanted = np.einsum("yvk,xul,kl->yxvu", down, across, pattern).reshape(found.shape)
        np.testing.assert_allclose(found, wanted, atol=2e-2)  # each of the points counts for 1/200
        assert np.sqrt(np.mean((found - wanted) ** 2)) < 5e-3, shift
        assert found.min() > -1e-12 and found.max() < 1 + 1e-12
        np.testing.assert_allclose(found.sum(0), pattern.sum(), rtol=1e-6)
    far = mask_at_distance(pattern, 1234.5, view_width=width).matrix
    assert far.min() > -1e-9 and far.max() < 1 + 1e-9
    np.testing.assert_allclose(far.sum(0), pattern.sum(), rtol=1e-6)


def test_a_shadow_moved_by_whole_pixels_is_the_pattern() -> None:
    pattern = np.random.default_rng(4).random((5, 3))
    moved = mask_at_distance(pattern, 2.0).matrix.reshape(5, 3, 5, 3)
    np.testing.assert_allclose(moved[:, :, 2, 1], np.roll(pattern, (4, 2), (0, 1)), atol=1e-12)
    # views that touch blur what a wide step moves
    assert np.ptp(mask_at_distance(pattern, 2.0, view_width=1.0).matrix) < np.ptp(moved)
    assert shadow_shift_px(1000.0, 0.01, 5.0) == pytest.approx(2.0)


def test_a_mask_on_the_sensor_does_not_separate_the_views() -> None:
    flat = mask_at_distance(mask_pattern("MURA", 5), 0.0)
    assert flat.rank() == 1 and flat.condition == math.inf
    assert (flat.lost() > 0.9).all()
    # what is recovered is the mean
    light = np.random.default_rng(0).random(25)
    np.testing.assert_allclose(flat.inverse() @ flat.matrix @ light, light.mean(), atol=1e-12)


def test_lenslet_is_n_times_the_pinhole() -> None:
    np.testing.assert_array_equal(mask("pinhole", 4).matrix, np.eye(16))
    np.testing.assert_array_equal(mask("lenslet", 4).matrix, 16 * np.eye(16))


def test_sinusoids_are_scaled_on_the_continuous_profile() -> None:
    p = 11
    x = np.linspace(0, p, 200_001)[1:-1]
    profile = np.sin(np.pi * x) / np.sin(np.pi * x / p)
    assert dirichlet_minimum(p) == pytest.approx(profile.min(), abs=1e-6)
    pattern = mask_pattern("sum_of_sinusoids", p)
    low = p * profile.min()
    assert pattern[0, 0] == pytest.approx(1) and pattern[3, 4] == pytest.approx(-low / (p * p - low), abs=1e-7)


def test_bayer_behind_lenslets() -> None:
    for size in (3, 4, 6):
        product = mask("lenslet", size) * cfa("GRBG")
        side = math.lcm(size, 2)
        assert product.side == (side, side) and product.count == 3 * size * size
        lens, colours = mask("lenslet", size).matrix, cfa("GRBG").matrix
        for k in range(side * side):
            y, x = divmod(k, side)
            row = np.kron(lens[(y % size) * size + x % size], colours[(y % 2) * 2 + x % 2])
            np.testing.assert_array_equal(product.matrix[k], row)
        # an even lenslet has each view always behind the same filter: one colour of three
        assert product.rank() == (product.count if size % 2 else size * size)
        assert (product.lost() > 0.5).any() == (size % 2 == 0)
        assert product.sample_names[4] == "view 0,1 G"


def test_missing_primary_is_reported() -> None:
    numbers = describe(cfa("RRGG"), cfa("Bayer"), 1.0)
    assert numbers.rank == 2 and numbers.lost == {"B": pytest.approx(1.0)}
    assert numbers.gain_db == -math.inf and numbers.condition == math.inf
    np.testing.assert_array_equal(cfa("RRGG").inverse()[2], 0)


def test_shifting_moves_the_pattern() -> None:
    moved = cfa("RGGB").shifted(0, 1)
    np.testing.assert_array_equal(moved.matrix, cfa("GRBG").matrix)
    with pytest.raises(InputError, match="whole lenslets"):
        mask("lenslet", 5).shifted(1, 0)


def test_wrong_modulators_are_refused_in_one_line() -> None:
    for make in (
        lambda: cfa("RGX"),
        lambda: cfa("RGB"),
        lambda: cfa("RG/B"),
        lambda: cfa(""),
        lambda: cfa("R" * 17 + "/" + "G" * 17),
        lambda: cfa("RGGB", filters={"R": (2, 0, 0)}),
        lambda: mask("MURA", 9),
        lambda: mask("MURA", 2),
        lambda: mask("sum_of_sinusoids", 4),
        lambda: mask("grid", 5),
        lambda: mask("pinhole", 0),
        lambda: mask("pinhole", 101),
        lambda: mask_at_distance([[2.0]], 1),
        lambda: mask_at_distance([[np.nan]], 1),
        lambda: mask_at_distance([[1.0]], np.nan),
        lambda: mask_at_distance([[1.0]], 1e6),
        lambda: mask_at_distance([[1.0]], 1, view_width=1.5),
        lambda: cfa("Bayer") * cfa("Bayer"),
        lambda: mask("MURA", 5) * mask("MURA", 3),
        lambda: modulator_from_matrix("odd", (2, 2), np.ones((3, 3))),
    ):
        with pytest.raises(InputError, match=r"^[^\n]*expected[^\n]*$"):
            make()


def test_decomposition_is_that_of_the_matrix() -> None:
    """Orthogonal bases are used as they are: same values, rank and pseudo-inverse as by numpy."""
    for m in (
        cfa("Bayer"),
        cfa("CYMG"),
        mask("MURA", 5),
        mask("lenslet", 4),
        mask("lenslet", 3) * cfa("X-Trans"),
        mask_at_distance(np.zeros((3, 3)), 1.0),
        mask_at_distance(np.eye(4), 1.0),
        mask_at_distance(np.eye(3), 0.4),
        mask_at_distance(np.eye(4), 0.7, view_width=1.0),
    ):
        values = np.linalg.svd(m.matrix, compute_uv=False)
        found = np.zeros_like(values)
        found[: len(m.singular_values)] = m.singular_values[: len(values)]
        np.testing.assert_allclose(found, values, atol=1e-12 * max(1, values[0]), err_msg=m.name)
        assert m.rank() == np.linalg.matrix_rank(m.matrix)
        inverse = np.linalg.pinv(m.matrix, rcond=1e-13)
        np.testing.assert_allclose(m.inverse(), inverse, atol=1e-10 * max(1, np.abs(inverse).max()))
        np.testing.assert_allclose(m.lost(), 1 - np.diag(inverse @ m.matrix), atol=1e-10)
