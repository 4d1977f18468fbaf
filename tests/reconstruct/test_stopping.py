"""Runs that stop by themselves, by pixels they leave out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, uniform_filter

from lfcal.base.errors import InputError
from lfcal.reconstruct import Projector
from lfcal.reconstruct.phantoms import nrmse, phantom
from lfcal.reconstruct.solvers._em import EmOptions, iter_run
from lfcal.reconstruct.solvers.choice import SOLVERS, SolverChoice, iter_reconstruct, reconstruct
from lfcal.reconstruct.solvers.measurement import Measurement
from lfcal.reconstruct.solvers.records import SolverWork
from lfcal.reconstruct.solvers.solver import COMMON, Solver, SolverRun
from lfcal.reconstruct.solvers.stopping import SHARE, held_out_pixels, misfit
from tests.reconstruct.oracles import dense, lenslet_psf

SHAPE = (100, 95)


@pytest.fixture(scope="module")
def noisy():
    """Return a projector, a true volume and an image of few photons on a background of 2."""
    P = Projector(lenslet_psf(), SHAPE, (1, 3))
    truth = phantom("vesicle", P.volume_shape) * 60
    image = np.random.default_rng(0).poisson(np.maximum(P.forward(truth), 0) + 2).astype(float)
    return P, truth, image


def with_margin(P, margin):
    shape = tuple(n + 2 * margin for n in SHAPE)
    return Projector(lenslet_psf(), shape, (1 + margin, 3 + margin)) if margin else P


def test_held_out_pixels_are_few_and_the_same_each_time():
    mask = held_out_pixels((300, 200))
    assert mask.mean() == pytest.approx(SHARE, rel=0.1)
    assert np.array_equal(mask, held_out_pixels((300, 200)))
    rows, columns = (mask[:, k::15].mean() for k in range(2)), (mask[k::15].mean() for k in range(2))
    assert all(0.5 * SHARE < share < 1.6 * SHARE for share in (*rows, *columns)), "no view is spared"


def test_held_out_pixels_are_predicted_and_not_fitted():
    """By plain algebra: Richardson-Lucy of the other pixels, and the likelihood of these."""
    rng = np.random.default_rng(0)
    H = rng.random((2, 3, 2, 5, 5))
    P, A = Projector(H, (9, 8), (1, 0), dtype=np.float64), dense(H, (9, 8), (1, 0))
    f, b = rng.uniform(1, 20, 72), 0.7
    weights = rng.uniform(0.5, 1, 72)
    held = rng.random(72) < 0.2
    w = weights * ~held
    g = np.full(A.shape[1], (w * (f - b)).sum() / (A.T @ w).sum())
    predicted = []
    for _ in range(3):
        m = A @ g + b
        predicted.append(-(weights * held * (f * np.log(f / m) - f + m)).sum())
        g = g / (A.T @ w) * (A.T @ (w * f / m))
    run = SolverRun(3, weights=weights.reshape(9, 8), background=b, held_out=held.reshape(9, 8))
    for subsets in (None, (np.ones((3, 2), bool),)):
        work = iter_run(P, f.reshape(9, 8), run, EmOptions(subsets=subsets))
        records = list(work)
        np.testing.assert_allclose([r.held_out for r in records], predicted, rtol=1e-9)
        np.testing.assert_allclose(records[-1].state.volume.ravel(), g, rtol=1e-9)
    spoilt = np.where(held, 1e9, f).reshape(9, 8)
    *_, last = iter_run(P, spoilt, run, EmOptions())
    np.testing.assert_allclose(last.state.volume.ravel(), g, rtol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("name", SOLVERS.names())
def test_runs_stop_near_the_smallest_error(noisy, name):
    """Every solver gets within 8 % of the least error it has on the way, whether that is the end or long before."""
    P, truth, image = noisy
    errors = [nrmse(r.state.volume, truth) for r in iter_reconstruct(P, image, SolverChoice(name, 60, 2.0))]
    found = reconstruct(P, image, SolverChoice(name, 60, 2.0, auto=True))
    assert nrmse(found.volume, truth) < 1.08 * min(errors)
    assert found.volume is found.state.volume
    if len(found.history) < 60:
        assert "held-out pixels" in found.stopped
        assert found.state.iteration <= len(found.history)


def test_a_frame_is_measured_once(monkeypatch, noisy):
    """Once for fit and notes; by the discrepancy once more, because negative pixels count there."""
    P, _, image = noisy
    made, whole, image = [], Measurement.of, image.copy()
    monkeypatch.setattr(Measurement, "of", lambda *args, **given: made.append(given) or whole(*args, **given))
    image[3, 4] = np.nan
    for stop, most in (("left-out", 1), ("discrepancy", 2)):
        made.clear()
        found = reconstruct(P, image, SolverChoice("rl", 3, 2.0, auto=True, stop=stop))
        assert len(made) == most and any("non-finite" in note for note in found.notes)


@pytest.mark.long
def test_a_method_that_follows_the_noise_is_stopped(noisy):
    P, truth, image = noisy
    long = reconstruct(P, image, SolverChoice("phase-space", 60, 2.0))
    auto = reconstruct(P, image, SolverChoice("phase-space", 60, 2.0, auto=True))
    assert len(auto.history) < 40 and not long.stopped
    assert nrmse(auto.volume, truth) < 0.9 * nrmse(long.volume, truth)
    assert all(np.isfinite(r.held_out) for r in auto.history) and all(np.isnan(r.held_out) for r in long.history)


def test_notes_and_tolerance_are_kept(noisy):
    P, _, image = noisy
    spoilt = image.copy()
    spoilt[3, 4] = np.nan
    found = reconstruct(P, spoilt, SolverChoice("phase-space", 60, 2.0, auto=True))
    assert "1 non-finite pixel was left out" in found.notes
    few = reconstruct(P, image, SolverChoice("rl", 60, 2.0, tolerance=0.5, auto=True))
    assert len(few.history) < 5 and "changed by less than 0.5" in few.stopped


def test_an_automatic_run_is_resumed(noisy):
    P, _, image = noisy
    found = reconstruct(P, image, SolverChoice("rl", 8, 2.0, auto=True))
    more = reconstruct(P, image, SolverChoice("rl", 4, 2.0, auto=True), resume=found.state)
    whole = reconstruct(P, image, SolverChoice("rl", 12, 2.0, auto=True))
    np.testing.assert_array_equal(more.volume, whole.volume)


def test_solvers_of_other_distributions_are_judged_by_their_volumes(noisy, monkeypatch):
    """One that knows nothing of left-out pixels does not see them; one without weights cannot be stopped so."""
    P, _, image = noisy

    def iterate(P: Projector, image: object, run: SolverRun) -> SolverWork:
        assert run.held_out is None and np.count_nonzero(run.weights == 0) == held_out_pixels(SHAPE).sum()
        return SOLVERS.get("phase-space").iterate(P, image, run)

    theirs = Solver("theirs", "of others", iterate)
    monkeypatch.setattr(SolverChoice, "solver", property(lambda self: theirs))
    found = reconstruct(P, image, SolverChoice("theirs", 60, 2.0, auto=True))
    assert "held-out pixels" in found.stopped and len(found.history) < 40
    blind = Solver("blind", "of others", iterate, COMMON - {"weights"})
    monkeypatch.setattr(SolverChoice, "solver", property(lambda self: blind))
    for setting, words in (
        ({"auto": True}, "iterations of solver blind: expected a number, .* got auto; give a number, stop by the disc"),
        ({"margin": 8}, "margin of solver blind: expected 0, .* got 8; set it to 0, or choose .*sieve"),
    ):
        with pytest.raises(InputError, match=words):
            SolverChoice("blind", 60, **setting)
    assert SolverChoice("blind", 60, auto=True, stop="discrepancy").auto


# -- to measure ----------------------------------------------------------------------------------------------
def drawn(kind: str, shape: tuple[int, ...], seed: int) -> np.ndarray:
    """Return beads, lines or a texture ``(3, Y, X)`` away from the edges."""
    rng = np.random.default_rng(seed)
    y, x = np.indices(shape[1:])
    volume = np.zeros(shape)
    if kind == "texture":
        smooth = [gaussian_filter(rng.standard_normal(shape[1:]), 2.5) for _ in range(3)]
        volume[:] = np.clip(10 * np.array(smooth), 0, None) + 0.05
    for _ in range({"beads": 10, "lines": 5, "texture": 0}[kind]):
        z, row, column, angle = rng.integers(3), *rng.uniform(14, 41, 2), rng.uniform(0, np.pi)
        across, along = (y - row) * np.cos(angle) - (x - column) * np.sin(angle), np.hypot(y - row, x - column)
        volume[z] += rng.uniform(0.4, 1) * np.exp(-((along if kind == "beads" else across) ** 2) / 2)
    return volume * ((y >= 8) & (y < 52) & (x >= 8) & (x < 47))


@pytest.mark.few(1)
@pytest.mark.parametrize("kind", ["beads", "lines", "texture"])
def test_a_run_for_measuring_has_better_sums(kind):
    """Errors of sums over 7 x 7 voxels are 0.6 of those of a run for viewing, and errors of voxels hardly larger."""
    P = Projector(lenslet_psf(), (60, 55), (1, 3), workers=1)
    sums: dict[str, list[float]] = {"view": [], "measure": []}
    voxels: dict[str, list[float]] = {"view": [], "measure": []}
    for seed in range(4):
        truth = drawn(kind, P.volume_shape, 100 + seed)
        truth *= 500 / P.forward(truth).max()
        image = np.random.default_rng(seed).poisson(P.forward(truth).clip(0) + 5).astype(float)
        true = uniform_filter(truth, (0, 7, 7))
        bright = true > np.quantile(true[:, 12:-12, 12:-12], 0.8)
        for goal in sums:
            found = reconstruct(P, image, SolverChoice("sieve", 100, 5.0, auto=True, goal=goal)).volume
            mean = uniform_filter(found.astype(float), (0, 7, 7))
            sums[goal].append(float(np.median(np.abs(mean / np.maximum(true, 1e-9) - 1)[bright])))
            voxels[goal].append(nrmse(found, truth))
    assert np.median(sums["measure"]) < 0.8 * np.median(sums["view"])
    assert np.median(voxels["measure"]) < 1.3 * np.median(voxels["view"])


def test_a_run_for_measuring_takes_twice_as_long(noisy):
    """By the records themselves: it ends at twice the iteration whose left-out pixels were predicted best so far."""
    P, _, image = noisy
    found = reconstruct(P, image, SolverChoice("rl-nesterov", 100, 2.0, auto=True, goal="measure"))
    scores = [record.held_out for record in found.history]
    last = found.state.iteration
    # the score in a record is that of the estimate before it; the estimate before the first has none
    best = 1 + int(np.argmax(scores[1 : last + 1]))
    assert last == max(2 * best, best + 3) < 100 and len(found.history) == last + 1
    assert f"predicted best after iteration {best};" in found.stopped
    plain = reconstruct(P, image, SolverChoice("rl-nesterov", 100, 2.0, auto=True))
    assert plain.state.iteration < last
    for setting in ({"goal": "win"}, {"goal": "measure"}, {"goal": "measure", "auto": True, "stop": "discrepancy"}):
        with pytest.raises(InputError, match="goal"):
            SolverChoice("rl", 5, **setting)


# -- by the sensor's noise -----------------------------------------------------------------------------------
def test_the_misfit_of_noise_alone_is_one():
    """Photons, gain and read noise as a sensor makes them; weights count, and errors of the model increase it."""
    rng = np.random.default_rng(0)
    for gain, read_noise in ((1.0, 0.0), (0.25, 3.0), (8.0, 20.0)):
        photons = rng.uniform(5, 50, (300, 300))
        frame = gain * rng.poisson(photons) + read_noise * rng.standard_normal(photons.shape)
        weights = (rng.random(photons.shape) < 0.7) * rng.uniform(0.5, 2, photons.shape)
        data = Measurement.of(frame, dtype=np.float64, weights=weights, read_noise=read_noise, signed=True)
        found = misfit(gain * photons + read_noise**2, data, read_noise, gain)
        assert found == pytest.approx(1, abs=0.02)
        spoilt = np.where(weights > 0, gain * photons, -1e6) + read_noise**2
        assert misfit(spoilt, data, read_noise, gain) == found
        assert misfit(1.5 * gain * photons + read_noise**2, data, read_noise, gain) > 1.5
    assert misfit(np.zeros_like(photons), Measurement(np.zeros_like(photons), None, 0.0), 0, 1) == 0


@pytest.mark.parametrize("name", ["rl", "sieve", pytest.param("phase-space", marks=pytest.mark.long)])
@pytest.mark.parametrize("margin", [0, 8])
@pytest.mark.few(2)
def test_runs_stop_once_the_residual_reaches_the_noise(noisy, name, margin):
    P, truth, image = noisy
    wide = with_margin(P, margin)
    choice = SolverChoice(name, 100, 2.0, margin=margin, auto=True, stop="discrepancy")
    found = reconstruct(wide, image, choice)
    assert "the residual reached the noise level" in found.stopped and len(found.history) < 60
    # the first that does: by one projection with the frame's own projector
    records = list(iter_reconstruct(wide, image, choice))
    assert len(records) == len(found.history)
    misses = []
    for record in records[-2:]:
        model = wide.forward(record.state.volume)[margin : margin + SHAPE[0], margin : margin + SHAPE[1]] + 2
        misses.append(float(np.mean((image - model) ** 2 / np.maximum(model, 2))))
    if len(misses) == 2:
        assert misses[0] > 1
    assert misses[-1] <= 1 + 1e-5
    errors = [nrmse(r.state.volume, truth) for r in iter_reconstruct(P, image, SolverChoice(name, 60, 2.0))]
    start = nrmse(np.full_like(truth, truth.mean()), truth)
    assert nrmse(found.volume, truth) - min(errors) < 0.4 * (start - min(errors))


def test_a_residual_that_never_reaches_the_noise_is_reported(noisy):
    P, _, image = noisy
    spoilt = image + 40 * (np.indices(SHAPE).sum(0) % 2)
    found = reconstruct(P, spoilt, SolverChoice("rl", 6, 2.0, auto=True, stop="discrepancy"))
    assert not found.stopped and len(found.history) == 6
    assert any("times the noise; check the gain and the read noise, or H" in note for note in found.notes)


@pytest.mark.parametrize("margin", [0, pytest.param(8, marks=pytest.mark.long)])
def test_a_result_has_chi2_per_pixel_if_the_noise_is_known(noisy, margin):
    P, _, image = noisy
    wide = with_margin(P, margin)
    image = 4 * image + 3 * np.random.default_rng(1).standard_normal(SHAPE)
    image[5, 5] = np.nan
    choice = SolverChoice("rl", 8, 8.0, read_noise=3.0, margin=margin)
    found = reconstruct(wide, image, choice)
    assert np.isnan(found.chi2)
    model = wide.forward(found.state.volume)[margin : margin + SHAPE[0], margin : margin + SHAPE[1]] + 8
    expected = np.nanmean((image - model) ** 2 / (4 * np.maximum(model, 8) + 9))
    for known in ({"gain": 4.0}, {"noise": (9.0, 4.0)}):
        again = reconstruct(wide, image, replace(choice, **known))
        np.testing.assert_array_equal(again.volume, found.volume)
        assert again.chi2 == pytest.approx(expected, rel=1e-4)
    assert reconstruct(wide, image, replace(choice, iterations=60, gain=4.0)).chi2 < 1.2 < expected


def test_wrong_settings_of_stopping_are_refused():
    for setting, words in (
        ({"stop": "luck"}, "left-out or discrepancy"),
        ({"gain": 0.0}, r"gain \(counts per photoelectron\)"),
        ({"noise": (1.0, 0.0)}, r"noise per count \(counts\)"),
        ({"noise": (-1.0, 1.0)}, "noise without light"),
    ):
        with pytest.raises(InputError, match=words):
            SolverChoice("rl", 5, **setting)
