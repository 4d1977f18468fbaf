from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.camera import LatticeDistortion
from lfcal.lattice._forms import ENOUGH, DistortionFrame, flexible_form, select_form, thinned
from lfcal.lattice._model import LatticeModel

SHAPE = (500, 600)
FRAME = DistortionFrame.of(SHAPE)
STRAIGHT = LatticeModel("hexagonal", np.array([300.0, 250.0]), np.array([18.0, 0.4]), 0.866)


def bent(*terms: float) -> LatticeModel:
    half = len(terms) // 2
    bend = LatticeDistortion("polynomial", FRAME.middle, FRAME.scale, (terms[:half], terms[half:]))
    return replace(STRAIGHT, distortion=bend)


MODELS = {
    "affine": STRAIGHT,
    "affine with shear": replace(STRAIGHT, shear=0.002),
    "radial": replace(STRAIGHT, distortion=LatticeDistortion("radial", (310.0, 190.0), FRAME.scale, ((1.5,),))),
    "quadratic": bent(0.8, -0.5, 0.3, 0.2, 0.7, -0.6),
    "cubic": bent(0.8, -0.5, 0.3, 1.0, -1.0, 0.5, 0.8, 0.2, 0.7, -0.6, 0.9, 0.4, 1.2, -0.7),
}


def places(truth: LatticeModel, seed: int, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    index = truth.within(SHAPE, 9.0)
    rng = np.random.default_rng(seed)
    return index, truth.places(index) + rng.normal(0, noise, (len(index), 2))


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_the_form_that_made_the_places_is_chosen(name: str, seed: int) -> None:
    chosen = select_form(STRAIGHT, *places(MODELS[name], seed), FRAME)
    assert chosen.fitted.form.name == name
    assert chosen.reason.startswith(name)


@pytest.mark.long
def test_scatter_alone_calls_for_nothing() -> None:
    found = [select_form(STRAIGHT, *places(STRAIGHT, seed, 0.1), FRAME).fitted.form.name for seed in range(12)]
    assert set(found) == {"affine"}


@pytest.mark.long
def test_neighbours_that_err_alike_call_for_little() -> None:
    """Scatter that lenslets share with their neighbours: as independent ones they would seem to call for a form."""
    from scipy.ndimage import gaussian_filter

    index = STRAIGHT.within(SHAPE, 7.0)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        fields = [gaussian_filter(rng.normal(size=SHAPE), 9.0) for _ in range(2)]
        at = STRAIGHT.places(index).astype(int)
        common = np.stack([f[at[:, 1], at[:, 0]] / f.std() for f in fields], axis=-1)
        seen = STRAIGHT.places(index) + 0.03 * common + rng.normal(0, 0.03, common.shape)
        assert select_form(STRAIGHT, index, seen, FRAME).fitted.form.size <= 6


@pytest.mark.long
def test_errors_are_those_of_many_draws() -> None:
    """Over 12 draws with outliers the cubic's numbers scatter as their covariance says."""
    truth = MODELS["cubic"]
    index = truth.within(SHAPE, 9.0)
    steps, stated = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        seen = truth.places(index) + 0.05 * rng.standard_t(4, (len(index), 2))
        chosen = select_form(STRAIGHT, index, seen, FRAME)
        assert chosen.fitted.form.name == "cubic" and chosen.fitted.model.distortion is not None
        steps.append(np.concatenate(chosen.fitted.model.distortion.terms))
        stated.append(np.sqrt(np.diag(chosen.covariance)[6:]))
    want = np.concatenate(truth.distortion.terms) if truth.distortion is not None else 0.0
    z = (np.array(steps) - want) / np.array(stated)
    assert 0.85 < z.std() < 1.15
    assert np.abs(z.mean(0)).max() < 4 / np.sqrt(12)


def test_few_lenslets_are_not_asked_for_many_numbers() -> None:
    assert flexible_form(20).name == "affine"
    assert flexible_form(1000).name == "quintic"
    small = LatticeModel("square", np.array([50.0, 50.0]), np.array([14.0, 0.0]), 1.0)
    index = small.within((90, 90), 7.0)
    seen = small.places(index) + np.random.default_rng(0).normal(0, 0.05, (len(index), 2))
    assert select_form(small, index, seen, DistortionFrame.of((90, 90))).fitted.form.size <= 6


def test_thinning_keeps_the_field() -> None:
    assert np.array_equal(thinned(50), np.arange(50))
    few = thinned(80000)
    assert len(few) == ENOUGH == len(set(few.tolist()))
    assert np.abs(np.histogram(few, 10)[0] / 1000 - 1).max() < 0.1
