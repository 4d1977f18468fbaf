"""Patterns in whole steps: their bound held against the dense matrix, and the cases that are hard to store."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.base.h5.chunks import encode_chunk
from lfcal.psf._steps import SteppedPlane, bits_at_most, bound_after, stepped_plane
from tests.reconstruct.oracles import dense, lenslet_psf

Plane = NDArray[np.float64]


def spots(seed: int = 0, cutout: int = 15) -> Plane:
    """Return a plane ``(5, 5, cutout, cutout)`` of spots with weak light between them."""
    plane: Plane = lenslet_psf(1, 5, cutout)[0]
    return plane + 1e-3 * np.random.default_rng(seed).random(plane.shape)


def signed(seed: int = 0) -> Plane:
    """Return spots with noise about zero."""
    return spots(seed) - 2e-3 + 1e-3 * np.random.default_rng(seed + 1).normal(size=(5, 5, 15, 15))


def shares(plane: Plane, found: SteppedPlane) -> Plane:
    """Return what each pattern lacks of itself, by itself."""
    lacking = np.abs(plane - found.values.astype(float)).sum(axis=(2, 3))
    own = np.abs(plane).sum(axis=(2, 3))
    return np.divide(lacking, own, out=np.zeros_like(own), where=own > 0)


@pytest.mark.parametrize("tolerance", [0.1, 0.005, 0.0005])
@pytest.mark.parametrize("make", [spots, signed])
def test_the_bound_holds_against_the_dense_matrix(make: Callable[[int], Plane], tolerance: float) -> None:
    """|(H - Hs) g|_1 for random g and for single voxels, whose worst is near it: it is not vacuous."""
    plane = make(3)
    found = stepped_plane(plane, tolerance)
    bound, size = found.bound[2], (23, 21)
    assert 0 < bound <= tolerance
    H, Hs = (dense(values[None].astype(float), size) for values in (plane, found.values))
    light = np.abs(plane).sum(axis=(2, 3))[np.indices(size)[0] % 5, np.indices(size)[1] % 5].ravel()
    rng = np.random.default_rng(1)
    for g in (rng.random(light.size), rng.random(light.size) ** 20, rng.integers(0, 2, light.size)):
        assert np.abs((H - Hs) @ g).sum() <= bound * (g @ light)
    each = np.abs(H - Hs).sum(axis=0) / light
    assert each.max() <= bound * (1 + 1e-9) and each.max() > 0.9 * bound
    assert each.max() > 0.5 * tolerance, "all of the tolerance is used"


@pytest.mark.parametrize("make", [spots, signed])
def test_shares_are_those_of_the_values_read_back(make: Callable[[int], Plane]) -> None:
    plane = make(0)
    found = stepped_plane(plane, 0.004)
    np.testing.assert_allclose(found.cut + found.rounding, shares(plane, found), rtol=1e-9)
    whole = np.abs(plane - found.values.astype(float)).sum() / np.abs(plane).sum()
    assert found.error == pytest.approx(whole) and found.error <= found.bound[2] <= 0.004


def test_rows_and_columns_without_light_are_cut_and_their_light_is_counted() -> None:
    plane = spots()
    wide = np.zeros((5, 5, 41, 35))
    wide[:, :, 10:25, 12:27] = plane
    wide += 1e-9 * np.random.default_rng(0).random(wide.shape)
    found = stepped_plane(wide, 0.005)
    assert found.bound[0] > 0
    np.testing.assert_allclose(found.cut + found.rounding, shares(wide, found), rtol=1e-9)
    lit = (found.values != 0).any(axis=(0, 1))
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (10, 24, 12, 26)


def test_dead_dim_and_single_pixel_patterns() -> None:
    plane = spots()
    plane[0, 0] = 0
    plane[1, 1] *= 1e-7
    plane[2, 2] = 0
    plane[2, 2, 3, 4] = 5.0
    plane[3, 3] = -plane[3, 3]
    plane[4, 4] = 0.25
    found = stepped_plane(plane, 0.005)
    values = found.values
    assert not values[0, 0].any() and (values[3, 3] <= 0).all()
    assert np.count_nonzero(values[2, 2]) == 1 and values[2, 2, 3, 4] == pytest.approx(5.0, rel=0.005)
    assert shares(plane, found).max() <= 0.005
    assert not stepped_plane(np.zeros((2, 2, 3, 3)), 0.005).values.any()


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1.0, 1e11, 1e30])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_any_scale(scale: float, dtype: type[np.floating[object]]) -> None:
    """A 16-bit float would end at 65504 and lose what is below 6e-8."""
    plane = (signed() * scale).astype(dtype)
    found = stepped_plane(plane, 0.005)
    assert 0.0025 < shares(plane.astype(float), found).max() <= 0.005


def test_light_is_kept_within_the_tolerance() -> None:
    plane = spots()
    before, after = plane.sum(axis=(2, 3)), stepped_plane(plane, 0.005).values.sum(axis=(2, 3), dtype=float)
    assert np.abs(after / before - 1).max() <= 0.005


def test_integers_are_stored_as_well() -> None:
    plane = np.random.default_rng(0).integers(0, 60000, (3, 4, 5, 7)).astype(np.uint16)
    assert 0 < shares(plane.astype(float), stepped_plane(plane, 0.002)).max() <= 0.002


def test_whole_numbers_that_the_finest_step_keeps_exactly() -> None:
    """An error of 0 tells nothing of how errors grow with the step."""
    plane = np.zeros((1, 1, 3, 3))
    plane[0, 0, :, 0] = 65534, 1000, 7  # a step of 1 is the finest of all
    for tolerance in (1e-6, 1e-5, 1e-3):
        assert shares(plane, stepped_plane(plane, tolerance)).max() <= tolerance


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(value: float) -> None:
    plane = spots()
    plane[2, 3, 1, 1] = value
    with pytest.raises(InputError, match=r"plane 7, position \(2, 3\): expected finite values, got NaN or infinity"):
        stepped_plane(plane, 0.005, what="plane 7")


@pytest.mark.parametrize("tolerance", [0.0, -0.1, 1.0, np.nan, np.inf])
def test_a_tolerance_is_a_share(tolerance: float) -> None:
    with pytest.raises(InputError, match="a fraction above 0 and below 1"):
        stepped_plane(spots(), tolerance)


def test_where_steps_are_too_few_the_position_is_named() -> None:
    with pytest.raises(InputError, match=r"position \(0, 0\).*65535 steps.*1e-06 %; choose a larger tolerance"):
        stepped_plane(spots(), 1e-8)
    with pytest.raises(InputError, match="65535 steps per pattern"):
        stepped_plane(spots() * 1e-200, 0.005)  # nothing that float32 holds


def test_the_same_bytes_by_any_number_of_threads() -> None:
    one, four = (stepped_plane(signed(), 0.005, workers=workers) for workers in (1, 4))
    for name in ("values", "step", "cut", "rounding"):
        np.testing.assert_array_equal(getattr(one, name), getattr(four, name))


def test_errors_add_up() -> None:
    plane = signed()
    first = stepped_plane(plane, 0.01)
    second = stepped_plane(first.values, 0.02)
    both = bound_after(first.bound, second.bound)
    lacking = np.abs(plane - second.values).sum(axis=(2, 3)) / np.abs(plane).sum(axis=(2, 3))
    assert lacking.max() <= both[2] <= 0.01 + 0.02 * 1.01 and lacking.max() > both[2] / 3
    np.testing.assert_array_equal(bound_after(np.full(3, np.nan), second.bound), second.bound)
    np.testing.assert_array_equal(bound_after(None, second.bound), second.bound)


@pytest.mark.parametrize("tolerance", [0.05, 0.005, 0.001])
@pytest.mark.parametrize("kind", ["laplace", "normal", "uniform", "exponential"])
def test_what_it_takes_is_foretold(kind: str, tolerance: float) -> None:
    """The room asked for suffices, even where H is nothing but noise."""
    rng = np.random.default_rng(0)
    plane = getattr(rng, kind)(size=(2, 2, 61, 61))
    found = stepped_plane(plane, tolerance)
    nbytes = sum(len(encode_chunk(pattern, 1)) for row in found.values for pattern in row)
    assert 8 * nbytes / plane.size < bits_at_most(tolerance) < 2.5 * 8 * nbytes / plane.size
