"""Richardson-Lucy within a sieve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from benchmarks._fault_recordings import CAMERAS
from lfcal.base.errors import InputError
from lfcal.camera import ScanPlan, preset
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import Projector
from lfcal.reconstruct.phantoms import nrmse
from lfcal.reconstruct.solvers._em import EmOptions
from lfcal.reconstruct.solvers._repeating import Repeating
from lfcal.reconstruct.solvers._stretch import Stretch
from lfcal.reconstruct.solvers.choice import SolverChoice, reconstruct
from lfcal.reconstruct.solvers.records import SolverState
from lfcal.reconstruct.solvers.sieve import sieve_of
from lfcal.reconstruct.solvers.smoothing import FINE, SIEVE, Sieve
from lfcal.simulate.accuracy.planner import plan_effects
from lfcal.simulate.simulate import simulate_psf
from tests.reconstruct._building import square_matrix
from tests.reconstruct.oracles import dense


@pytest.fixture(scope="module")
def microscope() -> PSFMatrix:
    """Return H of a microscope of whole pixels, its native plane in the middle."""
    camera = preset("lfm_60x12")
    camera = replace(
        camera,
        lattice=replace(camera.lattice, pitch_um=100.1),
        sensor=replace(camera.sensor, shape=(165, 165), pixel_um=100.1 / 11),
    )
    plan = ScanPlan.for_camera(camera, depths_um=(-4.0, 0.0, 4.0), cutout=101)
    return simulate_psf(plan, plan_effects(plan, 0.3), tolerance=0.3)


@pytest.fixture(scope="module")
def textured() -> tuple[Projector, tuple[slice, slice]]:
    """Return a projector of three planes behind square lenslets, and the place of the light of a volume.

    It has no camera, so only the stretch distinguishes the solver from accelerated Richardson-Lucy.
    """
    H = square_matrix((2.2, 2.8, 3.4), 45)
    return Projector(H, (77, 77), anchor=(5, 5), workers=1), (slice(14, -14), slice(14, -14))


def test_a_sieve_is_its_own_transpose():
    sieve = Sieve((0.0, 0.2, 2.5))
    a, b = np.random.default_rng(0).random((2, 3, 17, 12))
    assert np.vdot(sieve.apply(a), b) == pytest.approx(np.vdot(a, sieve.apply(b)), rel=1e-12)
    np.testing.assert_array_equal(sieve.apply(a)[:2], a[:2])
    dot = np.zeros((3, 41, 41))
    dot[:, 20, 20] = 1
    seen = sieve.apply(dot)[2]
    assert seen.sum() == pytest.approx(1, rel=1e-3) and seen.min() >= 0
    rows = np.arange(41) - 20
    assert (seen.sum(1) * rows**2).sum() == pytest.approx(2.5**2, rel=0.01)


@pytest.mark.long
def test_a_sieve_is_wide_only_in_coarse_planes(microscope):
    P = Projector(microscope, (60, 60))
    sigmas = sieve_of(P).sigmas
    assert sigmas[1] == pytest.approx(SIEVE * microscope.camera.pitch_px) and sigmas[0] == sigmas[2] == FINE < 0.6
    assert sieve_of(Projector(np.ones((2, 3, 3, 5, 5)), (9, 9))).sigmas == (0, 0)


def box_mean(volume, size):
    """Return the mean over ``size`` voxels around each voxel of each plane, the last value going on beyond."""
    half = size // 2
    padded = np.pad(volume, ((0, 0), (half, half), (half, half)), mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size), axis=(1, 2))
    return windows.mean((3, 4))


@pytest.mark.parametrize("subsets", [None, 1])
def test_the_solver_is_accelerated_richardson_lucy_of_a_blurred_matrix(monkeypatch, subsets):
    """By plain algebra: s <- a u with u = S HT(f / (H S a + b)) / (S HT1) from a = s + (t - 1) / t' (s - s before).

    The logarithm of u, relative to its mean over a cutout, is taken 1 + p times, and the light of a u does not change.
    p is 2 and shrinks to 0.9 of it, by as much as the step from model to model passed the top of a parabola, to 0.3.
    a leaves a tenth of each voxel. Where the likelihood of a has fallen, the best of 256 points between s before and a
    takes its place, and t starts again.
    """
    rng = np.random.default_rng(1)
    H, shape = rng.random((2, 3, 3, 5, 5)) ** 30, (9, 9)
    P, A = Projector(H, shape, dtype=np.float64), dense(H, shape)
    sieve = Sieve((0.0, 1.1))
    monkeypatch.setattr("lfcal.reconstruct.solvers.sieve.sieve_of", lambda P: sieve)
    S = np.stack([sieve.apply(e.reshape(2, 9, 9)).ravel() for e in np.eye(162)], axis=1)
    np.testing.assert_allclose(S, S.T, atol=1e-15)
    B, f, b = A @ S, rng.uniform(1, 20, 81), 0.7
    s = np.full(162, (f - b).sum() / B.sum())
    before, t, step, p, tops, last = s, 1.0, 0.0, 2.0, [], None
    turned, reached = 0, -np.inf

    def likelihood(model):
        return float((f * np.log(model) - model).sum())

    for k in range(6):
        ahead = np.maximum(s + step * (s - before), 0.1 * s)
        model = B @ ahead + b
        fell = likelihood(model) < reached
        if last is not None:
            rise, left = ((f / m - 1) @ (model - last) for m in (last, model))
            tops.append(rise / (rise - left))
            p *= 0.9 * np.clip(tops[-1], 0.3, 1)
        if fell:
            turned += 1
            way, shares = ahead - before, np.arange(1, 256) / 256
            uphill = [q for q in shares if (f / (B @ (before + q * way) + b) - 1) @ (B @ way) > 0]
            s = ahead = before + max(uphill, default=0.0) * way
            model = B @ ahead + b
        last, reached = model, likelihood(model)
        u = (B.T @ (f / model)) / B.sum(0)
        logs = np.log(np.maximum(u, np.exp(-3))).reshape(2, 9, 9)
        longer = u * np.exp(np.clip(p * (logs - box_mean(logs, 5)), -3, 3)).ravel()
        longer *= (B.sum(0) * ahead) @ u / ((B.sum(0) * ahead) @ longer)
        before, s = s, ahead * longer
        t = 1.0 if fell or not k else (1 + np.sqrt(1 + 4 * t**2)) / 2
        step = (t - 1) / ((1 + np.sqrt(1 + 4 * t**2)) / 2)
    assert min(tops) < 1 < max(tops) and p > 0.2 and 0 < turned < 5, "all sides of the rule are met"
    choice = SolverChoice("sieve", 6, b, subsets=subsets)
    np.testing.assert_allclose(reconstruct(P, f.reshape(9, 9), choice).volume.ravel(), S @ s, rtol=1e-8)
    first = reconstruct(P, f.reshape(9, 9), replace(choice, iterations=4)).state
    rest = reconstruct(P, f.reshape(9, 9), replace(choice, iterations=2), resume=first)
    np.testing.assert_allclose(rest.volume.ravel(), S @ s, rtol=1e-8)
    assert rest.history[-1].iteration == 6


@pytest.mark.few(1)
@pytest.mark.parametrize("seed", range(3))
def test_a_dense_texture_is_fitted_as_well_as_by_plain_richardson_lucy(textured, seed):
    """Stretched steps must not make voxels zero for good.

    Chi2 per pixel was 11 to 29 after three iterations and 1.1 to 3.6 after 30, where plain ones reach 9 and 1.1.
    """
    P, inner = textured
    rng = np.random.default_rng(seed)
    truth = np.zeros(P.volume_shape)
    for plane in truth:
        plane[inner] = (np.clip(10 * gaussian_filter(rng.standard_normal(plane.shape), 3), 0, None) + 0.1)[inner]
    truth *= 2000 / P.forward(truth).max()
    image = rng.poisson(P.forward(truth).clip(0) + 10).astype(float)
    plain, ours = (reconstruct(P, image, SolverChoice(name, 30, 10.0, gain=1.0)) for name in ("rl", "sieve"))
    assert ours.chi2 < min(plain.chi2, 1.0) and nrmse(ours.volume, truth) < nrmse(plain.volume, truth)
    assert ours.history[3].likelihood > plain.history[3].likelihood


def test_the_repeating_part_is_removed_from_an_update():
    """By its definition: the geometric mean over the periods, bright beads counted as twice at most."""
    period, shape = (3, 4), (14, 19)
    rng = np.random.default_rng(1)
    lens = np.tile(rng.uniform(0.7, 1.4, period), (5, 5))[:14, :19]
    lens /= np.exp(np.log(lens[:3, :4]).mean())
    field = np.exp(0.2 * rng.standard_normal(shape))
    seen = rng.random(shape) > 0.1
    repeating = Repeating(period, (1.0, 0.5, 0.0))
    factor = lens * field
    logs = np.where(seen, np.log(factor), 0)
    around = np.zeros(shape)
    for row, column in np.ndindex(shape):
        # one period around, the last value going on beyond the border
        rows = np.clip(np.arange(row - 1, row + 2), 0, shape[0] - 1)
        columns = np.clip(np.arange(column - 2, column + 2), 0, shape[1] - 1)
        around[row, column] = logs[np.ix_(rows, columns)].mean()
    common = np.zeros(shape)
    for row, column in np.ndindex(period):
        own = np.zeros(shape, bool)
        own[row::3, column::4] = True
        common[own] = np.clip((logs - around)[own & seen], -0.7, 0.7).mean()
    common -= common[:3, :4].mean()
    np.testing.assert_allclose(repeating.without(0, factor, seen)[seen], (factor / np.exp(common))[seen], rtol=1e-12)
    np.testing.assert_allclose(
        repeating.without(1, factor, seen)[seen], (factor / np.exp(common / 2))[seen], rtol=1e-12
    )
    assert np.array_equal(repeating.without(2, factor, seen), factor)
    # the lenslets are gone, and what was not seen is as it was
    whole = np.tile(lens[:3, :4], (20, 20))
    np.testing.assert_allclose(repeating.without(0, whole, np.ones(whole.shape, bool))[6:-6, 8:-8], 1, atol=0.02)
    assert np.array_equal(repeating.without(0, factor, seen)[~seen], factor[~seen])
    # a bead is no pattern
    bead = np.ones((60, 80))
    bead[30, 40] = 50
    left = repeating.without(0, bead, np.ones(bead.shape, bool))
    assert left[30, 40] > 49 and np.abs(np.delete(left.ravel(), 30 * 80 + 40) - 1).max() < 0.01
    # a few periods determine nothing
    assert np.array_equal(repeating.without(0, factor[:6, :8], seen[:6, :8]), factor[:6, :8])


@pytest.mark.long
@pytest.mark.parametrize("name", ["bench", "r29-like"])
def test_the_sieve_is_as_fine_as_voxels_if_several_lenslets_see_every_point(monkeypatch, name):
    """A main lens and hexagonal lenslets, one type and three: beyond virtual depth 2 what is left is acceleration."""
    camera = CAMERAS[name]().camera
    plan = ScanPlan.for_camera(camera, virtual_depths=(1.5, 3.0), cutout=41)
    H = simulate_psf(plan, plan_effects(plan, 0.3), tolerance=0.3)
    shape = (72, 72)
    P = Projector(H, shape, workers=1)
    assert sieve_of(P).sigmas == pytest.approx((SIEVE * camera.pitch_px / 2, FINE))
    far = Projector(PSFMatrix(H[1:], depths=H.depths[1:], camera=camera, anchor=H.anchor), shape, workers=1)
    truth = np.zeros(P.volume_shape)
    truth[1, 36, 33] = 1
    clean = np.maximum(P.forward(truth), 0)
    image = np.random.default_rng(0).poisson(clean / clean.max() * 2000 + 5).astype(float)
    ours, plain = (reconstruct(far, image, SolverChoice(n, 4, 5.0)) for n in ("sieve", "rl-nesterov"))
    assert all(a.likelihood > b.likelihood for a, b in zip(ours.history[1:], plain.history[1:], strict=True))
    with monkeypatch.context() as patch:
        patch.setattr("lfcal.reconstruct.solvers.smoothing.FINE", 0.0)
        patch.setattr("lfcal.reconstruct.solvers.sieve.stretch_of", lambda P: None)
        np.testing.assert_array_equal(reconstruct(far, image, SolverChoice("sieve", 4, 5.0)).volume, plain.volume)
    both = [reconstruct(P, image, SolverChoice(n, 20, 5.0)).volume[1] for n in ("rl", "sieve")]
    rl, sieve = (max(width(plane.sum(axis)) for axis in (0, 1)) for plane in both)
    assert sieve < 1.1 * rl


def test_stretched_updates_do_not_amplify_the_repeating_part():
    """In a plane sampled coarsely; elsewhere detail counts three times, what is wide once, unseen voxels stay."""
    period, shape = (7, 5), (70, 60)
    y, x = np.indices(shape)
    lens = np.exp(0.1 * np.cos(2 * np.pi * y / 7) * np.cos(2 * np.pi * x / 5))
    wide = np.full(shape, 1.3)
    stretch = Stretch((21, 25), period, (1.0, 0.0))
    seen = np.ones(shape, bool)
    seen[30, 30] = False
    inner = (slice(15, -15), slice(15, -15))
    coarse, fine = (stretch.apply(z, lens * wide, np.ones(shape, bool), 2.0) for z in range(2))
    np.testing.assert_allclose(coarse[inner], (lens * wide)[inner], rtol=1e-3)
    np.testing.assert_allclose(fine[inner], (lens**3 * wide)[inner], rtol=2e-3)
    assert stretch.apply(1, lens * wide, seen, 2.0)[30, 30] == (lens * wide)[30, 30]
    # what does not repeat counts in a coarse plane, too
    blob = np.exp(0.3 * np.exp(-((y - 35) ** 2 + (x - 30) ** 2) / (2 * 8.0**2)))
    assert np.log(stretch.apply(0, blob, np.ones(shape, bool), 2.0)[35, 30]) > 1.2 * np.log(blob[35, 30])


def test_a_resumed_volume_is_not_stretched():
    """A state that remembers nothing is a volume that was found already: the next update is Richardson-Lucy's."""
    rng = np.random.default_rng(2)
    P = Projector(rng.random((2, 3, 3, 5, 5)), (12, 11), dtype=np.float64)
    f, found = rng.uniform(1, 20, (12, 11)), rng.uniform(1, 2, P.volume_shape)
    plain = reconstruct(P, f, SolverChoice("rl", 1, 0.5), initial=found).volume
    late = reconstruct(P, f, SolverChoice("sieve", 1, 0.5), resume=SolverState(found, 7)).volume
    np.testing.assert_array_equal(late, plain)
    first = reconstruct(P, f, SolverChoice("sieve", 1, 0.5), initial=found).volume
    assert np.abs(first - plain).max() > 0.01 * plain.max()
    with pytest.raises(InputError, match="stretched updates: expected the acceleration nesterov"):
        EmOptions(stretch=Stretch((5, 5)))


