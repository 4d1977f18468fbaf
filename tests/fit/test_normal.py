"""Weights, gains and normal equations, against dense least squares that share none of their code."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfcal.fit._weighing import BEND, PatternLevels, levels_of, weighed
from lfcal.fit.normal import Columns, Local, normal_equations
from lfcal.fit.solver import solve
from tests.fit.common import measured, small_plan

PLAN = small_plan(5, (2.2, 2.7))
N, M = 6, 25
INDEX = np.array([[z, 2 * k, 3 * k] for z in (0, 1) for k in range(3)])
PLANES = INDEX[:, 0]


def problem(seed: int = 0, noise: tuple[float, float] = (4.0, 0.5)):
    rng = np.random.default_rng(seed)
    model = rng.uniform(0, 1, (N, M)).astype(np.float32)
    gains, backgrounds = np.array([300.0, 200.0]), np.array([5.0, -3.0])
    light = model * gains[PLANES, None]
    data = light + backgrounds[PLANES, None] + np.sqrt(noise[0] + noise[1] * light) * rng.standard_normal((N, M))
    found = replace(measured(PLAN, data.reshape(N, 5, 5), INDEX, noise), held_out=np.zeros(N, bool))
    return rng, found, model, PatternLevels(gains, backgrounds, np.zeros(N))


def test_gains_and_backgrounds_are_those_of_weighted_least_squares() -> None:
    _, patterns, model, truth = problem()
    found = levels_of(patterns, model, np.zeros(N), doubtful=False, error=0.0)
    for z in (0, 1):
        own = PLANES == z
        m, d = model[own].ravel().astype(float), patterns.patterns.reshape(N, M)[own].ravel().astype(float)
        weight = 1 / np.sqrt(4.0 + 0.5 * found.gains[z] * m)
        wanted, *_ = np.linalg.lstsq(np.stack([m, np.ones_like(m)], 1) * weight[:, None], d * weight, rcond=None)
        np.testing.assert_allclose([found.gains[z], found.backgrounds[z]], wanted, rtol=2e-3)
    assert np.abs(found.gains - truth.gains).max() < 10


def test_weights_are_the_model_s_and_not_the_data_s() -> None:
    """Weights by the data make bright noise count less: chi² of a true model falls below 1."""
    rng = np.random.default_rng(1)
    n, noise = 400, (9.0, 1.0)
    model = np.full((N, M), 20 / 300, np.float32)
    chi2 = []
    for _ in range(n // N):
        data = rng.poisson(20.0, (N, M)) + 3.0 * rng.standard_normal((N, M))
        patterns = measured(PLAN, data.reshape(N, 5, 5), INDEX, noise)
        seen = weighed(
            patterns, model, PatternLevels(np.full(2, 300.0), np.zeros(2), np.zeros(N)), doubtful=False, error=0.0
        )
        chi2.append(np.square(seen.residual, dtype=float).mean())
    assert np.mean(chi2) == pytest.approx(1.0, abs=0.03)


def test_wild_pixels_count_linearly() -> None:
    _, patterns, model, levels = problem()
    patterns.patterns[2, 1, 1] += 1e4
    seen = weighed(patterns, model, levels, doubtful=False, error=0.0)
    far = float(seen.residual[2, 6])
    assert far > 100 and seen.robust[2, 6] ** 2 == pytest.approx(BEND / far, rel=1e-4)
    others = np.square(np.delete(seen.residual[2], 6), dtype=float).sum()
    assert seen.cost[2] == pytest.approx(others + BEND * (2 * far - BEND), rel=1e-5)


@pytest.mark.parametrize(("stage", "lamp"), [(0.0, 0.0), (0.07, 0.0), (0.0, 0.01), (0.07, 0.01)])
def test_eliminating_each_pattern_s_own_unknowns_changes_no_step(stage: float, lamp: float) -> None:
    rng, patterns, model, levels = problem(2)
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


def test_what_no_pattern_shows_stays_where_it_is() -> None:
    matrix = np.diag([1e8, 4.0, 0.0]) + np.array([[0, 1e3, 0], [1e3, 0, 0], [0, 0, 0]])
    found = solve(matrix, np.array([2e8, 8.0, 0.0]))
    np.testing.assert_allclose(matrix @ found, [2e8, 8.0, 0.0], rtol=1e-9)
    assert found[2] == 0
