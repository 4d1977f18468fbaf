from __future__ import annotations

import numpy as np
import pytest

from lfcal.lattice.lattice_fit import best_places, gridded


def field(common: float, noise: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    q, r = (v.ravel() for v in np.meshgrid(np.arange(40), np.arange(30)))
    index = np.stack([q, r], axis=-1)
    lattice = 15.0 * index[:, ::-1]
    smooth = common * np.stack([np.sin(q / 6), np.cos(r / 5)], axis=-1)
    truth = lattice + smooth
    measured = truth + np.random.default_rng(seed).normal(0, noise, truth.shape)
    measured[::17] = np.nan
    return index, lattice, truth, measured


def test_what_neighbours_have_in_common_is_kept() -> None:
    index, lattice, truth, measured = field(0.3, 0.1)
    best = best_places(index, lattice, measured)
    assert np.isfinite(best).all()
    before, after = (np.sqrt(((p - truth) ** 2).mean()) for p in (lattice, best))
    assert after < 0.3 * before
    dead = ~np.isfinite(measured[:, 0])
    assert np.sqrt(((best - truth)[dead] ** 2).mean()) < 0.1


def test_scatter_alone_leaves_the_lattice() -> None:
    index, lattice, _, measured = field(0.0, 0.1)
    assert np.sqrt(((best_places(index, lattice, measured) - lattice) ** 2).mean()) < 0.01


def test_one_wild_lenslet_does_not_drag_its_neighbours() -> None:
    index, lattice, truth, measured = field(0.3, 0.05)
    measured[600] += 5.0
    best = best_places(index, lattice, measured)
    assert np.abs(best - truth).max() < 0.25


def test_few_lenslets_stay_on_the_lattice() -> None:
    index, lattice, _, measured = field(0.3, 0.1)
    assert np.array_equal(best_places(index[:50], lattice[:50], measured[:50]), lattice[:50])


def test_means_are_taken_cell_by_cell() -> None:
    places = np.array([[1.0, 1.0], [2.0, 2.0], [1.0, 19.0], [np.nan, 3.0]])
    values = np.array([[1.0, 10.0], [3.0, 20.0], [5.0, 30.0], [7.0, 40.0]])
    means = gridded(places, values, (10, 20), 2)
    assert means.shape == (2, 1, 2)
    assert means[:, 0, 0] == pytest.approx((2.0, 15.0)) and means[:, 0, 1] == pytest.approx((5.0, 30.0))
    assert np.isnan(gridded(places, values, (100, 20), 10)[:, 5, 0]).all()
