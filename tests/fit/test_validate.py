"""The verdict of a fit, and its prediction of held-out points: no error for the truth, and the error of a wrong gap."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Camera, ScanPlan
from lfcal.fit import Fit, Measured, Setup
from lfcal.fit._weighing import PatternLevels
from lfcal.fit.model import Fineness, predict
from lfcal.fit.model_error import INCOMPLETE, ChiSquare, ModelError
from lfcal.fit.nuisance import Spread
from lfcal.fit.setup import described_effects
from lfcal.fit.validate import Validation, draw_validation, validate
from tests.fit.common import small_camera, small_plan

NOISE = (16.0, 1.0)


def fit_of(plan: ScanPlan, camera: Camera | None = None, fitted: int = 0) -> Fit:
    """Return a fit that has found ``camera``, or the plan's own, of the first ``fitted`` positions."""
    found = plan.camera if camera is None else camera
    setup = Setup(found, described_effects(found), (0.0,) * len(plan.depths_um))
    index = np.argwhere(np.ones(plan.shape[:3], bool))[:fitted]
    return Fit(
        setup=setup,
        planned=plan,
        parameters={},
        groups=(),
        unhelpful=(),
        chi_square=ChiSquare(1.0, 1.0, 0.1),
        held_out_error=ModelError(0.0, 1e-6, 0.0, 1),
        correlations=np.zeros((0, 0)),
        held=(),
        unidentified=(),
        outliers=(),
        answers={},
        spread=Spread(),
        levels=PatternLevels(np.ones(1), np.zeros(1), np.zeros(0)),
        residuals={tuple(at): np.zeros(plan.cutout, np.float32) for at in index.tolist()},
    )


def recorded(plan: ScanPlan, index: np.ndarray, offsets: np.ndarray | None = None, seed: int = 0) -> Measured:
    """Return patterns of the plan's camera with noise, of another brightness each."""
    n = len(index)
    setup = Setup(plan.camera, described_effects(plan.camera), (0.0,) * len(plan.depths_um))
    light = predict(setup, plan, index, np.zeros((n, 2)) if offsets is None else offsets, Fineness.finest)
    rng = np.random.default_rng(seed)
    clean = 1.2e4 * np.maximum(light, 0) / light.max() * (1 + 0.1 * np.arange(n)[:, None, None] / n)
    noisy = rng.poisson(clean) + 4.0 * rng.standard_normal(clean.shape)
    zero = np.zeros((n, 2))
    return Measured(
        plan, index, noisy.astype(np.float32), zero + NOISE, zero, np.ones(clean.shape, bool), np.zeros(n, bool)
    )


def few(plan: ScanPlan) -> np.ndarray:
    return np.argwhere(np.ones(plan.shape[:3], bool))[2:]


def plan_of() -> ScanPlan:
    return replace(small_plan(15, (2.2,)), period=(2, 4))


def test_the_true_camera_predicts_points_to_the_noise() -> None:
    plan = plan_of()
    offsets = np.linspace(-0.2, 0.2, 12).reshape(6, 2)
    found = validate(fit_of(plan, fitted=2), recorded(plan, few(plan), offsets))
    assert len(found.points) == 6 and not found.error().known and found.error().limit < 0.02
    for one in found.points:
        assert abs(one.model.chi_square.lit - 1) < 6 * one.model.chi_square.sigma and one.periodic is None
        k = [tuple(at) for at in few(plan).tolist()].index((one.z, one.y, one.x))
        assert np.abs(one.model.displacement_px - offsets[k]).max() < 0.02
    assert not found.wide and "its edges were not tested" in found.verdict


def test_uneven_pixels_are_no_error_of_the_model() -> None:
    plan = plan_of()
    points = recorded(plan, few(plan))
    gains = 1 + 0.03 * np.random.default_rng(3).standard_normal(points.patterns.shape)
    points = replace(points, patterns=(points.patterns * gains).astype(np.float32))
    fit = fit_of(plan)
    assert validate(fit, points).error().value == pytest.approx(0.03, rel=0.2)
    assert not validate(replace(fit, spread=Spread(response=0.03)), points).error().known


def test_only_light_that_counts_weighs_a_point() -> None:
    """A pixel without weight (saturated, a defect) may hold anything: brighter points count more, defects do not."""
    plan = plan_of()
    found = validate(fit_of(plan, fitted=2), recorded(plan, few(plan)))
    one, other = found.points[:2]

    def with_defect(value: float) -> Validation:
        weight, light = other.model.weight.copy(), other.model.light.copy()
        weight.flat[0], light.flat[0] = 0, value
        return Validation((one, replace(other, model=replace(other.model, weight=weight, light=light))))

    assert with_defect(0.0).error().squared == with_defect(1e6).error().squared


