"""Predicted patterns are those of the simulator; weights and normal equations are those of dense least squares."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from lfcal.fit._weighing import BEND, PatternLevels, levels_of, weighed
from lfcal.fit.model import LEVEL, Fineness, predict
from lfcal.fit.normal import Columns, Local, normal_equations
from lfcal.fit.solver import solve
from lfcal.simulate.accuracy.sampling import grid_margin
from lfcal.simulate.effects import Crosstalk, FiniteSource
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.response import PlaneResponse
from lfcal.simulate.staging import scene_for
from tests.fit.common import few_fit, measured, setup_of, small_plan, some_index, vector_of
from tests.simulate.common import difference

PLAN = small_plan()
INDEX = some_index(PLAN, 6)
STILL = np.zeros((6, 2))


def test_predictions_are_those_of_the_simulator() -> None:
    for more in ((), (Crosstalk(0.03),), (FiniteSource(30.0), Crosstalk(0.02))):
        setup = replace(setup_of(PLAN), effects=(*setup_of(PLAN).effects, *more))
        found = predict(setup, PLAN, INDEX[:2], STILL[:2], Fineness.fine)
        for k, (z, y, x) in enumerate(INDEX[:2].tolist()):
            wanted = PlaneResponse(PLAN, z, setup.effects, level=LEVEL, sampling=Fineness.fine).rows([y], [x])[0, 0]
            # the grids differ in size
            assert difference(found[k], wanted) < 5e-3, more


@pytest.mark.long
def test_the_error_of_each_fineness_is_as_stated() -> None:
    """Against the coherent reference, which shares no sampling with the grid."""
    setup = setup_of(PLAN)
    own = INDEX[INDEX[:, 0] == 0][:2]
    plane = PlaneResponse(PLAN, 0, setup.effects, level="reference", sampling=Sampling(10.0))
    reference = np.stack([plane.rows([y], [x])[0, 0] for _, y, x in own.tolist()]).astype(float)
    for sampling, least in ((Fineness.coarse, 6e-3), (Fineness.fine, 1.2e-3), (Fineness.finest, 6e-4)):
        found = predict(setup, PLAN, own, np.zeros((2, 2)), sampling)
        assert np.sqrt(np.square(found - reference).sum() / np.square(reference).sum()) < least


def test_displaced_sources_are_predicted_at_their_places() -> None:
    """Also of one position measured twice; of the margins that a fit's grids have."""
    setup = setup_of(PLAN)
    index = np.array([[0, 4, 7], [1, 4, 7], [0, 4, 7]])
    moved = np.array([[0.2, -0.1], [0.0, 0.3], [-0.4, 0.25]])
    found = predict(setup, PLAN, index, moved, Fineness.fine)
    pixel = PLAN.camera.sensor.pixel_um
    for k in range(3):
        scene = scene_for(PLAN, int(index[k, 0]), setup.effects)
        offsets = np.broadcast_to(moved[k] * pixel, (*scene.period, 2))
        wide = replace(Fineness.fine, margin_px=grid_margin(scene, 0.006))
        wanted = engine_for(replace(scene, offsets_um=offsets), LEVEL, wide).rows([4], [7])[0, 0]
        assert difference(found[k], wanted) < 2e-3
    assert difference(found[0], found[2]) > 0.1


def test_longer_stage_steps_scale_about_the_middle_of_the_period() -> None:
    setup = setup_of(PLAN)
    longer = replace(setup, stage_scale=0.02)
    middle = (np.array(PLAN.period) - 1) / 2
    moved = 0.02 * (INDEX[:, 1:] - middle)
    found = predict(longer, PLAN, INDEX, STILL, Fineness.fine)
    np.testing.assert_allclose(found, predict(setup, PLAN, INDEX, moved, Fineness.fine), atol=1e-6 * found.max())


def test_predictions_are_smooth_in_every_unknown() -> None:
    """Half a step changes half as much: derivatives are no artefact of a grid that jumps."""
    vector = vector_of(PLAN, ("geometry", "focal_lengths", "lenslet_spherical", "iris", "wavefront", "crosstalk"))

    def model(u: np.ndarray) -> np.ndarray:
        return predict(vector.setup_at(u), PLAN, INDEX, STILL, Fineness.coarse).astype(float)

    base = model(np.zeros(len(vector)))
    for one, u in zip(vector.unknowns, np.eye(len(vector)), strict=True):
        assert difference((model(0.1 * u) - base) / 0.1, (model(0.05 * u) - base) / 0.05) < 0.06, one.name


