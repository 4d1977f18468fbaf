"""Reconstructions with a recorded H, which has noise."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from lfcal.psf import Facts, PSFMatrix
from lfcal.psf.denoising import RULE, denoised, mean_noise
from lfcal.psf.facts import Origin
from lfcal.reconstruct import FieldProjector, Projector
from lfcal.reconstruct.phantoms import nrmse
from lfcal.reconstruct.solvers._model_noise import ModelNoise
from lfcal.reconstruct.solvers.choice import SolverChoice, iter_reconstruct, reconstruct
from lfcal.reconstruct.solvers.smoothing import Sieve
from tests.reconstruct._building import square_matrix
from tests.reconstruct.oracles import dense

SHAPE = (77, 77)


def noted(values: np.ndarray, noise: tuple[float, float] | None, **facts: object) -> PSFMatrix:
    """Return H of ``values`` that states ``noise``."""
    where = values.shape[:3]
    if noise is not None:
        facts["noise"] = np.tile(noise, (*where, 1))
    return PSFMatrix(values, facts=Facts.of(where, values.shape[3:], **facts), anchor=(5, 5))


@pytest.fixture(scope="module")
def exact() -> np.ndarray:
    """Return H of two planes behind square lenslets, its peak 1."""
    values = square_matrix((2.2, 3.0), 41).astype(np.float64)
    return values / values.max()


def recorded(exact: np.ndarray, peak: float, read_noise: float) -> PSFMatrix:
    """Return H as whole counts of photons and read noise, after the dark frame is subtracted."""
    rng = np.random.default_rng(1)
    counts = np.round(rng.poisson(exact * peak) + read_noise * rng.standard_normal(exact.shape))
    return noted(counts.astype(np.float32), (read_noise**2 + 1 / 12, 1.0))


def drawn(kind: str, shape: tuple[int, ...]) -> np.ndarray:
    """Return beads, lines or a smooth object ``(nz, Y, X)`` away from the edges."""
    rng = np.random.default_rng(3)
    y, x = np.indices(shape[1:])
    volume = np.zeros(shape)
    if kind == "smooth":
        volume[:] = [np.clip(20 * gaussian_filter(rng.standard_normal(shape[1:]), 5), 0, None) + 0.05 for _ in volume]
    for _ in range({"beads": 10, "lines": 5, "smooth": 0}[kind]):
        z, row, column, angle = rng.integers(len(volume)), *rng.uniform(18, 58, 2), rng.uniform(0, np.pi)
        across, along = (y - row) * np.cos(angle) - (x - column) * np.sin(angle), np.hypot(y - row, x - column)
        volume[z] += rng.uniform(0.4, 1) * np.exp(-((along if kind == "beads" else across) ** 2) / 2)
    return volume * ((y >= 14) & (y < 63) & (x >= 14) & (x < 63))


# -- less noise in the patterns ------------------------------------------------------------------------------
def test_denoising_uses_entries_of_the_same_sensor_pixel():
    """By its definition: mean and scatter of the entries at a fixed sensor pixel, as far as noise explains them."""
    rng = np.random.default_rng(0)
    shape = (1, 8, 9, 11, 13)
    values = rng.normal(30, 6, shape) + 8 * rng.random((1, 8, 9, 1, 1))
    values[0, :, :, 2, 2] -= 40
    noise = rng.uniform(5, 20, (*shape[:3], 2)) * [1, 0.02]
    noise = noise.astype(np.float32).astype(float)  # as facts are kept
    noise[0, 3, 3] = np.nan
    valid = rng.random(shape) < 0.9
    known = rng.random(shape[:3]) < 0.95
    packed = np.packbits(valid.reshape(*shape[:3], -1), axis=-1)
    origin = np.zeros(shape[:3], np.uint8)
    origin[0, 6, 6] = Origin.MODEL
    facts = Facts.of(shape[:3], shape[3:], noise=noise, valid=packed, recorded=known.astype(np.uint16), origin=origin)
    found = denoised(PSFMatrix(values, facts=facts), 0, values[0])
    known = known[0] & (origin[0] == 0) & np.isfinite(noise[0, ..., 0])
    changed = 0
    for y, x, t, s in [tuple(rng.integers(shape[1:])) for _ in range(300)] + [(1, 1, 2, 2)]:
        own = values[0, y, x, t, s]
        group, terms = [], []
        for dy in range(-RULE.reach, RULE.reach + 1):
            for dx in range(-RULE.reach, RULE.reach + 1):
                row, column, down, across = (y + dy) % 8, (x + dx) % 9, t - dy, s - dx
                inside = 0 <= down < 11 and 0 <= across < 13
                if inside and known[row, column] and valid[0, row, column, down, across]:
                    group.append(values[0, row, column, down, across])
                    terms.append(noise[0, row, column])
        if not (known[y, x] and valid[0, y, x, t, s]) or len(group) < 4:
            assert found[y, x, t, s] == own
            continue
        mean, (floor, slope) = np.mean(group), np.mean(terms, axis=0)
        beyond = max(np.var(group, ddof=1) - floor - slope * max(mean, 0), 0)
        if mean < RULE.certain * np.sqrt((floor + slope * max(mean, 0)) / len(group)):
            assert found[y, x, t, s] == 0
            continue
        share = beyond / (beyond + noise[0, y, x] @ [1, max(mean, 0)])
        assert found[y, x, t, s] == pytest.approx(max(mean + share * (own - mean), 0), rel=1e-9)
        changed += 0.1 < share < 0.9
    assert changed > 50


def test_denoising_halves_the_noise_of_patterns(exact):
    for peak, read_noise in ((2000, 5.0), (200, 3.0)):
        H, true = recorded(exact, peak, read_noise), exact * peak
        plain, quiet = (np.stack(planes) for planes in (H[:], [denoised(H, z, H.plane(z)) for z in range(2)]))
        assert nrmse(quiet, true) < 0.5 * nrmse(plain, true)
        # negative noise that is cut off adds a halo: nearly none of it remains
        halo = [np.maximum(one, 0).sum() / true.sum() - 1 for one in (plain, quiet)]
        assert halo[0] > 0.3 and abs(halo[1]) < 0.1 * halo[0]


def test_without_known_noise_nothing_changes():
    values = np.random.default_rng(0).random((2, 3, 3, 5, 5))
    for noise in (None, (0.0, 0.0), (np.nan, 1.0)):
        H = noted(values, noise)
        P, plane = Projector(H, (12, 12)), values[1]
        assert P.denoised() is P and P.noise is None and mean_noise(H.T) is None
        assert denoised(H, 1, plane) is plane and Projector(values, (12, 12)).denoised().noise is None
        image = P.forward(np.ones(P.volume_shape))
        plain = reconstruct(Projector(values, (12, 12), anchor=(5, 5)), image, SolverChoice("sieve", 5))
        np.testing.assert_array_equal(reconstruct(P, image, SolverChoice("sieve", 5)).volume, plain.volume)


@pytest.mark.few(2)
@pytest.mark.parametrize("kind", ["one", "regions"])
@pytest.mark.parametrize("method", ["polyphase", "direct"])
def test_a_denoised_projector_is_that_of_the_denoised_matrix(exact, kind, method):
    """Once made it is kept; its subsets are its own, and it travels as what it is."""
    H = recorded(exact, 300, 3.0)
    quiet = np.stack([denoised(H, z, H.plane(z)) for z in range(2)])
    volume = np.random.default_rng(0).random((2, 40, 44), np.float32)
    if kind == "one":
        P, Q = (Projector(one, (40, 44), anchor=(5, 5), method=method) for one in (H, quiet))
    else:
        near, far = (noted(one, (9.0, 1.0)) for one in (H[:], 2 * H[:]))
        moved = PSFMatrix(far[:], facts=far.facts, anchor=(5, 27))
        planes = [np.stack([denoised(one, z, one.plane(z)) for z in range(2)]) for one in (near, moved)]
        made = [PSFMatrix(values, anchor=one.anchor) for one, values in zip((near, moved), planes, strict=True)]
        P, Q = (FieldProjector(regions, (40, 44), method=method) for regions in ([near, moved], made))
    expected = Q.forward(volume)
    mask = np.indices((11, 11)).sum(0) % 2 == 0
    P.subset(mask)
    for found in (P.denoised(), pickle.loads(pickle.dumps(P.denoised()))):
        np.testing.assert_allclose(found.forward(volume), expected, rtol=1e-4, atol=1e-4 * expected.max())
    assert P.denoised() is P.denoised() and P.denoised().denoised() is P.denoised()
    assert np.abs(P.forward(volume) - expected).max() > 1e-3 * expected.max()
    part = P.subset(mask).denoised().forward(volume)
    np.testing.assert_allclose(part, P.denoised().subset(mask).forward(volume), rtol=1e-5)


def two_regions(first: tuple[float, float] | None) -> FieldProjector:
    """Return the projector of two equal regions; the H of the ``first`` states its noise, the second 4 counts²."""
    values = np.full((1, 4, 4, 3, 3), 1 / 9)
    matrices = []
    for column, noise in ((0, first), (40, (4.0, 0.0))):
        H = noted(values, noise)
        matrices.append(PSFMatrix(values, facts=H.facts, anchor=(8, column)))
    return FieldProjector(matrices, (20, 60))


def test_regions_have_independent_new_noise():
    """The noise of all regions was drawn with the same seed, so that their errors added up."""
    P = two_regions((4.0, 0.0))
    found = [part.projector for part in P.with_new_noise(3)._parts]
    left, right = (one._reader.read(0) - 1 / 9 for one in found)
    assert left.std() == pytest.approx(2, rel=0.2) and right.std() == pytest.approx(2, rel=0.2)
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.2
    volume, same = np.ones(P.volume_shape), pickle.loads(pickle.dumps(P.with_new_noise(3)))
    np.testing.assert_array_equal(same.forward(volume), P.with_new_noise(3).forward(volume))


def test_noise_of_any_region_counts():
    """If the first H stated no noise, that of the others was ignored."""
    P = two_regions(None)
    np.testing.assert_allclose(P.noise, [[4, 0]])
    np.testing.assert_allclose(two_regions((2.0, 1.0)).noise, [[3, 0.5]])
    volume = np.ones(P.volume_shape)
    changed = np.abs(P.with_new_noise(1).forward(volume) - P.forward(volume))
    assert changed[:, 0].max() < 1e-4 < 1 < changed[:, -10:].max()
    assert P.denoised() is not P


# -- the noise of the model ----------------------------------------------------------------------------------
INNER = (slice(2, -2), slice(2, -2))


def noisy_model():
    """Return a random generator, an H that states its noise, a volume, and the variance of its image."""
    rng = np.random.default_rng(0)
    values = 50 * rng.random((2, 3, 3, 5, 5)) ** 3
    P = Projector(noted(values, (4.0, 0.5)), (16, 17), dtype=np.float64)
    volume = rng.random(P.volume_shape) ** 4
    noise = ModelNoise(P, Sieve((0.0, 0.0)), np.array([[4.0, 0.5], [4.0, 0.5]]))
    return rng, values, volume, noise.variance(volume)


def test_variance_of_the_model_is_that_of_plain_algebra():
    """Each entry's variance times the square of what it multiplies."""
    _, values, volume, variance = noisy_model()
    spread = dense(4.0 + 0.5 * values, (16, 17), (5, 5)) @ volume.ravel() ** 2
    np.testing.assert_allclose(variance[INNER], spread.reshape(16, 17)[INNER], rtol=1e-6)


