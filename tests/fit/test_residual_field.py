"""What patterns show beyond a model: against dense linear algebra, known fields, and noise alone."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.base.progress import drain
from lfcal.fit._residual_field import (
    Moving,
    PlaneResiduals,
    ResidualField,
    amplitudes,
    held_out_folds,
    iter_residual_estimate,
    sampled_variance,
    sized,
    spot_velocity,
)

SMALL = (3, 4, 5, 5)
READ = 8.0


def ones(shape: tuple[int, ...] = SMALL) -> np.ndarray:
    return np.ones(shape, np.float32)


def dense(field: ResidualField) -> np.ndarray:
    """Return K as a matrix, column by column."""
    n = int(np.prod(field.shape))
    columns = [field.covariance(np.eye(n, dtype=np.float32)[k].reshape(field.shape)).ravel() for k in range(n)]
    return np.stack(columns, axis=1).astype(float)


def spots(ny: int = 10, nx: int = 12, size: int = 17, *, velocity: float = -0.5) -> np.ndarray:
    """Return patterns of four spots that move as the source does, in counts."""
    t, s = np.mgrid[:size, :size] - (size - 1) / 2
    out = np.zeros((ny, nx, size, size))
    for y, x in np.ndindex(ny, nx):
        for row, column, light in ((-3, -3, 1.0), (-3, 4, 0.5), (4, -2, 0.8), (3.5, 3.5, 0.3)):
            at = (row + velocity * (y - ny / 2), column + velocity * (x - nx / 2))
            out[y, x] += light * np.exp(-((t - at[0]) ** 2 + (s - at[1]) ** 2) / 1.5)
    return (8000 * out).astype(np.float32)


def plane(
    model: np.ndarray, beyond: np.ndarray, recorded: np.ndarray, seed: int = 0
) -> tuple[PlaneResiduals, np.ndarray, np.ndarray]:
    """Return what is recorded of a model and what it lacks, the truth, and the noisy patterns."""
    rng = np.random.default_rng(seed)
    truth = np.maximum(model + beyond, 0)
    data = rng.poisson(truth) + READ * rng.standard_normal(truth.shape)
    precision = (recorded[:, :, None, None] / (READ**2 + np.maximum(model, 0))).astype(np.float32)
    residual = np.where(precision > 0, data - model, 0).astype(np.float32)
    return PlaneResiduals(model, residual, precision, recorded, False), truth, data


def off(found: np.ndarray, truth: np.ndarray, keep: np.ndarray) -> float:
    return float(np.sqrt(np.square(found - truth)[keep].sum() / np.square(truth)[keep].sum()))


@pytest.mark.parametrize("around", [True, False])
def test_correlations_are_those_that_are_stated(around: bool) -> None:
    """By the formula, between entries in the middle: it is of continuous places, W of whole ones."""
    shape, moving = (1, 9, 1, 11), Moving(-0.5, 2.0, 1.0)
    field = ResidualField([moving], [ones(shape)], around=around)
    found = dense(field).reshape(9, 11, 9, 11)
    assert np.allclose(np.einsum("xsxs->xs", found), 1.0, atol=1e-5)
    step, apart = np.arange(9) - 4, np.arange(11) - 5
    wanted = np.exp(-((step[:, None] / 2.0) ** 2) / 2 - (apart + 0.5 * step[:, None]) ** 2 / 2)
    assert np.abs(found[4, 5] - wanted)[2:7].max() < 0.06
    # the wrong sense of the motion is another field
    assert np.abs(found[4, 5] - wanted[::-1])[2:7].max() > 0.3
    ends = found[0, 5, 8].max()
    assert ends > 0.5 if around else ends < 0.05


def test_the_estimate_and_its_variance_are_those_of_dense_algebra() -> None:
    rng = np.random.default_rng(1)
    amplitude = (1.0 + rng.random(SMALL)).astype(np.float32)
    field = ResidualField([Moving(-0.5, 1.5, 0.7), Moving(0.5, 2.5, 0.7)], [amplitude, 0.5 * ones()], around=False)
    precision = (rng.random(SMALL) < 0.7) / (0.2 + rng.random(SMALL))
    residual = np.where(precision > 0, rng.standard_normal(SMALL), 0).astype(np.float32)
    k, w = dense(field), precision.ravel()
    gain = k @ np.diag(w) @ np.linalg.inv(np.eye(len(w)) + k @ np.diag(w))
    wanted = gain @ residual.ravel()
    found = field.estimate(residual, precision.astype(np.float32)).ravel()
    assert np.linalg.norm(found - wanted) < 0.03 * np.linalg.norm(wanted)
    assert np.allclose(np.diag(k), field.variance.ravel(), rtol=1e-4)
    variance = np.diag(k - gain @ k)
    sampled = sampled_variance(field, precision.astype(np.float32), 300, rng).ravel()
    assert np.abs(sampled / variance - 1).mean() < 0.12 and sampled.mean() == pytest.approx(variance.mean(), rel=0.05)


def test_the_velocity_of_spots_is_found() -> None:
    for velocity in (-0.7, -0.5, 0.3):
        assert spot_velocity(spots(velocity=velocity), around=False) == pytest.approx(velocity, abs=0.1)


def test_noise_alone_leaves_the_model() -> None:
    model = spots()
    for seed in range(3):
        data, _, _ = plane(model, 0 * model, np.ones(model.shape[:2], bool), seed)
        assert sized(data).sizes == ()
        left = drain(iter_residual_estimate(data, "plane", workers=1))
        assert left.kind.empty and not left.value.any() and not left.variance.any()


@pytest.mark.long
def test_a_drawn_field_is_found_with_its_size_and_uncertainty() -> None:
    """Drawn at random with known size; truth is the field, not what the estimator makes of it."""
    model = spots()
    near = amplitudes(model)[0]
    size = 0.06
    drawn = ResidualField([Moving(-0.5, 2.5, 0.7)], [np.float32(size) * near], around=False)
    beyond = drawn.sample(np.random.default_rng(4))
    recorded = np.ones(model.shape[:2], bool)
    recorded[1::3, 1::2] = False
    data, truth, patterns = plane(model, beyond, recorded)
    spots_size = sized(data).sizes[0]
    lit = model > 0.02 * model.max()
    assert np.sqrt(np.mean(np.square(spots_size[lit] / near[lit]))) == pytest.approx(size, rel=0.25)
    left = drain(iter_residual_estimate(data, "plane", workers=1))
    hybrid = model + left.value
    assert off(hybrid, truth, recorded) < 0.7 * min(off(model, truth, recorded), off(patterns, truth, recorded))
    # positions between recorded ones follow them, and only a part of it is determined
    assert left.kind.supported and off(hybrid, truth, ~recorded) < 0.8 * off(model, truth, ~recorded)
    for where, least in ((recorded, 0.8), (~recorded, 0.6)):
        keep = lit & where[:, :, None, None]
        pull = np.sqrt(np.mean(np.square(hybrid - truth)[keep] / left.variance[keep]))
        assert least < pull < 1.3
    assert left.variance[~recorded].sum() > 1.5 * left.variance[1::3, ::2].sum()


def test_residuals_that_neighbours_do_not_share_are_not_transferred() -> None:
    model = spots()
    beyond = 0.1 * model * np.random.default_rng(2).standard_normal(model.shape)
    recorded = np.indices(model.shape[:2]).sum(0) % 2 == 0
    data, truth, patterns = plane(model, beyond, recorded)
    left = drain(iter_residual_estimate(data, "plane", workers=1))
    assert not left.kind.empty and not left.kind.supported
    assert off(model + left.value, truth, recorded) < min(off(model, truth, recorded), off(patterns, truth, recorded))


def test_every_fold_of_positions_covers_the_plane() -> None:
    recorded = np.random.default_rng(3).random((9, 11)) < 0.8
    empty = np.zeros((9, 11, 3, 3), np.float32)
    data = PlaneResiduals(empty, empty, empty, recorded, around=True)
    sets = held_out_folds(data)
    assert len(sets) == 5 and all(one.sum() == recorded.sum() // 5 for one in sets)
    assert np.sum(sets, axis=0).max() == 1 and not np.any(sets, axis=0)[~recorded].any()
    for one in sets:
        quarters = one[:5, :6], one[:5, 6:], one[5:, :6], one[5:, 6:]
        assert all(quarter.any() for quarter in quarters)


@pytest.mark.long
@pytest.mark.parametrize(
    ("across", "steps", "parts"),
    [
        (1, 3, (np.s_[:, :, :30], np.s_[:, :, 30:], np.s_[:, :, 30:34])),
        (3, 5, (np.s_[:, :, :30, :30], np.s_[:, :, 30:, 30:], np.s_[:, :, 30:34, 30:34])),
    ],
)
def test_large_cutouts_are_solved_in_tiles(across: int, steps: int, parts: tuple[tuple[slice, ...], ...]) -> None:
    """As they are at once, where the residual is of one part alone."""
    model = np.tile(spots(6, 6, 15), (1, 1, 3, across))
    beyond = ResidualField([Moving(-0.5, 1.5, 0.5)], [0.1 * amplitudes(model)[0]], around=False).sample(
        np.random.default_rng(0)
    )
    data, truth, patterns = plane(model, beyond, np.ones((6, 6), bool))
    work = iter_residual_estimate(data, "plane", workers=1)
    assert next(work).total == steps
    left = drain(work)
    every = np.ones((6, 6), bool)
    assert off(model + left.value, truth, every) < min(off(model, truth, every), off(patterns, truth, every))
    for part in parts:
        # no seam is worse than the rest
        assert off((model + left.value)[part], truth[part], every) < 1.3 * off(model + left.value, truth, every)