@pytest.mark.parametrize(("depth", "cutout", "least"), [(0.0, 21, 4e-3), (2.2, 29, 1.5e-3), (3.5, 15, 1.5e-3)])
@pytest.mark.few(1)
def test_predictions_include_light_beyond_the_shadow(depth: float, cutout: int, least: float) -> None:
    """A grid that ends five pixels beyond it is 1 % off near the native plane, 0.2-0.3 % elsewhere, however fine."""
    plan = small_plan(cutout, (depth,))
    setup = setup_of(plan)
    at = np.array([[0, 3, 5]])
    found = predict(setup, plan, at, np.zeros((1, 2)), Fineness.finest)[0]
    response = PlaneResponse(plan, 0, setup.effects, level="reference", sampling=Sampling(8.0 if depth == 0 else 12.0))
    assert difference(found, response.rows([3], [5])[0, 0]) < least


def test_progress_of_a_plane_counts_its_own_rows() -> None:
    one = few_fit()
    planned = replace(one.planned, depths_um=(one.planned.depths_um[0], 1.02 * one.planned.depths_um[0]))
    fit = replace(one, planned=planned, setup=replace(one.setup, depth_errors_um=(0.0, 0.0)))
    fit = replace(fit, levels=replace(one.levels, gains=np.repeat(one.levels.gains, 2)))
    planes, ny = fit.planes(), planned.period[0]
    zeros = partial(np.zeros, planes.header.shape[1:], np.float32)
    for alone, stage, first, total in ((True, "model plane 1", 0, ny), (False, "model", ny, 2 * ny)):
        records = list(planes.iter_plane(1, zeros, 1, alone=alone))
        assert [one.done for one in records] == list(range(first, first + ny + 1))
        assert {(one.stage, one.total) for one in records} == {(stage, total)}


TINY = small_plan(5, (2.2, 2.7))
N, M = 6, 25
SIX = np.array([[z, 2 * k, 3 * k] for z in (0, 1) for k in range(3)])
PLANES = SIX[:, 0]


def noisy_problem(seed: int = 0, noise: tuple[float, float] = (4.0, 0.5)):
    rng = np.random.default_rng(seed)
    model = rng.uniform(0, 1, (N, M)).astype(np.float32)
    gains, backgrounds = np.array([300.0, 200.0]), np.array([5.0, -3.0])
    light = model * gains[PLANES, None]
    data = light + backgrounds[PLANES, None] + np.sqrt(noise[0] + noise[1] * light) * rng.standard_normal((N, M))
    found = replace(measured(TINY, data.reshape(N, 5, 5), SIX, noise), held_out=np.zeros(N, bool))
    return rng, found, model, PatternLevels(gains, backgrounds, np.zeros(N))


def test_gains_and_backgrounds_are_those_of_weighted_least_squares() -> None:
    _, patterns, model, truth = noisy_problem()
    found = levels_of(patterns, model, np.zeros(N), doubtful=False, error=0.0)
    for z in (0, 1):
        own = PLANES == z
        m, d = model[own].ravel().astype(float), patterns.patterns.reshape(N, M)[own].ravel().astype(float)
        weight = 1 / np.sqrt(4.0 + 0.5 * found.gains[z] * m)
        wanted, *_ = np.linalg.lstsq(np.stack([m, np.ones_like(m)], 1) * weight[:, None], d * weight, rcond=None)
        np.testing.assert_allclose([found.gains[z], found.backgrounds[z]], wanted, rtol=2e-3)
    assert np.abs(found.gains - truth.gains).max() < 10


def test_weights_are_by_the_model_and_not_by_the_data() -> None:
    """Weights by the data make bright noise count less: chi² of a true model falls below 1."""
    rng = np.random.default_rng(1)
    n, noise = 400, (9.0, 1.0)
    model = np.full((N, M), 20 / 300, np.float32)
    chi2 = []
    for _ in range(n // N):
        data = rng.poisson(20.0, (N, M)) + 3.0 * rng.standard_normal((N, M))
        patterns = measured(TINY, data.reshape(N, 5, 5), SIX, noise)
        levels = PatternLevels(np.full(2, 300.0), np.zeros(2), np.zeros(N))
        seen = weighed(patterns, model, levels, doubtful=False, error=0.0)
        chi2.append(np.square(seen.residual, dtype=float).mean())
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.03)


