"""The search for filter sets and masks: gradients, known optima, frontiers."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime, minimize

from lfcal.base.errors import InputError
from lfcal.multiplex import (
    Frontier,
    best_binary_mask,
    best_filter_set,
    best_mask,
    cfa,
    filter_set_frontier,
    mask,
    mask_at_distance,
    mask_gain_bound,
    monte_carlo_gain,
    snr_gain,
)
from lfcal.multiplex.search import _filters_cost, _mask_cost, iter_mask_frontier, mask_frontier

RATIOS = np.logspace(-2, 2, 81)


def test_gradients_of_costs_are_numerical_ones() -> None:
    for (cost, shape), chi2 in itertools.product(((_filters_cost, (5, 3)), (_mask_cost, (5, 5))), (0.0, 2.0, math.inf)):
        x = np.random.default_rng(1).uniform(0.2, 1, shape)
        numeric = approx_fprime(x.ravel(), lambda v: cost(v.reshape(shape), chi2)[0], 1e-7)  # noqa: B023
        np.testing.assert_allclose(cost(x, chi2)[1].ravel(), numeric, rtol=1e-4, atol=1e-4)


def test_ideal_filter_sets_by_trying_all() -> None:
    low, high = filter_set_frontier(0.0), filter_set_frontier(1e6)
    assert low.best.name == "CYMG" or snr_gain(low.best, cfa("CYMG"), 0.0) == pytest.approx(0, abs=1e-9)
    assert snr_gain(high.best, cfa("Bayer"), 1e6) == pytest.approx(0, abs=1e-6)
    best = np.flatnonzero(low.efficient)
    for k in best:
        assert not ((low.additive > low.additive[k] + 1e-6) & (low.photon > low.photon[k] + 1e-6)).any()
    assert 0 < len(best) < len(low.modulators)
    names = {m.name for m in low.modulators}
    assert {"Bayer", "CYMG", "CYYM", "CMYW", "RGBW"} <= names


def test_rounding_does_not_choose_the_best() -> None:
    """Gains that are equal but for the last bits: the first one is the best, and what is beaten is not efficient."""
    arrays, gains = tuple(map(cfa, ("CYMG", "RG/GB", "GB/RG"))), np.array([0.2, 1.0, 1 + 3e-16])
    found = Frontier(arrays, "Bayer", gains, gains, gains, 0.0, np.ones(3, bool))
    assert gains[2] > gains[1] and found.best_index == 1 and found.best is arrays[1]
    every = filter_set_frontier(1.0)
    both = np.stack([every.additive, every.photon]).round(7)
    over = both[:, None, :] - both[:, :, None]
    assert np.array_equal(every.efficient, ~((over >= 0).all(0) & (over > 0).any(0)).any(1))


def test_the_message_for_one_row_explains_stripes() -> None:
    for typed, means in (("RGB", "RGB/RGB"), ("rc", "RC/RC")):
        with pytest.raises(InputError, match=f'write stripes as "{means}"'):
            cfa(typed)
        assert cfa(means).side == (2, len(typed))
    for other in ("", "R" * 40, "RGX"):
        with pytest.raises(InputError, match='rows: "RG/GB"'):
            cfa(other)


@pytest.mark.parametrize("chi2", [0.0, 3.0])
def test_free_filters_are_no_worse_than_ideal_ones(chi2: float) -> None:
    found = best_filter_set(chi2, starts=2)
    assert found.matrix.min() >= 0 and found.matrix.max() <= 1
    rng = np.random.default_rng(0)
    ideal = filter_set_frontier(chi2).best
    assert monte_carlo_gain(found, ideal, chi2, rng=rng, trials=40_000, noise="pixel") > -0.03


@pytest.mark.parametrize("chi2", [0.0, 1.0, math.inf])
def test_masks_are_no_worse_than_the_known_ones(chi2: float) -> None:
    pinhole = mask("pinhole", 5)
    found = best_mask(5, chi2, starts=2)
    known = max(snr_gain(mask(kind, 5), pinhole, chi2) for kind in ("MURA", "pinhole"))
    assert snr_gain(found, pinhole, chi2) >= known - 1e-6
    if chi2 == 0:
        assert snr_gain(found, pinhole, chi2) > known + 0.2


@pytest.mark.long
@pytest.mark.parametrize(("size", "chi2"), [(5, 10.0), (5, 1.0), (7, 10.0)])
def test_many_plain_random_starts_find_no_better_mask(size: int, chi2: float) -> None:
    """The cost written again, from uniform and from open-or-closed masks, by another method."""

    def loss(x: np.ndarray) -> float:
        noise = np.sum(1 / (np.abs(np.fft.fft2(x.reshape(size, size))) ** 2 + 1e-9)) / size**2 * (1 + chi2 * x.mean())
        return 5 * math.log10(noise / (1 + chi2 / size**2))

    found = snr_gain(best_mask(size, chi2), mask("pinhole", size), chi2)
    rng, options = np.random.default_rng(11), {"maxiter": 60}
    for k in range(25):
        start = rng.random(size * size) if k % 2 else (rng.random(size * size) < 0.3) * 0.98 + 0.01
        other = minimize(loss, start, bounds=[(0, 1)] * size**2, method="L-BFGS-B", options=options)
        assert -loss(other.x) < found + 1e-3
    assert found < mask_gain_bound(size, chi2)


@pytest.mark.parametrize("chi2", [*(pytest.param(c, marks=pytest.mark.long) for c in (0.0, 1.0, 30.0)), math.inf])
def test_no_mask_exceeds_the_bound(chi2: float) -> None:
    rng = np.random.default_rng(5)
    for size in (2, 3, 4, 8):
        bound, pinhole = mask_gain_bound(size, chi2), mask("pinhole", size)
        for k in range(60):
            pattern = rng.random((size, size)) ** (k % 4) if k % 2 else (rng.random((size, size)) < k / 60) * 1.0
            assert snr_gain(mask_at_distance(pattern, 1.0), pinhole, chi2) <= bound + 1e-9
    assert mask_gain_bound(1, chi2) == 0


@pytest.mark.long
def test_difference_sets_reach_the_bound() -> None:
    # difference set of the 4 x 4 torus: 6 of 16 open, all other Fourier weights equal
    pattern = np.array([[1, 1, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], float)
    power = np.abs(np.fft.fft2(pattern)).ravel()[1:] ** 2
    np.testing.assert_allclose(power, power[0])
    # the bound is over all shares of light: it is met where this one is the best
    gaps = [mask_gain_bound(4, c) - snr_gain(mask_at_distance(pattern, 1.0), mask("pinhole", 4), c) for c in RATIOS]
    assert -1e-9 < min(gaps) < 1e-3


@pytest.mark.parametrize("chi2", [2.0, *(pytest.param(c, marks=pytest.mark.long) for c in (0.0, 50.0))])
def test_exhaustive_search_of_small_masks(chi2: float) -> None:
    best = snr_gain(mask_at_distance(best_binary_mask(3, chi2), 1.0), mask("pinhole", 3), chi2)
    every = []
    for code in range(1, 512):
        m = mask_at_distance(np.array(list(f"{code:09b}"), float).reshape(3, 3), 1.0)
        every.append(snr_gain(m, mask("pinhole", 3), chi2))
    assert best == pytest.approx(max(every), abs=1e-9)
    for size in (3, 4):  # grey masks may be better, never worse
        binary = mask_at_distance(best_binary_mask(size, chi2), 1.0)
        found = best_mask(size, chi2, starts=0)
        assert snr_gain(found, binary, chi2) > -1e-6
    with pytest.raises(InputError, match="size of the mask"):
        best_binary_mask(5, chi2)


def test_the_frontier_of_masks_and_its_best_so_far() -> None:
    found = mask_frontier(3, 0.5, points=3, starts=1)
    assert found.chosen.max() == pytest.approx(snr_gain(found.best, mask("pinhole", 3), 0.5))
    assert {"pinhole", "MURA"} <= {m.name for m in found.modulators}
    records: list[Any] = list(iter_mask_frontier(3, 0.5, points=3, starts=1))
    assert {record.stage for record in records} == {"masks"}
    gains = [float(record.found.chosen.max()) for record in records]
    assert gains == sorted(gains) and len(records[-1].found.modulators) == len(found.modulators)
    known = {m.name for m in records[0].found.modulators}
    assert "pinhole" in known and not any("best" in name for name in known)
    assert any("best" in m.name for m in records[1].found.modulators)


def test_wrong_searches_are_refused() -> None:
    for call in (
        lambda: filter_set_frontier(0.0, letters="RX"),
        lambda: filter_set_frontier(0.0, letters="RG"),
        lambda: best_mask(5, -1.0),
        lambda: filter_set_frontier(0.0, filters=2),
    ):
        with pytest.raises(InputError):
            call()


@pytest.mark.long
@pytest.mark.parametrize("chi2", [10.0, 30.0])
def test_different_starts_end_at_the_same_mask(chi2: float) -> None:
    """Pixels turned over lead from the best so far to a better one, from wherever the search began."""
    masks = [best_mask(5, chi2, starts=3, rng=np.random.default_rng(seed)) for seed in range(4)]
    gains = [snr_gain(one, mask("pinhole", 5), chi2) for one in masks]
    assert max(gains) - min(gains) < 1e-3
