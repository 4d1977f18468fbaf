"""Compiled passes over the planes of a volume, compared with numpy."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.reconstruct.solvers._update_kernels import squares_of, update_factors


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_passes_agree_with_numpy(kind: type) -> None:
    rng = np.random.default_rng(0)
    above, share, sensitivity = (rng.normal(0.5, 1, (30, 41)).astype(kind) for _ in range(3))
    share[3, 4], above[5, 6] = 0, np.nan
    seen = (sensitivity > 0.2) & (share > 0)
    wanted = np.divide(np.maximum(above, 0), share, out=np.ones_like(above), where=seen)
    out = np.empty_like(above)
    update_factors(above, share, sensitivity, 0.2, out)
    np.testing.assert_array_equal(out, wanted)
    size, change = squares_of(share, sensitivity)
    assert size == pytest.approx(np.square(share, dtype=np.float64).sum(), rel=1e-12)
    assert change == pytest.approx(np.square(share - sensitivity, dtype=np.float64).sum(), rel=1e-12)