def lattice_excess(plane: np.ndarray, period: int) -> float:
    """Return how much brighter than its mean a plane is at the brightest place behind the mean lenslet."""
    inner = plane[2 * period : -2 * period, 2 * period : -2 * period]
    rows, columns = (n // period for n in inner.shape)
    cell = inner[: rows * period, : columns * period].reshape(rows, period, columns, period).mean((0, 2))
    return float(cell.max() / cell.mean()) - 1


def width(profile: np.ndarray) -> float:
    """Return the full width at half maximum of a peak."""
    top = int(profile.argmax())
    half = profile[top] / 2
    left = next(k for k in range(top, -1, -1) if profile[k] < half)
    right = next(k for k in range(top, len(profile)) if profile[k] < half)
    first = left + (half - profile[left]) / (profile[left + 1] - profile[left])
    last = right - (half - profile[right]) / (profile[right - 1] - profile[right])
    return last - first


@pytest.mark.long
def test_no_lenslets_and_no_rings_in_the_native_plane(microscope):
    """A smooth cloud in another plane, seen through a slightly wrong H: rl draws lenslets in the native plane."""
    shape, period = (165, 165), microscope.period[0]
    P = Projector(microscope, shape, workers=1)
    y, x = np.indices(shape) - 82
    truth = np.zeros(P.volume_shape)
    truth[2] = np.exp(-(x**2 + y**2) / (2 * 40.0**2))
    image = P.forward(truth)
    lens = np.hypot(*(np.abs((np.indices(shape) - np.reshape(P.grid.anchor, (2, 1, 1))) % period)))
    image *= 1 + 0.15 * np.cos(2 * np.pi * lens / period)  # lenslets are not as H says
    noisy = np.random.default_rng(0).poisson(image / image.max() * 300).astype(float)
    found = {name: reconstruct(P, noisy, SolverChoice(name, n)) for name, n in (("rl", 20), ("sieve", 10))}
    plain, ours = (found[name].volume for name in ("rl", "sieve"))
    # it takes fewer iterations to fit as well
    assert found["sieve"].history[-1].likelihood > found["rl"].history[-1].likelihood
    assert lattice_excess(plain[1], period) > 0.2
    assert lattice_excess(ours[1], period) < 0.05 * lattice_excess(plain[1], period)


@pytest.mark.long
def test_a_bead_is_as_narrow_as_in_plain_richardson_lucy(microscope):
    """In every plane, the median over places behind a lenslet: rl has spikes at some of them in the native plane."""
    P = Projector(microscope, (99, 99), workers=1)
    for z in range(3):
        widths: list[list[float]] = [[], []]
        for row, column in ((52, 50), (49, 45)):
            truth = np.zeros(P.volume_shape)
            truth[z, row, column] = 1
            clean = np.maximum(P.forward(truth), 0)
            image = np.random.default_rng(z).poisson(clean / clean.max() * 2000 + 5).astype(float)
            for k, choice in enumerate((SolverChoice("rl", 20, 5.0), SolverChoice("sieve", 20, 5.0))):
                plane = reconstruct(P, image, choice).volume[z]
                widths[k] += [width(plane.sum(axis)) for axis in (0, 1)]
            rest = plane.copy()
            rest[row - 15 : row + 16, column - 15 : column + 16] = 0
            assert rest.max() < 0.03 * plane.max(), "no rings"
        assert np.median(widths[1]) < 1.1 * np.median(widths[0])