def test_a_wrong_gap_has_the_error_of_its_patterns() -> None:
    plan = plan_of()
    lattice = plan.camera.lattice
    wrong = replace(plan.camera, lattice=replace(lattice, gap_um=1.03 * lattice.gap_um))
    found = validate(fit_of(plan, wrong, fitted=2), recorded(plan, few(plan))).error()
    setup = Setup(wrong, described_effects(wrong), (0.0,))
    a, b = (
        predict(own, plan, few(plan), np.zeros((6, 2)), Fineness.fine).astype(float)
        for own in (replace(setup, camera=plan.camera), setup)
    )
    b *= (a * b).sum((1, 2), keepdims=True) / (b * b).sum((1, 2), keepdims=True)
    wanted = np.sqrt(np.square(a - b).sum() / np.square(a).sum())
    # gain, background and place of the source take some of it
    assert found.known and 0.6 * wanted < found.value < 1.1 * wanted


@pytest.mark.long
def test_the_edges_of_the_field_show_whether_the_period_holds(tmp_path: Path) -> None:
    """A period of whole pixels is not the array's own: far from where it was scanned micro-images have slipped."""
    camera = small_camera()
    camera = replace(camera, sensor=replace(camera.sensor, shape=(500, 500)))
    plan = ScanPlan.for_camera(camera, virtual_depths=(2.2,), cutout=15)
    assert max(abs(v) for v in plan.period_residual_px) > 0.02
    # a scan as wide as half the sensor, of which some positions were recorded
    wide = replace(plan, period=(19 * 6, 33 * 6))
    index = np.array([[0, 19 * k + y, 33 * k + x] for k in (0, 2, 5) for y, x in ((3, 5), (12, 20))])
    found = validate(fit_of(plan), recorded(wide, index))
    assert found.wide and not found.worse(periodic=False) and found.error().limit < 0.02
    assert found.worse(periodic=True) and "H is not periodic over the field" in found.verdict
    inner, outer = (found.error(part, periodic=True) for part in (found.middle, found.edges))
    assert not inner.known and outer.value > 0.04
    draw_validation(found, tmp_path / "field.png")
    assert (tmp_path / "field.png").stat().st_size > 5000
    # a wrong camera is wrong everywhere, or more so outside the scan
    lattice = plan.camera.lattice
    grown = replace(camera, lattice=replace(lattice, pitch_um=1.003 * lattice.pitch_um))
    beyond = validate(fit_of(plan, grown), recorded(wide, index))
    assert beyond.worse(periodic=False) and "is not valid at the field's edges" in beyond.verdict


def test_fitted_points_and_points_of_another_sensor_are_refused() -> None:
    plan = plan_of()
    with pytest.raises(InputError, match="points that were not fitted"):
        validate(fit_of(plan, fitted=8), recorded(plan, few(plan)))
    other = replace(plan.camera, sensor=replace(plan.camera.sensor, shape=(200, 200)))
    with pytest.raises(InputError, match="sensor of the held-out points"):
        validate(fit_of(replace(plan, camera=other)), recorded(plan, few(plan)))


def test_middle_and_edges_are_a_third_of_the_points_each() -> None:
    for count, inner, outer in ((1, [0], [0]), (4, [0], [3]), (6, [0, 1], [4, 5]), (7, [0, 1], [5, 6])):
        found = Validation(tuple(range(count)))  # type: ignore[arg-type]
        assert (list(found.middle), list(found.edges)) == (inner, outer)


def test_the_verdict_states_chi_square() -> None:
    for lit, sigma, begins, complete in (
        (1.01, 0.02, "chi² 1.010; error of the model", True),
        (1.2, 0.02, "model incomplete: chi² 1.200, 10 sigma above 1", False),
        # noise that is stated too large makes every sigma and limit too large
        (0.8, 0.02, "chi² 0.800, 10 sigma below 1: the noise is smaller than stated", True),
        # at the limits
        (1 - INCOMPLETE / 8, 1 / 8, f"chi² {1 - INCOMPLETE / 8:.3f}; error of the model", True),
        (1 + INCOMPLETE / 8, 1 / 8, "model incomplete", False),
        # no more samples than unknowns: a 1 would be no measurement
        (1.0, math.inf, "chi² unknown: the samples do not outnumber the unknowns", True),
    ):
        fit = replace(fit_of(plan_of()), chi_square=ChiSquare(lit, lit, sigma))
        assert fit.verdict.startswith(begins) and fit.complete is complete, begins
