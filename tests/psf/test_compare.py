import json

import numpy as np
import pytest

from lfcal.cli._common import plain
from lfcal.errors import InputError
from lfcal.psf import PSFMatrix
from lfcal.psf.compare import compare, iter_compare

NT = 25


def spots(ny=4, nx=5, nz=2, shift=(0.0, 0.0), seed=0):
    """Return patterns of three Gaussian spots each, ``(nz, ny, nx, 25, 25)``."""
    rng = np.random.default_rng(seed)
    t, s = np.meshgrid(np.arange(NT), np.arange(NT), indexing="ij")
    H = np.zeros((nz, ny, nx, NT, NT))
    for z, y, x in np.ndindex(nz, ny, nx):
        for row, column in rng.uniform(8, 17, (3, 2)):
            H[z, y, x] += np.exp(-((t - row - shift[0]) ** 2 + (s - column - shift[1]) ** 2) / 3)
    return H


def test_a_matrix_equals_itself_in_any_unit():
    H = spots()
    found = compare(H * 7.5, H)
    assert found.correlation == pytest.approx(np.ones((2, 4, 5)))
    assert found.overall_error < 1e-6
    assert found.gain == pytest.approx([1 / 7.5] * 2)
    assert found.merit == "good"


def test_numbers_equal_those_by_hand():
    H, R = spots(seed=1), spots(seed=2)
    found = compare(H, R)
    a, b = H[1, 2, 3].astype(np.float32).astype(float), R[1, 2, 3].astype(np.float32).astype(float)
    gain = (H[1] * R[1]).sum() / (H[1] ** 2).sum()
    assert found.correlation[1, 2, 3] == pytest.approx((a * b).sum() / np.sqrt((a**2).sum() * (b**2).sum()), rel=1e-5)
    assert found.error[1, 2, 3] == pytest.approx(np.linalg.norm(gain * a - b) / np.linalg.norm(b), rel=1e-4)


def test_a_shift_is_told_with_its_direction():
    found = compare(spots(shift=(0.5, -0.25)), spots())
    assert found.shift[:, 0].mean() == pytest.approx(0.5, abs=0.01)
    assert found.shift[:, 1].mean() == pytest.approx(-0.25, abs=0.01)
    assert found.overall_shift == pytest.approx(0.559, abs=0.01)


def test_the_one_wrong_pattern_is_the_worst():
    H = spots()
    H[1, 3, 2] = spots(seed=9)[0, 0, 0]
    found = compare(H, spots())
    assert found.worst(1).tolist() == [[1, 3, 2]]
    assert found.error[1, 3, 2] > 0.5 and np.median(found.error) < 0.1


def test_noise_lowers_the_merit():
    H = spots()
    noisy = H + np.random.default_rng(0).normal(0, 0.05, H.shape)
    assert compare(noisy, H).merit == "bad"
    assert compare(H + np.random.default_rng(0).normal(0, 0.008, H.shape), H).merit in ("good", "fair")


def test_cutouts_of_different_size_are_compared_over_the_smaller():
    H = spots()
    found = compare(H, PSFMatrix(np.pad(H, [(0, 0)] * 3 + [(4, 4), (2, 2)])))
    assert found.overall_error < 1e-6


def test_dark_patterns_do_not_spoil_the_rest():
    H = spots()
    H[0, 0, 0] = 0
    found = compare(H, H)
    assert np.isnan(found.correlation[0, 0, 0]) and found.overall_error < 1e-6
    assert compare(H, spots()).error[0, 0, 0] == 1  # dark where there should be light
    assert json.dumps(plain(found.to_dict()), allow_nan=False)


def test_progress_and_mismatch():
    assert [p.done for p in iter_compare(spots(), spots())] == [0, 1, 2]
    with pytest.raises(InputError, match="same plan"):
        compare(spots(), spots(ny=3))
