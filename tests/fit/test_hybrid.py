"""The hybrid H: the model where that suffices, nearer to the truth where it does not, and it says how near."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest

from benchmarks._fit_cameras import random_truth
from lfcal.base.errors import InputError
from lfcal.base.progress import drain
from lfcal.fit import Fit, fit_camera, measured_of
from lfcal.fit._residual_field import PlaneResiduals
from lfcal.fit.files import iter_write_hybrid
from lfcal.fit.hybrid import HybridSummary, _significant_nuisance
from lfcal.fit.model import Fineness, predict
from lfcal.fit.model_error import ModelError
from lfcal.fit.nuisance import Spread
from lfcal.psf import PSFMatrix, open_psf, save, verify
from lfcal.psf.facts import Facts, Origin
from tests.fit.common import few_fit, few_patterns, measured, setup_of, small_plan, some_index
from tests.fit.test_incomplete import ABERRATED, COUNT, PEAK, READ, SIZE, ghosted, outcome, tilted

PLAN = replace(small_plan(15, (2.2,)), period=(8, 12))
NOISE = (64.0, 1.0)
EVERY = np.argwhere(np.ones(PLAN.shape[:3], bool))


@cache
def unit() -> np.ndarray:
    """Return the patterns of all positions without noise, as shares of the light."""
    return predict(setup_of(PLAN), PLAN, EVERY, np.zeros((len(EVERY), 2)), Fineness.finest).astype(float)


def light() -> np.ndarray:
    """Return the same, of the brightest pixel 16,000."""
    return 16000 * np.maximum(unit(), 0) / unit().max()


@cache
def whole() -> Fit:
    """Return a fit of a few of them; what it is not told is taken for noise."""
    few = some_index(PLAN, 12)
    at = np.ravel_multi_index(few.T, PLAN.shape[:3])
    rng = np.random.default_rng(1)
    data = rng.poisson(light()[at]) + 8.0 * rng.standard_normal((len(few), *PLAN.cutout))
    return fit_camera(measured(PLAN, data, few, NOISE), unknowns=["geometry"], workers=1)


@cache
def modelled() -> np.ndarray:
    """Return H of that fit."""
    return np.asarray(whole().model(workers=1))


def scan(values: np.ndarray, seed: int = 3, *, every: int = 1) -> PSFMatrix:
    """Return an H of all positions, or one of ``every``, with noise."""
    rng = np.random.default_rng(seed)
    out, recorded = np.zeros(PLAN.shape, np.float32), np.zeros(PLAN.shape[:3], int)
    keep = EVERY[::every]
    noisy = rng.poisson(np.maximum(values[::every], 0)) + 8.0 * rng.standard_normal((len(keep), *PLAN.cutout))
    out[tuple(keep.T)], recorded[tuple(keep.T)] = noisy, 1
    noise = np.tile(NOISE, (*PLAN.shape[:3], 1))
    facts = Facts.of(PLAN.shape[:3], PLAN.cutout, recorded=recorded, noise=noise)
    return PSFMatrix(out, depths=PLAN.depths_um, camera=PLAN.camera, anchor=PLAN.anchor, facts=facts)


def off(values: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.square(values - truth).sum() / np.square(truth).sum()))


def stated(H: PSFMatrix, z: int = 0) -> np.ndarray:
    ny, nx = H.period
    return np.stack([[H.uncertainty(z, y, x) for x in range(nx)] for y in range(ny)])


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 4])
def test_where_the_model_suffices_the_hybrid_is_the_model(seed: int) -> None:
    fit = whole()
    model = modelled()
    truth = light().reshape(PLAN.shape)
    H = fit.hybrid(scan(light(), seed), workers=1)
    assert off(np.asarray(H), truth) < 1.05 * off(model, truth)
    assert H.facts.origin is not None and (H.facts.origin == Origin.MODEL).all()
    assert H.provenance["hybrid"]["hybrid"] == 0 and H.provenance["hybrid"]["change"] == 0.0
    lit = model > 0.03 * model.max()
    pull = np.sqrt(np.mean(np.square((np.asarray(H) - truth)[lit] / stated(H)[None][lit])))
    assert 0.3 < pull < 1.5


def test_a_ghost_that_the_model_lacks_is_in_the_hybrid() -> None:
    fit = whole()
    ghost = ghosted(light()).reshape(PLAN.shape)
    H = fit.hybrid(scan(ghost.reshape(light().shape)), workers=1)
    recorded, model = np.asarray(scan(ghost.reshape(light().shape))), modelled()
    error = off(np.asarray(H), ghost)
    assert error < 0.5 * off(model, ghost) and error < 0.5 * off(recorded, ghost)
    lit = model > 0.03 * model.max()
    pull = np.sqrt(np.mean(np.square((np.asarray(H) - ghost)[lit] / stated(H)[None][lit])))
    # nearly all of the residual is told by neighbours here, more than is stated
    assert 0.6 < pull < 1.3
    summary = H.provenance["hybrid"]
    assert summary["hybrid"] == len(EVERY) and summary["between"] == 0 and 0.01 < summary["change"] < 0.03


@pytest.mark.long
def test_positions_between_recorded_ones_follow_them_and_say_so() -> None:
    fit = whole()
    ghost = ghosted(light()).reshape(PLAN.shape)
    some = scan(ghost.reshape(light().shape), every=3)
    H = fit.hybrid(some, workers=1)
    between = H.recorded == 0
    np.testing.assert_array_equal(H.recorded, some.recorded)
    assert off(np.asarray(H)[between], ghost[between]) < 0.8 * off(modelled()[between], ghost[between])
    assert H.facts.origin is not None and (H.facts.origin[between] == Origin.HYBRID).mean() > 0.9
    assert H.provenance["hybrid"]["between"] > 0.9 * between.sum()
    # they are less sure
    assert np.square(stated(H)[between[0]]).mean() > 1.02 * np.square(stated(H)[~between[0]]).mean()


def test_an_outlier_is_left_to_the_model_and_marked() -> None:
    data = scan(light())
    values = np.asarray(data).copy()
    values[0, 4, 7] = np.roll(values[0, 4, 7], 4, axis=1)
    spoilt = PSFMatrix(values, depths=data.depths, camera=data.camera, anchor=data.anchor, facts=data.facts)
    H = whole().hybrid(spoilt, workers=1)
    assert H.facts.origin is not None and H.facts.origin[0, 4, 7] == Origin.OUTLIER
    assert (H.facts.origin == Origin.OUTLIER).sum() == H.provenance["hybrid"]["outliers"] == 1
    np.testing.assert_array_equal(H[0, 4, 7], modelled()[0, 4, 7])


@pytest.mark.long
def test_what_belongs_to_single_patterns_is_no_part_of_it() -> None:
    """Lamp and displaced sources differ from position to position; the ghost that all share stays."""
    rng = np.random.default_rng(9)
    beside = 0.03 * rng.standard_normal((len(EVERY), 2))
    moved = predict(setup_of(PLAN), PLAN, EVERY, beside, Fineness.finest).astype(float)
    lamp = 1 + 0.02 * rng.standard_normal((len(EVERY), 1, 1))
    data = scan(ghosted(16000 * np.maximum(moved, 0) / unit().max()) * lamp)
    ghost = ghosted(light()).reshape(PLAN.shape)
    unaware = whole().hybrid(data, workers=1)
    H = replace(whole(), spread=Spread(0.03, 0.02)).hybrid(data, workers=1)
    assert off(np.asarray(H), ghost) < 0.6 * off(np.asarray(unaware), ghost)
    assert off(np.asarray(H), ghost) < 0.7 * off(modelled(), ghost)


def test_what_the_model_lacks_is_not_taken_for_lamp_or_stage() -> None:
    """They are taken out where they make half of the model's error or more: less may be the ghost's share of light."""
    fit = replace(whole(), held_out_error=ModelError(0.016**2, 1e-6, 0.001, 5))
    plane = modelled()[0]
    own = np.ones(PLAN.period, bool)
    data = PlaneResiduals(plane, 0 * plane, np.ones_like(plane), own, True)
    matters = partial(_significant_nuisance, data=data, places=np.argwhere(own))
    assert matters(replace(fit, spread=Spread(0.0, 0.007))) == (False, False)
    assert matters(replace(fit, spread=Spread(0.0, 0.009))) == (True, False)
    # a pixel of displacement changes a pattern by so much of its light
    still, moved = (
        predict(fit.ideal_places, PLAN, EVERY[::5], np.full((len(EVERY[::5]), 2), by), Fineness.fine)
        for by in (0.0, 0.05)
    )
    per_px = off(moved, still) / 0.05 / np.sqrt(2)
    assert matters(replace(fit, spread=Spread(0.004 / per_px, 0.0))) == (False, False)
    assert matters(replace(fit, spread=Spread(0.016 / per_px, 0.0))) == (False, True)


@pytest.mark.long
def test_a_ghost_stays_whole_where_a_fit_took_some_of_it_for_lamp_and_stage() -> None:
    fit = replace(whole(), held_out_error=ModelError(0.016**2, 1e-6, 0.001, 5))
    still, moved = (
        predict(fit.ideal_places, PLAN, EVERY[::5], np.full((len(EVERY[::5]), 2), by), Fineness.fine)
        for by in (0.0, 0.05)
    )
    per_px = off(moved, still) / 0.05 / np.sqrt(2)
    ghost = scan(ghosted(light()))
    steady, taken = (
        np.asarray(replace(fit, spread=spread).hybrid(ghost, workers=1))
        for spread in (Spread(0.0, 0.0), Spread(0.002 / per_px, 0.006))
    )
    np.testing.assert_array_equal(taken, steady)


def test_patterns_that_were_fitted_do_as_well() -> None:
    H = few_fit().hybrid(measured_of(few_patterns()), workers=1)
    np.testing.assert_array_equal(H.recorded, few_patterns().recorded)
    np.testing.assert_allclose(np.asarray(H), np.asarray(few_fit().model(workers=1)))
    assert str(HybridSummary.of([(H.facts.plane(0), np.zeros((2, 4)))])) == (
        "hybrid H: no position deviates from the model by more than its noise, so it equals the model"
    )


def test_it_is_streamed_whole_or_not_at_all_and_read_back(tmp_path: Path) -> None:
    data = scan(ghosted(light()))
    summary = drain(iter_write_hybrid(whole(), data, tmp_path / "H.h5", provenance={"source": "here"}, workers=1))
    memory = whole().hybrid(data, workers=1)
    check = verify(tmp_path / "H.h5")
    assert check.ok and check.missing == 0
    with open_psf(tmp_path / "H.h5") as H:
        np.testing.assert_array_equal(np.asarray(H), np.asarray(memory))
        assert np.all(stated(H) >= stated(memory) * (1 - 1e-5)) and np.all(stated(H) <= stated(memory) * (1 + 1 / 128))
        assert H.facts.origin is not None and memory.facts.origin is not None
        np.testing.assert_array_equal(H.facts.origin, memory.facts.origin)
        assert H.provenance["source"] == "here" and H.provenance["hybrid"]["change"] == summary.change
        assert "positions changed by" in str(summary)
        # what is partly a model has no noise of its own, and is not fitted again
        assert H.variance(0, 0, 0) is None
        save(H, tmp_path / "copy.h5")
        with open_psf(tmp_path / "copy.h5") as copy:
            np.testing.assert_array_equal(stated(copy), stated(H), "rounded once")
        with pytest.raises(InputError, match="HT"):
            H.T.uncertainty(0, 0, 0)
    work = iter_write_hybrid(whole(), data, tmp_path / "stopped.h5", workers=1)
    for _ in range(9):
        next(work)
    work.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["H.h5", "copy.h5"]


@pytest.mark.parametrize(
    ("change", "what"),
    [
        (lambda H: PSFMatrix(np.asarray(H)[:, :, 1:], depths=H.depths), "patterns .z, y, x, t, s."),
        (lambda H: PSFMatrix(np.asarray(H), depths=H.depths + 9.0, anchor=H.anchor, facts=H.facts), "patterns, depths"),
        (lambda H: PSFMatrix(np.asarray(H), depths=H.depths, anchor=H.anchor), "noise of H"),
        (lambda H: H.T, "those of HT"),
    ],
)
def test_another_scan_is_refused(change: Callable[[PSFMatrix], PSFMatrix], what: str) -> None:
    with pytest.raises(InputError, match=what):
        few_fit().hybrid(change(few_patterns()), workers=1)
    bare = PSFMatrix(
        np.asarray(few_patterns()),
        depths=few_patterns().depths,
        anchor=few_patterns().anchor,
        recorded=few_patterns().recorded,
    )
    assert few_fit().hybrid(bare, noise=NOISE, workers=1).shape == bare.shape


# -- incomplete models that were fitted ------------------------------------------------------------------


INCOMPLETE = small_plan(SIZE)


@cache
def truths(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Return neighbouring positions of a plane and their light, in the units of `outcome`'s patterns."""
    index = np.array([(0, y, x) for y in range(5, 15) for x in range(8, 24)])
    setup = random_truth(INCOMPLETE, np.random.default_rng(5), size=0.0).setup
    true = setup.with_effect(ABERRATED) if kind == "aberration" else setup
    fitted = some_index(INCOMPLETE, COUNT + 10)

    def of(which: np.ndarray) -> np.ndarray:
        if kind == "tilt":
            return tilted(INCOMPLETE, true, which)
        return predict(true, INCOMPLETE, which, np.zeros((len(which), 2)), Fineness.finest).astype(float)

    scale = PEAK / of(fitted).max()
    light = np.maximum(of(index), 0)
    return index, scale * (ghosted(light) if kind == "ghost" else light)


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "light", "better", "most"),
    [
        ("none", 1.0, 2.0, 1.3),
        ("ghost", 1.0, 2.0, 1.3),
        ("tilt", 1.0, 2.0, 1.3),
        # so large an error a recorded pattern of much light tells nearly all of
        ("aberration", 1.0, 1.2, 1.3),
        # of little light the dim pixels' share is told too small
        ("aberration", 0.1, 2.0, 1.5),
    ],
)
def test_incomplete_models_that_were_fitted(kind: str, light: float, better: float, most: float) -> None:
    """With noise that neither fit nor estimate have seen; truth by the reference, or by what no lfcal effect does."""
    fit, (index, truth) = outcome(kind).fit, truths(kind)
    truth = light * truth
    fit = replace(
        fit, levels=replace(fit.levels, gains=light * fit.levels.gains, backgrounds=light * fit.levels.backgrounds)
    )
    truth = truth - fit.levels.backgrounds[0]
    model = predict(fit.ideal_places, INCOMPLETE, index, np.zeros((len(index), 2)), Fineness.finest)
    model = fit.levels.gains[0] * model
    for seed in (21, 22):
        rng = np.random.default_rng(seed)
        data = rng.poisson(np.maximum(truth, 0)) + READ * rng.standard_normal(truth.shape)
        patterns = data + fit.levels.backgrounds[0]
        H = fit.hybrid(measured(INCOMPLETE, patterns, index, (READ**2, 1.0)), workers=1)
        values = np.stack([H[z, y, x] for z, y, x in index.tolist()])
        error, alone, recorded = off(values, truth), off(model, truth), off(data, truth)
        sigma = np.stack([H.uncertainty(z, y, x) for z, y, x in index.tolist()])
        lit = model > 0.03 * model.max()
        pull = float(np.sqrt(np.mean(np.square((values - truth)[lit] / sigma[lit]))))
        print(f"{kind}: hybrid {error:.2%}, model {alone:.2%}, pattern {recorded:.2%}, pull {pull:.2f}")
        assert better * error < recorded and 0.8 < pull < most
        assert error < (1.05 if kind == "none" else 0.8) * alone
