from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.lattice.model import LatticeModel, fit_model, free_shear, neighbour_median


def model(kind: str = "hexagonal", angle: float = 0.01, pitch: float = 15.0, ratio: float = 0.87) -> LatticeModel:
    return LatticeModel(kind, np.array([200.0, 150.0]), pitch * np.array([np.cos(angle), np.sin(angle)]), ratio)


@given(st.sampled_from(["square", "hexagonal"]), st.floats(-3, 3), st.floats(0.8, 1.2), st.integers(0, 99))
@settings(derandomize=True, deadline=None, max_examples=30)
def test_exact_places_give_the_lattice_back(kind: str, angle: float, ratio: float, seed: int) -> None:
    truth = model(kind, angle, ratio=ratio)
    index = truth.within((300, 400), 7.0)
    off = np.random.default_rng(seed).uniform(-1, 1, 5) * (0.5, 0.5, 0.05, 0.05, 0.003)
    start = LatticeModel(kind, truth.origin + off[:2], truth.along + off[2:4], ratio + off[4])
    found, residual, _ = fit_model(start, index, truth.places(index))
    assert found.along == pytest.approx(truth.along, abs=1e-7) and found.ratio == pytest.approx(ratio, abs=1e-8)
    assert found.origin == pytest.approx(truth.origin, abs=1e-6)
    assert np.abs(residual).max() < 1e-6
    again = LatticeModel.of(kind, found.basis(), found.origin)
    assert again.ratio == pytest.approx(ratio) and again.pitch == pytest.approx(15.0)


def test_outliers_hardly_move_it() -> None:
    truth = model()
    index = truth.within((300, 400), 7.0)
    rng = np.random.default_rng(1)
    places = truth.places(index) + rng.normal(0, 0.05, (len(index), 2))
    places[rng.random(len(index)) < 0.05] += (4.0, 3.0)
    found, _, error = fit_model(truth, index, places)
    plain = np.linalg.lstsq(np.column_stack([np.ones(len(index)), index]), places, rcond=None)[0]
    assert np.hypot(*(found.origin - truth.origin)) < 0.02 < np.hypot(*(plain[0] - truth.origin))
    assert abs(found.pitch - 15.0) < 5 * error < 5e-3


def test_shear_is_told_from_rotation() -> None:
    square = model("square", ratio=1.0)
    index = square.within((300, 300), 7.0)
    assert free_shear(square, index, square.places(index)) == pytest.approx(0.0, abs=1e-12)
    leaning = square.places(index) + 0.002 * 15.0 * index[:, 1:] * (square.along / 15.0)
    assert free_shear(square, index, leaning) == pytest.approx(0.002, rel=1e-3)


def test_within_lists_exactly_the_lenslets_in_the_frame() -> None:
    lattice = model(angle=0.3)
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-60, 61), np.arange(-60, 61)))
    every = np.stack([q, r], axis=-1)
    places = lattice.places(every)
    inside = ((places >= 5) & (places <= (399 - 5, 299 - 5))).all(1)
    want = {tuple(pair) for pair in every[inside].tolist()}
    assert {tuple(pair) for pair in lattice.within((300, 400), 5.0).tolist()} == want
    middle = lattice.centred_on(np.array([10.0, 20.0]))
    assert np.hypot(*(middle.origin - (10.0, 20.0))) <= 15.0 / np.sqrt(3) + 0.5


def test_neighbour_median_ignores_single_outliers() -> None:
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-5, 6), np.arange(-4, 5)))
    index = np.stack([q, r], axis=-1)
    values = 100.0 + q
    values[(q == 1) & (r == 1)] = 0.0
    median = neighbour_median(index, values)
    inner = (abs(q) <= 3) & (abs(r) <= 2)
    assert np.abs(median - (100.0 + q))[inner].max() <= 1.0
