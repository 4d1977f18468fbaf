from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfcal.camera import LatticeDistortion
from lfcal.lattice._model import LatticeModel, neighbour_median


def model(kind: str = "hexagonal", angle: float = 0.01, pitch: float = 15.0, ratio: float = 0.87) -> LatticeModel:
    return LatticeModel(kind, np.array([200.0, 150.0]), pitch * np.array([np.cos(angle), np.sin(angle)]), ratio)


def test_shear_shifts_rows_along_themselves() -> None:
    straight, leaning = model("square"), replace(model("square"), shear=0.01)
    index = np.array([[3, 0], [0, 1], [2, 5]])
    moved = leaning.places(index) - straight.places(index)
    assert np.allclose(moved, 0.01 * straight.ratio * index[:, 1:] * straight.along)


def test_places_and_indices_are_inverse_with_a_distortion() -> None:
    bend = LatticeDistortion("radial", (180.0, 160.0), 250.0, ((3.0,),))
    bent = replace(model(), distortion=bend, shear=0.002)
    index = bent.within((300, 400), 7.0)
    assert np.allclose(bent.indices(bent.places(index)), index, atol=1e-9)
    assert np.allclose(bent.places(index), bend.apply(bent.straight(index)))
    there = {tuple(pair) for pair in index.tolist()}
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-60, 61), np.arange(-60, 61)))
    every = np.stack([q, r], axis=-1)
    places = bent.places(every)
    inside = ((places >= 7) & (places <= (399 - 7, 299 - 7))).all(1)
    assert {tuple(pair) for pair in every[inside].tolist()} == there


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
