"""Forms of lattices: places, derivatives, robust fits, and the choice of the form."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter

from lfcal.camera import LatticeDistortion
from lfcal.lattice._forms import (
    FORMS,
    MAX_LENSLETS,
    DistortionFrame,
    design,
    fit_form,
    flexible_form,
    huber,
    select_form,
    thinned,
)
from lfcal.lattice._model import LatticeModel, neighbour_median

SHAPE = (300, 400)
FRAME = DistortionFrame.of(SHAPE)
BY_NAME = {form.name: form for form in FORMS}
BENDS = {
    "radial": LatticeDistortion("radial", (230.0, 120.0), FRAME.scale, ((2.5,),)),
    "radial of two terms": LatticeDistortion("radial", (190.0, 140.0), FRAME.scale, ((2.5, -0.8),)),
    "quadratic": LatticeDistortion("polynomial", FRAME.middle, FRAME.scale, ((1.0, -0.6, 0.3), (0.4, 0.9, -0.8))),
    "cubic": LatticeDistortion(
        "polynomial", FRAME.middle, FRAME.scale, ((1.0, -0.6, 0.3, 2.0, 1.0, -1.0, 0.5), (0.4, 0.9, -0.8, 0, 1, 2, -3))
    ),
}


def model(kind: str = "hexagonal", angle: float = 0.01, pitch: float = 15.0, ratio: float = 0.87) -> LatticeModel:
    return LatticeModel(kind, np.array([200.0, 150.0]), pitch * np.array([np.cos(angle), np.sin(angle)]), ratio)


@given(st.sampled_from(["square", "hexagonal"]), st.floats(-3, 3), st.floats(0.8, 1.2), st.integers(0, 99))
@settings(derandomize=True, deadline=None, max_examples=30)
def test_exact_places_give_the_lattice_back(kind: str, angle: float, ratio: float, seed: int) -> None:
    truth = replace(model(kind, angle, ratio=ratio), shear=0.003 * (seed % 2))
    index = truth.within(SHAPE, 7.0)
    off = np.random.default_rng(seed).uniform(-1, 1, 5) * (0.5, 0.5, 0.05, 0.05, 0.003)
    start = LatticeModel(kind, truth.origin + off[:2], truth.along + off[2:4], ratio + off[4])
    fitted = fit_form(start, FORMS[seed % 2], index, truth.places(index), FRAME)
    assert fitted is not None
    found = fitted.model
    assert found.along == pytest.approx(truth.along, abs=1e-7) and found.ratio == pytest.approx(ratio, abs=1e-8)
    assert found.origin == pytest.approx(truth.origin, abs=1e-6)
    assert found.shear == pytest.approx(truth.shear, abs=1e-8)
    assert np.abs(fitted.residual).max() < 1e-6
    again = LatticeModel.of(kind, model(kind, angle, ratio=ratio).basis(), found.origin)
    assert again.ratio == pytest.approx(ratio) and again.pitch == pytest.approx(15.0)


def test_exact_places_give_the_distortion_back() -> None:
    for name, bend in BENDS.items():
        truth = replace(model(), distortion=bend, shear=-0.002)
        index = truth.within(SHAPE, 7.0)
        start = fit_form(model(), BY_NAME["quintic"], index, truth.places(index), FRAME)
        assert start is not None
        fitted = fit_form(start.model, BY_NAME[name], index, truth.places(index), FRAME, rounds=20)
        assert fitted is not None and fitted.model.distortion is not None
        assert np.abs(fitted.residual).max() < 1e-5, name
        assert np.allclose(fitted.model.distortion.terms, bend.terms, atol=2e-4), name
        assert fitted.model.distortion.centre == pytest.approx(bend.centre, abs=0.05)
        assert fitted.model.pitch == pytest.approx(15.0, abs=1e-5)


@pytest.mark.parametrize("name", ["affine", "affine with shear", "radial", "cubic"])
def test_the_design_is_the_derivative(name: str) -> None:
    """Each column against the change of places under a small step of that number, up to the bend's own slope."""
    form = BY_NAME[name]
    base = replace(model(), shear=0.002 if form.sheared else 0.0, distortion=BENDS.get(name))
    index = base.within(SHAPE, 7.0)
    columns = design(base, form, index, FRAME)
    assert columns.shape == (2, len(index), form.size)
    h = 1e-6

    def stepped(k: int, by: float) -> LatticeModel:
        if k < 2:
            return replace(base, origin=base.origin + by * np.eye(2)[k])
        if k < 4:
            return replace(base, along=base.along + by * np.eye(2)[k - 2])
        if k == 4:
            return replace(base, ratio=base.ratio + by)
        if k == 5:
            return replace(base, shear=base.shear + by)
        bend = base.distortion
        assert bend is not None
        flat = np.concatenate([*bend.terms, *([bend.centre] if form.radial else [])])
        flat[k - 6] += by
        if form.radial:
            bend = replace(bend, terms=(tuple(flat[:-2]),), centre=(flat[-2], flat[-1]))
        else:
            bend = replace(bend, terms=(tuple(flat[: len(flat) // 2]), tuple(flat[len(flat) // 2 :])))
        return replace(base, distortion=bend)

    for k in range(form.size):
        slope = (stepped(k, h).places(index) - stepped(k, -h).places(index)) / (2 * h)
        near = columns[:, :, k].T
        assert np.abs(slope - near).max() < 0.06 * np.abs(near).max() + 1e-6


def test_outliers_hardly_move_the_lattice() -> None:
    truth = model()
    index = truth.within(SHAPE, 7.0)
    rng = np.random.default_rng(1)
    places = truth.places(index) + rng.normal(0, 0.05, (len(index), 2))
    places[rng.random(len(index)) < 0.05] += (4.0, 3.0)
    found = fit_form(truth, FORMS[0], index, places, FRAME)
    assert found is not None
    plain = np.linalg.lstsq(np.column_stack([np.ones(len(index)), index]), places, rcond=None)[0]
    assert np.hypot(*(found.model.origin - truth.origin)) < 0.02 < np.hypot(*(plain[0] - truth.origin))
    assert found.sigma == pytest.approx(0.05, rel=0.15)
    # given weights are used
    places, weight = truth.places(index), np.ones(len(index))
    places[:100], weight[:100] = places[:100] + 3.0, 0.0
    found = fit_form(truth, FORMS[0], index, places, FRAME, weight=weight)
    assert found is not None and np.abs(found.residual[100:]).max() < 1e-9


def test_places_that_do_not_determine_a_form_give_none() -> None:
    truth = model()
    index = np.array([[0, 0], [1, 0], [2, 0]])
    assert fit_form(truth, BY_NAME["cubic"], index, truth.places(index), FRAME) is None
    every = truth.within(SHAPE, 7.0)
    # no cubic to start a radial one from
    assert fit_form(truth, BY_NAME["radial"], every, truth.places(every), FRAME) is None


def test_huber_weights_of_a_gaussian() -> None:
    residual = np.random.default_rng(2).normal(0, 0.2, (4000, 2))
    weight, sigma = huber(residual)
    assert sigma == pytest.approx(0.2, rel=0.03)
    assert (weight == 1).mean() == pytest.approx(1 - math.exp(-(1.5**2) / 2), abs=0.03)
    assert [form.size for form in FORMS] == [5, 6, 9, 10, 12, 20, 30, 42], "numbers of the forms"


WHOLE = (500, 600)
WHOLE_FRAME = DistortionFrame.of(WHOLE)
STRAIGHT = LatticeModel("hexagonal", np.array([300.0, 250.0]), np.array([18.0, 0.4]), 0.866)


def bent(*terms: float) -> LatticeModel:
    half = len(terms) // 2
    bend = LatticeDistortion("polynomial", WHOLE_FRAME.middle, WHOLE_FRAME.scale, (terms[:half], terms[half:]))
    return replace(STRAIGHT, distortion=bend)


MODELS = {
    "affine": STRAIGHT,
    "affine with shear": replace(STRAIGHT, shear=0.002),
    "radial": replace(STRAIGHT, distortion=LatticeDistortion("radial", (310.0, 190.0), WHOLE_FRAME.scale, ((1.5,),))),
    "quadratic": bent(0.8, -0.5, 0.3, 0.2, 0.7, -0.6),
    "cubic": bent(0.8, -0.5, 0.3, 1.0, -1.0, 0.5, 0.8, 0.2, 0.7, -0.6, 0.9, 0.4, 1.2, -0.7),
}


def places(truth: LatticeModel, seed: int, noise: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    index = truth.within(WHOLE, 9.0)
    rng = np.random.default_rng(seed)
    return index, truth.places(index) + rng.normal(0, noise, (len(index), 2))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_the_form_that_made_the_places_is_chosen(seed: int) -> None:
    for name, truth in MODELS.items():
        chosen = select_form(STRAIGHT, *places(truth, seed), WHOLE_FRAME)
        assert chosen.fitted.form.name == name and chosen.reason.startswith(name)


@pytest.mark.long
def test_noise_does_not_select_a_form() -> None:
    """Noise that lenslets share with their neighbours would seem to need a form, were it independent."""
    found = [select_form(STRAIGHT, *places(STRAIGHT, seed, 0.1), WHOLE_FRAME).fitted.form.name for seed in range(12)]
    assert set(found) == {"affine"}
    index = STRAIGHT.within(WHOLE, 7.0)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        fields = [gaussian_filter(rng.normal(size=WHOLE), 9.0) for _ in range(2)]
        at = STRAIGHT.places(index).astype(int)
        common = np.stack([f[at[:, 1], at[:, 0]] / f.std() for f in fields], axis=-1)
        seen = STRAIGHT.places(index) + 0.03 * common + rng.normal(0, 0.03, common.shape)
        assert select_form(STRAIGHT, index, seen, WHOLE_FRAME).fitted.form.size <= 6


@pytest.mark.long
def test_errors_are_those_of_many_draws() -> None:
    """Over 12 draws with outliers the cubic's numbers scatter as their covariance says."""
    truth = MODELS["cubic"]
    index = truth.within(WHOLE, 9.0)
    steps, stated = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        seen = truth.places(index) + 0.05 * rng.standard_t(4, (len(index), 2))
        chosen = select_form(STRAIGHT, index, seen, WHOLE_FRAME)
        assert chosen.fitted.form.name == "cubic" and chosen.fitted.model.distortion is not None
        steps.append(np.concatenate(chosen.fitted.model.distortion.terms))
        stated.append(np.sqrt(np.diag(chosen.covariance)[6:]))
    want = np.concatenate(truth.distortion.terms) if truth.distortion is not None else 0.0
    z = (np.array(steps) - want) / np.array(stated)
    assert 0.85 < z.std() < 1.15
    assert np.abs(z.mean(0)).max() < 4 / np.sqrt(12)


def test_few_lenslets_do_not_get_a_form_of_many_numbers() -> None:
    assert flexible_form(20).name == "affine"
    assert flexible_form(1000).name == "quintic"
    small = LatticeModel("square", np.array([50.0, 50.0]), np.array([14.0, 0.0]), 1.0)
    index = small.within((90, 90), 7.0)
    seen = small.places(index) + np.random.default_rng(0).normal(0, 0.05, (len(index), 2))
    assert select_form(small, index, seen, DistortionFrame.of((90, 90))).fitted.form.size <= 6


def test_thinning_keeps_the_field() -> None:
    assert np.array_equal(thinned(50), np.arange(50))
    few = thinned(80000)
    assert len(few) == MAX_LENSLETS == len(set(few.tolist()))
    assert np.abs(np.histogram(few, 10)[0] / 1000 - 1).max() < 0.1


def test_shear_shifts_rows_along_themselves() -> None:
    straight, leaning = model("square"), replace(model("square"), shear=0.01)
    index = np.array([[3, 0], [0, 1], [2, 5]])
    moved = leaning.places(index) - straight.places(index)
    assert np.allclose(moved, 0.01 * straight.ratio * index[:, 1:] * straight.along)


def test_within_lists_exactly_the_lenslets_in_the_frame() -> None:
    lattice = model(angle=0.3)
    every = np.stack(np.meshgrid(np.arange(-60, 61), np.arange(-60, 61)), axis=-1).reshape(-1, 2)
    bend = LatticeDistortion("radial", (180.0, 160.0), 250.0, ((3.0,),))
    bent = replace(model(), distortion=bend, shear=0.002)
    for one, margin in ((lattice, 5.0), (bent, 7.0)):
        places, index = one.places(every), one.within((300, 400), margin)
        inside = ((places >= margin) & (places <= (399 - margin, 299 - margin))).all(1)
        assert set(map(tuple, index.tolist())) == set(map(tuple, every[inside].tolist()))
        assert np.allclose(one.indices(one.places(index)), index, atol=1e-9)
    assert np.allclose(bent.places(index), bend.apply(bent.straight(index)))
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
