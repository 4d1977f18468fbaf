from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.lattice._smooth_field import determined_degree, fit_field


def surface(row: np.ndarray, column: np.ndarray) -> np.ndarray:
    return 100 + 0.1 * row - 2e-4 * row * column + 1e-6 * column**3 - 3e-9 * row**4


def test_a_polynomial_is_found_under_outliers_and_on_every_pixel() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(0, 1, (400, 2)) * (199, 299)
    values = surface(*points.T)
    values[::20] = 0.0
    field = fit_field(points, values, (200, 300))
    y, x = np.mgrid[:200, :300]
    assert field.at(y, x) == pytest.approx(surface(y, x), rel=1e-6)
    frame = field.frame()
    assert frame.dtype == np.float32 and frame.shape == (200, 300)
    assert np.abs(frame - surface(y, x)).max() < 1e-3


def test_too_few_points_are_refused() -> None:
    with pytest.raises(InputError, match="smooth field"):
        fit_field(np.zeros((2, 2)), np.zeros(2), (20, 20))
    assert fit_field(np.random.default_rng(0).uniform(0, 19, (10, 2)), np.full(10, 5.0), (20, 20), degree=1).at(
        3, 4
    ) == pytest.approx(5.0)


@pytest.mark.parametrize(("count", "degree"), [(3, 0), (8, 0), (9, 1), (17, 1), (18, 2), (30, 3), (44, 3), (45, 4)])
def test_three_points_determine_a_term(count: int, degree: int) -> None:
    assert determined_degree(count) == degree
    points = np.random.default_rng(1).uniform(0, 19, (count, 2))
    assert fit_field(points, np.full(count, 5.0), (20, 20)).powers.sum(1).max() == degree
