"""The search for filter sets and masks: gradients, known optima, frontiers."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from lfcal.errors import InputError
from lfcal.multiplex import best_filter_set, best_mask, cfa, filter_set_frontier, mask, monte_carlo_gain, snr_gain
from lfcal.multiplex.search import _filters_cost, _mask_cost, iter_mask_frontier, mask_frontier


@pytest.mark.parametrize("chi2", [0.0, 2.0, math.inf])
@pytest.mark.parametrize(("cost", "shape"), [(_filters_cost, (5, 3)), (_mask_cost, (5, 5))])
def test_gradients(cost, shape: tuple[int, int], chi2: float) -> None:
    x = np.random.default_rng(1).uniform(0.2, 1, shape)
    numeric = approx_fprime(x.ravel(), lambda v: cost(v.reshape(shape), chi2)[0], 1e-7)
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


def test_frontier_of_masks() -> None:
    found = mask_frontier(3, 0.5, points=3, starts=1)
    assert found.chosen.max() == pytest.approx(snr_gain(found.best, mask("pinhole", 3), 0.5))
    assert {"pinhole", "MURA"} <= {m.name for m in found.modulators}
    stages = [p.stage for p in iter_mask_frontier(3, 0.5, points=3, starts=1)]
    assert set(stages) == {"masks"}


def test_bad_searches() -> None:
    for call in (
        lambda: filter_set_frontier(0.0, letters="RX"),
        lambda: filter_set_frontier(0.0, letters="RG"),
        lambda: best_mask(5, -1.0),
        lambda: filter_set_frontier(0.0, filters=2),
    ):
        with pytest.raises(InputError):
            call()


def test_a_search_has_its_best_so_far_at_every_record() -> None:
    records: list[Any] = list(iter_mask_frontier(3, 0.5, points=3, starts=1))
    gains = [float(record.found.chosen.max()) for record in records]
    assert gains == sorted(gains) and [len(r.found.modulators) for r in records][-1] == len(
        mask_frontier(3, 0.5, points=3, starts=1).modulators
    )
    known = {m.name for m in records[0].found.modulators}
    assert "pinhole" in known and not any("best" in name for name in known)
    assert any("best" in m.name for m in records[1].found.modulators)