def test_wild_pixels_count_linearly() -> None:
    _, patterns, model, levels = noisy_problem()
    patterns.patterns[2, 1, 1] += 1e4
    seen = weighed(patterns, model, levels, doubtful=False, error=0.0)
    far = float(seen.residual[2, 6])
    assert far > 100 and seen.robust[2, 6] ** 2 == pytest.approx(BEND / far, rel=1e-4)
    others = np.square(np.delete(seen.residual[2], 6), dtype=float).sum()
    assert seen.cost[2] == pytest.approx(others + BEND * (2 * far - BEND), rel=1e-5)


@pytest.mark.parametrize(("stage", "lamp"), [(0.0, 0.0), (0.07, 0.0), (0.0, 0.01), (0.07, 0.01)])
def test_eliminating_the_unknowns_of_each_pattern_changes_no_step(stage: float, lamp: float) -> None:
    rng, patterns, model, levels = noisy_problem(2)
    k = 4
    columns = Columns(
        rng.standard_normal((k, N, M)).astype(np.float32), rng.standard_normal((2, N, M)).astype(np.float32)
    )
    seen = weighed(patterns, model, levels, doubtful=False, error=0.0)
    local = Local(0.02 * rng.standard_normal((N, 2)), stage, lamp)
    levels = PatternLevels(levels.gains, levels.backgrounds, 0.001 * rng.standard_normal(N) * (lamp > 0))
    found = normal_equations(columns, model, seen, levels, PLANES, local)
    step = solve(found.matrix, found.gradient)

    # one dense system of everything, priors as further rows
    own = local.count
    rows, right = [], []
    for p, z in enumerate(PLANES):
        weight = (seen.inverse[p] * seen.robust[p]).astype(float)
        block = np.zeros((M, k + 4 + own * N))
        gain = levels.gains[z] * (1 + levels.lamps[p])
        block[:, :k] = (columns.shared[:, p] * gain).T
        block[:, k + z] = model[p] * (1 + levels.lamps[p])
        block[:, k + 2 + z] = 1.0
        parts = [*(columns.displacements[:, p] * gain)] if stage else []  # type: ignore[index]
        parts += [model[p] * levels.gains[z]] if lamp else []
        now = [*local.offsets_px[p]] if stage else []
        now += [levels.lamps[p]] if lamp else []
        known = ([stage] * 2 if stage else []) + ([lamp] if lamp else [])
        for j, part in enumerate(parts):
            block[:, k + 4 + own * p + j] = part
            prior = np.zeros(k + 4 + own * N)
            prior[k + 4 + own * p + j] = 1 / known[j]
            rows.append(prior[None])
            right.append(np.array([-now[j] / known[j]]))
        rows.append(block * weight[:, None])
        right.append(seen.residual[p].astype(float) * seen.robust[p])
    whole, values = np.concatenate(rows), np.concatenate(right)
    wanted, *_ = np.linalg.lstsq(whole, values, rcond=None)
    np.testing.assert_allclose(step, wanted[: k + 4], rtol=1e-4, atol=1e-5 * np.abs(wanted).max())
    for p, (cb, ch) in enumerate(found.solved):
        alone = wanted[k + 4 + own * p : k + 4 + own * (p + 1)]
        np.testing.assert_allclose(ch - cb @ step, alone, rtol=1e-3, atol=1e-6)
    left = np.square(values - whole @ wanted).sum()
    assert found.chi2 - found.change(step) == pytest.approx(left, rel=1e-5)


def test_unknowns_that_no_pattern_shows_stay() -> None:
    matrix = np.diag([1e8, 4.0, 0.0]) + np.array([[0, 1e3, 0], [1e3, 0, 0], [0, 0, 0]])
    found = solve(matrix, np.array([2e8, 8.0, 0.0]))
    np.testing.assert_allclose(matrix @ found, [2e8, 8.0, 0.0], rtol=1e-9)
    assert found[2] == 0
