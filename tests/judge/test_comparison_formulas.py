"""Comparison of two H: closed forms for scale, shift and error."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.base.progress import Progress
from lfcal.judge.comparison import compare, iter_compare
from lfcal.psf import PSFMatrix


def spots(
    shape: tuple[int, ...] = (2, 3, 4, 21, 23), at: tuple[float, float] = (0.0, 0.0), seed: int = 1
) -> NDArray[np.float64]:
    """Gaussian spots, each a little elsewhere and of another brightness; their centres moved by ``at``."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[: shape[3], : shape[4]]
    out = np.empty(shape)
    for place in np.ndindex(shape[:3]):
        row, column = 10 + rng.uniform(-1, 1), 11 + rng.uniform(-1, 1)
        spot = np.exp(-((rows - row - at[0]) ** 2 + (columns - column - at[1]) ** 2) / 8)
        out[place] = rng.uniform(1, 2) * spot
    return out


def test_equal_up_to_a_unit() -> None:
    H = spots()
    found = compare(7.5 * H, H)
    assert found.correlation == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose([one.all.correlation for one in found.planes], 1, atol=1e-12)
    np.testing.assert_allclose([one.all.scale for one in found.planes], 7.5)
    assert found.max_shift_px < 1e-6 and found.rms_error < 1e-6
    assert found.error.shape == H.shape[:3] and found.shift_px.shape == (*H.shape[:3], 2)


def test_correlation_and_error_are_the_plain_formulae() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.random((2, 2, 3, 5, 7)), rng.random((2, 2, 3, 5, 7))
    found = compare(a, b, workers=2)
    assert found.correlation == pytest.approx((a * b).sum() / np.sqrt((a * a).sum() * (b * b).sum()))
    for z in range(2):
        want = (a[z] * b[z]).sum() / np.sqrt((a[z] ** 2).sum() * (b[z] ** 2).sum())
        assert found.planes[z].all.correlation == pytest.approx(want)
        assert found.planes[z].all.scale == pytest.approx((a[z] * b[z]).sum() / (b[z] ** 2).sum())
    for place in np.ndindex(2, 2, 3):
        scaled = a[place] / a[place].sum() * b[place].sum()
        want = np.sqrt(((scaled - b[place]) ** 2).sum() / (b[place] ** 2).sum())
        assert found.error[place] == pytest.approx(want, rel=1e-5)


def test_shift_has_size_axis_and_sign() -> None:
    found = compare(spots(at=(0.4, -0.7)), spots())
    np.testing.assert_allclose(found.shift_px[..., 0], 0.4, atol=0.02)
    np.testing.assert_allclose(found.shift_px[..., 1], -0.7, atol=0.02)
    assert found.max_shift_px == pytest.approx(np.hypot(0.4, 0.7), abs=0.03)
    assert found.rms_shift_px <= found.max_shift_px


def test_swapped_axes_of_positions_do_not_agree() -> None:
    H = spots((1, 4, 4, 21, 23))
    assert compare(H.swapaxes(1, 2), H).max_shift_px > 0.5


def test_noise_far_out_does_not_move_centroids() -> None:
    H = spots()
    noisy = H + np.random.default_rng(5).normal(0, 0.005, H.shape)
    assert compare(noisy, H).max_shift_px < 0.05


def test_missing_dark_and_spoilt_positions_are_left_out() -> None:
    H, spoilt = spots(), spots()
    recorded = np.ones(H.shape[:3], int)
    recorded[0, 1, 2] = 0
    spoilt[0, 1, 2] = np.random.default_rng(0).random(H.shape[3:])
    spoilt[1, 0, 0] = 0
    spoilt[1, 2, 3, 4, 4] = np.nan
    found = compare(PSFMatrix(spoilt, recorded=recorded), H)
    assert np.argwhere(np.isnan(found.error)).tolist() == [[0, 1, 2], [1, 0, 0], [1, 2, 3]]
    assert found.compared == 21 and found.correlation == pytest.approx(1) and found.max_shift_px < 1e-6


def test_nothing_to_compare_is_no_number() -> None:
    found = compare(np.zeros((1, 2, 2, 5, 5)), spots((1, 2, 2, 5, 5)))
    assert np.isnan([found.correlation, found.max_shift_px, found.rms_shift_px, found.rms_error]).all()
    assert found.compared == 0


def test_progress_runs_over_rows() -> None:
    records = list(iter_compare(spots(), spots(), workers=1))
    assert [r.done for r in records] == list(range(7)) and all(isinstance(r, Progress) for r in records)


@pytest.mark.parametrize(
    ("other", "words"),
    [(spots((2, 3, 5, 21, 23)), "period"), (spots().astype(complex), "expected real numbers")],
)
def test_what_cannot_be_compared(other: NDArray[np.generic], words: str) -> None:
    with pytest.raises(InputError, match=words) as error:
        compare(spots(), other)
    assert "\n" not in str(error.value)


def test_by_their_numbers_shapes_must_be_equal() -> None:
    assert compare(spots(), spots((2, 3, 4, 21, 21))).pair.cutout == (21, 21)
    with pytest.raises(InputError, match="expected shape"):
        compare(spots(), spots((2, 3, 4, 21, 21)), by_index=True)
