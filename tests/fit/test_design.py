"""Positions chosen by the expected error of H: the algebra by brute force, and what fits of them reach."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from benchmarks._fit_cameras import random_truth, recorded
from benchmarks.fit import measured_error
from lfcal.base.errors import FileFormatError, InputError
from lfcal.base.progress import drain
from lfcal.camera import Forecast
from lfcal.fit import Fit, fit_camera
from lfcal.fit.design import Chosen, PositionDesign, choose, draw_design, next_positions
from lfcal.fit.earlier import Earlier, read_earlier
from lfcal.fit.files import effects_text, fit_dict, json_text, measured_camera
from lfcal.fit.information import PRIOR_SIGMA, Expected, Information, iter_information
from lfcal.fit.model import Fineness, predict
from lfcal.fit.parameters import Unknown
from lfcal.fit.spread import spread_out
from tests.fit.common import CORE, few_fit, setup_of, small_plan, some_index, vector_of

SMALL = small_plan(15, (2.2,))
TWO = small_plan(15, (2.2, 2.7))


def random_information(
    seed: int, n: int = 9, k: int = 4, planes: int = 2, m: int = 30
) -> tuple[Information, np.ndarray]:
    """Return information of patterns with random derivatives, and these ``(n, k + 2, m)``, gain and background last."""
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((n, k + 2, m)) * rng.uniform(0.1, 2.0, (n, k + 2, 1))
    rows[:, k] += 2.0
    index = np.stack([np.arange(n) % 2, np.zeros(n, int), np.arange(n)], axis=1)
    wanted = rng.standard_normal((k, 2 * k))
    unknowns = tuple(Unknown(f"u{i}", "none", "", 0.0, 1.0) for i in range(k))
    known = np.einsum("nim,njm->nij", rows, rows)
    return Information(index, unknowns, known, wanted @ wanted.T, np.diag(np.full(k, 0.3)), 1.0), rows


def brute_error(known: Information, rows: np.ndarray, chosen: list[int]) -> float:
    """Return the error from one matrix over all unknowns, gains and backgrounds."""
    k, nz = len(known.unknowns), 2
    whole = np.zeros((k + 2 * nz, k + 2 * nz))
    whole[:k, :k] = known.prior
    for p in chosen:
        z = known.index[p, 0]
        jacobian = np.zeros((rows.shape[2], k + 2 * nz))
        jacobian[:, :k], jacobian[:, k + 2 * z], jacobian[:, k + 2 * z + 1] = rows[p, :k].T, rows[p, k], rows[p, k + 1]
        whole += jacobian.T @ jacobian
    return float(np.sqrt(np.trace(np.linalg.pinv(whole)[:k, :k] @ known.wanted)))


def test_the_error_of_a_set_is_that_of_one_large_matrix() -> None:
    known, rows = random_information(0)
    chosen = Chosen(known)
    chosen.add(0, 3, 4, 7, 8)
    assert chosen.error == pytest.approx(brute_error(known, rows, [0, 3, 4, 7, 8]), rel=1e-9)
    squares = chosen.trials(np.array([1, 2, 5]))
    for p, square in zip((1, 2, 5), squares, strict=True):
        assert np.sqrt(square) == pytest.approx(brute_error(known, rows, [0, 3, 4, 7, 8, p]), rel=1e-9)
    # taken away again, down to an empty plane: nothing of it is left over
    for p in (3, 7):
        chosen.remove(p)
    assert chosen.error == pytest.approx(brute_error(known, rows, [0, 4, 8]), rel=1e-9)
    assert np.sqrt(chosen.trials(np.array([1]))[0]) == pytest.approx(brute_error(known, rows, [0, 4, 8, 1]), rel=1e-9)


def test_exchange_ends_at_or_near_the_best_of_all_sets() -> None:
    for seed in range(6):
        known, rows = random_information(seed)
        found = choose(known, 4, np.arange(9))
        errors = {subset: brute_error(known, rows, list(subset)) for subset in combinations(range(9), 4)}
        assert len(set(found)) == 4
        assert errors[tuple(sorted(found))] <= 1.01 * min(errors.values()) < 0.95 * np.median(list(errors.values()))
        # the most useful position comes first
        assert found[0] == min(found, key=lambda p: brute_error(known, rows, [p])), seed
    assert set(choose(known, 3, np.array([0, 2, 4, 6]))) < {0, 2, 4, 6}
    assert sorted(choose(known, 9, np.array([1, 3, 5]))) == [1, 3, 5]


def test_information_of_patterns_is_that_of_dense_least_squares() -> None:
    """The covariance from dense matrices: derivatives by central differences, each source's displacement a column."""
    expected = Expected(full=0.5, stage_px=0.02, lamp=0.01, response=0.02)
    index = some_index(TWO, 6)
    plan = replace(TWO, exposure_s=(0.02, 0.04), frames_averaged=2)
    known = drain(iter_information(plan, index, setup_of(plan), CORE, expected, workers=1))
    chosen = Chosen(known)
    chosen.add(*range(6))
    vector = vector_of(plan, CORE)
    k = len(vector)

    def model(u: np.ndarray, offset: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
        found = predict(vector.setup_at(u), plan, index, np.tile(offset, (6, 1)), Fineness.coarse)
        return found.reshape(6, -1).astype(float)

    def slope(step: np.ndarray) -> np.ndarray:
        return (model(0.05 * step) - model(-0.05 * step)) / 0.1

    light = model(np.zeros(k))
    times, sensor = np.array([0.02, 0.04])[index[:, 0]], plan.camera.sensor
    gain = 0.5 * sensor.full_well_e * times / (light.max(1) * times).max()
    by = np.stack([slope(step) for step in np.eye(k)])
    aside = np.stack(
        [(model(np.zeros(k), b) - model(np.zeros(k), (-b[0], -b[1]))) / 0.04 for b in ((0.02, 0), (0, 0.02))]
    )
    constant = sensor.read_noise_e**2 + 0.04 * sensor.dark_current_e_s + sensor.electrons_per_count**2 / 12
    columns = k + 4 + 3 * 6
    whole = np.zeros((columns, columns))
    whole[:k, :k] = np.eye(k) / PRIOR_SIGMA**2
    for p, z in enumerate(index[:, 0]):
        jacobian = np.zeros((light.shape[1], columns))
        jacobian[:, :k] = gain[p] * by[:, p].T
        jacobian[:, k + 2 * z], jacobian[:, k + 2 * z + 1] = light[p], 1.0
        own = k + 4 + 3 * p
        jacobian[:, own : own + 2], jacobian[:, own + 2] = gain[p] * aside[:, p].T, gain[p] * light[p]
        shine = gain[p] * light[p]
        # half the variance of two frames' mean; uneven pixels and the engine's own error at the coarse sampling, too
        variance = (constant + shine) / 2 + (0.02**2 + 4e-3**2) * shine**2
        whole += jacobian.T @ (jacobian / variance[:, None])
        whole[own : own + 3, own : own + 3] += np.diag([0.02**-2, 0.02**-2, 0.01**-2])
    wanted = np.linalg.pinv(whole)[:k, :k]
    np.testing.assert_allclose(np.diag(chosen.covariance), np.diag(wanted), rtol=0.05)
    squares, power = np.zeros((k, k)), 0.0
    for z in (0, 1):
        d, m = by[:, index[:, 0] == z].reshape(k, -1), light[index[:, 0] == z].ravel()
        squares, power = squares + d @ d.T - np.outer(d @ m, d @ m) / (m @ m), power + m @ m
    assert chosen.error == pytest.approx(np.sqrt(np.trace(wanted @ squares) / power), rel=0.03)
    noise = ((constant + gain[:, None] * light) / 2 / gain[:, None] ** 2).sum()
    assert known.pattern_error == pytest.approx(np.sqrt(noise / power), rel=1e-3)


@cache
def small_design() -> PositionDesign:
    return next_positions(SMALL, 15, candidates=80, workers=1)


@cache
def fitted(seed: int) -> tuple[Fit, float]:
    """Return a fit of the design's positions and the true error of its model."""
    rng = np.random.default_rng(seed)
    truth, design = random_truth(SMALL, rng, size=0.0), small_design()
    measured = recorded(truth, 15, rng, index=design.positions)
    aside = np.arange(15) >= len(design.fitted)
    fit = fit_camera(replace(measured, held_out=aside), unknowns=CORE, stage=0.0, workers=1)
    return fit, measured_error(fit, truth, 40)["error_l2"]


@pytest.mark.long
@pytest.mark.parametrize("cameras", [1, 5])
def test_the_expected_error_is_what_fits_reach(cameras: int) -> None:
    reached = np.sqrt(np.mean([fitted(seed)[1] ** 2 for seed in range(cameras)]))
    assert small_design().curve[-1].error / 1.3 < reached < 1.3 * small_design().curve[-1].error


def test_chosen_positions_are_better_than_evenly_spread_ones() -> None:
    design = small_design()
    assert design.fitted.shape == (12, 3) and design.held_out.shape == (3, 3) and design.candidates == 80
    assert len(np.unique(design.positions, axis=0)) == 15
    counts, errors = [p.positions for p in design.curve], [p.error for p in design.curve]
    assert counts[0] == 3 and counts[-1] == 15 and (np.diff(errors) <= 0).all()
    assert all(p.error < p.spread_error for p in design.curve)
    assert errors[-1] < 0.2 * design.pattern_error and design.start_error is None
    assert (np.diff([p.hours for p in design.curve]) > 0).all() and design.curve[-1].hours < Forecast.of(SMALL).hours
    assert design.enough_for(errors[3]) == design.curve[3] and design.enough_for(0.0) is None
    # those kept aside lie far apart
    apart = np.abs(design.held_out[:, None, 1:] - design.held_out[None, :, 1:])
    apart = np.minimum(apart, np.array(SMALL.period) - apart)
    assert np.hypot(apart[..., 0], apart[..., 1])[~np.eye(3, dtype=bool)].min() > 6


@pytest.mark.long
def test_the_next_positions_continue_from_an_earlier_fit(tmp_path: Path) -> None:
    fit, _ = fitted(0)
    earlier = Earlier.of(fit)
    design = next_positions(SMALL, 5, earlier=earlier, candidates=30, workers=1)
    assert design.start_error == pytest.approx(small_design().curve[-1].error, rel=0.15)
    assert all(p.error < design.start_error for p in design.curve) and set(design.sigmas) == set(fit.parameters)
    assert not set(map(tuple, earlier.positions.tolist())) & set(map(tuple, design.positions.tolist()))
    assert all(design.sigmas[name] < one.sigma for name, one in fit.parameters.items())
    other = replace(SMALL, depths_um=(SMALL.depths_um[0] + 50.0,))
    with pytest.raises(InputError, match="as in the earlier fit"):
        next_positions(other, 5, earlier=earlier)
    # read from its folder it is the same
    found = read_earlier(folder_of(fit, tmp_path / "fit"))
    assert (found.setup.effects, found.groups, found.names) == (earlier.setup.effects, earlier.groups, earlier.names)
    assert found.setup.camera.lattice == earlier.setup.camera.lattice and found.spread == earlier.spread
    for name in ("positions", "correlations", "sigmas"):
        np.testing.assert_allclose(getattr(found, name), getattr(earlier, name))


@pytest.mark.long
def test_the_information_of_an_earlier_fit_is_its_inverse_covariance() -> None:
    fit, _ = fitted(0)
    unknowns = vector_of(SMALL, CORE).unknowns
    scales = np.array([one.scale for one in unknowns])
    sigmas = np.array([fit.parameters[one.name].sigma_held for one in unknowns])
    covariance = fit.correlations * np.outer(sigmas, sigmas) / np.outer(scales, scales)
    found = Earlier.of(fit).information(unknowns)
    np.testing.assert_allclose(found @ covariance, np.eye(len(unknowns)), atol=1e-6)
    # none about an unknown that was not fitted, and that with the others free about some unknowns alone
    extra = Unknown("other", "none", "", 0.0, 1.0)
    part = Earlier.of(fit).information([extra, *unknowns[:3]])
    assert not part[0].any() and not part[:, 0].any()
    np.testing.assert_allclose(part[1:, 1:] @ covariance[:3, :3], np.eye(3), atol=1e-6)


def folder_of(fit: Fit, place: Path) -> Path:
    place.mkdir()
    (place / "camera.json").write_text(measured_camera(fit).to_json())
    (place / "effects.json").write_text(effects_text(fit))
    (place / "fit.json").write_text(json_text(fit_dict(fit)))
    return place


def test_damaged_fits_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the folder of a fit, got a folder without camera\.json"):
        read_earlier(tmp_path)
    with pytest.raises(InputError, match="the folder of a fit, got no such folder"):
        read_earlier(tmp_path / "nowhere")
    with pytest.raises(InputError, match="the folder of a fit, got a file"):
        read_earlier(Path(__file__))
    place = folder_of(few_fit(), tmp_path / "fit")
    data = json.loads((place / "fit.json").read_text())
    for change, what in (
        ({"format": "other"}, '"format": "lfcal-fit"'),
        ({"parameters": []}, "expected correlations of 0 parameters"),
        ({"correlations": None}, "expected correlations of"),
        ({"positions": "none"}, "a result of lfcal fit"),
        ({"spread": {}}, "a result of lfcal fit"),
        ({"stage_scale": "x"}, "a result of lfcal fit"),
    ):
        (place / "fit.json").write_text(json.dumps(data | change))
        with pytest.raises((FileFormatError, InputError), match=what):
            read_earlier(place)


def test_impossible_choices_are_refused() -> None:
    for count, more, what in (
        (2, {}, "positions to record: expected a whole number ≥ 3"),
        (10_000, {}, "at most the 627 remaining"),
        (5, {"groups": ["gap"]}, "unknowns: expected"),
        (5, {"candidates": -1}, "candidate positions"),
    ):
        with pytest.raises(InputError, match=what):
            next_positions(SMALL, count, **more)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="full well"):
        Expected(full=1.5)


def test_the_curve_is_drawn(tmp_path: Path) -> None:
    draw_design(replace(small_design(), start_error=0.02), tmp_path / "curve.png", 627, 1.0)
    assert (tmp_path / "curve.png").stat().st_size > 10_000


def test_positions_are_spread_away_from_earlier_ones() -> None:
    every = np.argwhere(np.ones(SMALL.shape[:3], bool))
    first = every[spread_out(every, 6, SMALL.period)]
    found = every[spread_out(every, 4, SMALL.period, first)]
    apart = np.abs(found[:, None, 1:] - first[None, :, 1:])
    apart = np.minimum(apart, np.array(SMALL.period) - apart)
    assert np.hypot(apart[..., 0], apart[..., 1]).min() > 4 and not spread_out(every, 0, SMALL.period, first).size
