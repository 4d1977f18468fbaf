from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lfcal.camera import LatticeDistortion
from lfcal.lattice._forms import FORMS, DistortionFrame, LatticeForm, design, fit_form, huber
from lfcal.lattice._model import LatticeModel

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


@pytest.mark.parametrize("name", BENDS)
def test_exact_places_give_the_distortion_back(name: str) -> None:
    truth = replace(model(), distortion=BENDS[name], shear=-0.002)
    index = truth.within(SHAPE, 7.0)
    start = fit_form(model(), BY_NAME["quintic"], index, truth.places(index), FRAME)
    assert start is not None
    fitted = fit_form(start.model, BY_NAME[name], index, truth.places(index), FRAME, rounds=20)
    assert fitted is not None and fitted.model.distortion is not None
    assert np.abs(fitted.residual).max() < 1e-5
    assert np.allclose(fitted.model.distortion.terms, BENDS[name].terms, atol=2e-4)
    assert fitted.model.distortion.centre == pytest.approx(BENDS[name].centre, abs=0.05)
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


def test_outliers_hardly_move_it() -> None:
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


def test_given_weights_are_used() -> None:
    truth = model()
    index = truth.within(SHAPE, 7.0)
    places = truth.places(index)
    places[:100] += 3.0
    weight = np.ones(len(index))
    weight[:100] = 0.0
    found = fit_form(truth, FORMS[0], index, places, FRAME, weight=weight)
    assert found is not None and np.abs(found.residual[100:]).max() < 1e-9


def test_places_that_do_not_determine_a_form_give_none() -> None:
    truth = model()
    index = np.array([[0, 0], [1, 0], [2, 0]])
    assert fit_form(truth, BY_NAME["cubic"], index, truth.places(index), FRAME) is None
    every = truth.within(SHAPE, 7.0)
    # no cubic to start a radial one from
    assert fit_form(truth, BY_NAME["radial"], every, truth.places(every), FRAME) is None


def test_weights_of_a_gaussian_keep_most() -> None:
    residual = np.random.default_rng(2).normal(0, 0.2, (4000, 2))
    weight, sigma = huber(residual)
    assert sigma == pytest.approx(0.2, rel=0.03)
    assert (weight == 1).mean() == pytest.approx(1 - math.exp(-(1.5**2) / 2), abs=0.03)


def test_sizes_are_counted_and_ordered() -> None:
    assert [form.size for form in FORMS] == [5, 6, 9, 10, 12, 20, 30, 42]
    assert LatticeForm("x", degree=2).size == 12