@pytest.mark.long
def test_variance_of_the_model_is_that_of_many_recordings():
    rng, values, volume, variance = noisy_model()
    drawn = [values + np.sqrt(4.0 + 0.5 * values) * rng.standard_normal(values.shape) for _ in range(300)]
    images = [Projector(one, (16, 17), (5, 5)).forward(volume) for one in drawn]
    assert np.var(images, axis=0)[INNER].mean() == pytest.approx(variance[INNER].mean(), rel=0.03)


@pytest.mark.few(2)
@pytest.mark.parametrize(("peak", "read_noise"), [(2000, 5.0), (300, 3.0)])
@pytest.mark.parametrize("kind", ["beads", "lines", "smooth"])
def test_long_runs_with_a_noisy_matrix_keep_their_smallest_error(exact, kind, peak, read_noise):
    """A run of 80 iterations ends within 8 % of its least error, which is not far from that with the exact H.

    With H as recorded, errors are 0.3 to 0.6 (peak 2000) and 5 to 9 (peak 300) after 80 iterations.
    """
    H = recorded(exact, peak, read_noise)
    true = Projector(exact * peak, SHAPE, (5, 5), workers=1)
    truth = drawn(kind, true.volume_shape)
    truth *= 1500 / true.forward(truth).max()
    image = np.random.default_rng(5).poisson(true.forward(truth).clip(0) + 5).astype(float)
    P = Projector(H, SHAPE, workers=1)
    run = iter_reconstruct(P, image, SolverChoice("sieve", 80, 5.0))
    errors = [nrmse(record.state.volume, truth) for record in run]
    found = reconstruct(P, image, SolverChoice("sieve", 80, 5.0))
    assert nrmse(found.volume, truth) == errors[-1] < 1.08 * min(errors)
    assert found.stopped == f"only noise of H and of the frame remains after iteration {len(errors)}"
    assert found.notes == ("the patterns of H are denoised with the noise stated in H",)
    exactly = reconstruct(true, image, SolverChoice("sieve", 15, 5.0))
    assert errors[-1] < (1.2 if peak == 2000 else 1.7) * nrmse(exactly.volume, truth)
    assert len(exactly.history) == 15 and not exactly.stopped and not exactly.notes
    kept = reconstruct(P, image, SolverChoice("sieve", 15, 5.0, denoise=False))
    assert nrmse(kept.volume, truth) > errors[-1] and not kept.notes
