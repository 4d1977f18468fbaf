"""Weights on lattices of any pitch: dense least squares written out, whole pixels, Monte Carlo."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.multiplex import (
    Modulator,
    SuperPixelLattice,
    cfa,
    channel_grid,
    demultiplex_lattice,
    demultiplex_lattice_weighted,
    demultiplex_weighted,
    lattice_channels,
    lattice_channels_weighted,
    mask,
    modulator_from_matrix,
)

RNG = np.random.default_rng
Array = NDArray[np.float64]


def lattice(kind: str, pitch: float = 5.3, angle: float = 0.04) -> SuperPixelLattice:
    along = pitch * np.array([math.cos(angle), math.sin(angle)])
    across = (0.87 if kind == "hexagonal" else 1.0) * pitch * np.array([-math.sin(angle), math.cos(angle)])
    lean = 0.5 if kind == "hexagonal" else 0.0
    return SuperPixelLattice(kind, (20.3, 21.7), tuple(along.tolist()), tuple((lean * along + across).tolist()))


TALL = modulator_from_matrix("tall", (5, 5), RNG(9).random((25, 4)), views=(2, 2), cell=(5, 5))


def shares_of(given: SuperPixelLattice, shape: tuple[int, int], m: Modulator, at: tuple[int, int]) -> Array:
    """Return what each channel of one sample takes of every pixel, ``(K, rows, columns)``, by plain loops."""
    grid = channel_grid(shape, given, m.side, spacing_px=None)
    step = (given.row_pitch_px / m.side[0], given.pitch_px / m.side[1])
    found = np.zeros((m.pixels, *shape))
    for k in range(m.pixels):
        a, b = divmod(k, m.side[1])
        for lens, share in zip(grid.near[at], grid.share[at], strict=True):
            y = grid.centres_px[lens, 0] + (a - (m.side[0] - 1) / 2) * step[0]
            x = grid.centres_px[lens, 1] + (b - (m.side[1] - 1) / 2) * step[1]
            top, left = math.floor(y), math.floor(x)
            for row, down in ((top, top + 1 - y), (top + 1, y - top)):
                for column, across in ((left, left + 1 - x), (left + 1, x - left)):
                    if share * down * across:
                        found[k, row, column] += share * down * across
    return found


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
@pytest.mark.parametrize("m", [mask("MURA", 5), mask("lenslet", 4), TALL], ids=lambda m: m.name)
def test_weighted_views_are_dense_least_squares(kind: str, m: Modulator) -> None:
    given, shape = lattice(kind), (41, 44)
    frame, weights = RNG(2).random(shape), RNG(3).random(shape) * (RNG(4).random(shape) > 0.05)
    found = demultiplex_lattice_weighted(frame, given, m, weights)
    assert found.samples.shape == (m.count, *channel_grid(shape, given, m.side, spacing_px=None).shape)
    at = (2, 3)
    shares = shares_of(given, shape, m, at)
    total, squared = (shares * weights).sum((1, 2)), (shares**2 * weights).sum((1, 2))
    assert (total > 0).all()
    values = (shares * weights * frame).sum((1, 2)) / total
    root = total / np.sqrt(squared)
    wanted = np.linalg.lstsq(root[:, None] * m.matrix, root * values, rcond=None)[0]
    np.testing.assert_allclose(found.samples[:, *at], wanted, atol=1e-9 * max(1, np.abs(wanted).max()))
    # the noise of every pixel through all channels that take it
    inverse = np.linalg.pinv(root[:, None] * m.matrix) * root
    every = np.tensordot(inverse / total, shares * weights, 1)
    lit = weights > 0
    variance = (every[:, lit] ** 2 / weights[lit]).sum(1)
    np.testing.assert_allclose(found.deviation[:, *at], np.sqrt(variance), rtol=1e-6)


@pytest.mark.parametrize("kind", ["square", "hexagonal"])
def test_equal_weights_change_nothing(kind: str) -> None:
    given, frame = lattice(kind), RNG(5).random((41, 44)).astype(np.float32)
    m = mask("MURA", 5)
    plain, weighed = (demultiplex_lattice(frame, given, m, weights=w) for w in (None, np.full(frame.shape, 7.0)))
    assert weighed.dtype == np.float32
    np.testing.assert_allclose(weighed, plain, atol=1e-4)
    plain, weighed = (lattice_channels(frame, given, 5, weights=w) for w in (None, np.full(frame.shape, 7.0)))
    np.testing.assert_allclose(weighed, plain, atol=1e-6)
    out = np.empty_like(plain)
    assert lattice_channels(frame, given, 5, weights=np.ones(frame.shape), out=out) is out


def test_whole_pixels_are_the_weighted_route_of_super_pixels() -> None:
    given = SuperPixelLattice("square", (2.0, 2.0), (5.0, 0.0), (0.0, 5.0))
    frame, weights = RNG(6).random((35, 40)), RNG(7).random((35, 40)) * (RNG(8).random((35, 40)) > 0.1)
    one = demultiplex_lattice_weighted(frame, given, mask("lenslet", 5), weights)
    two = demultiplex_weighted(frame, mask("lenslet", 5), weights)
    lit = weights.reshape(7, 5, 8, 5).transpose(1, 3, 0, 2).reshape(25, 7, 8) > 0
    np.testing.assert_allclose(one.samples[lit], two.samples[lit], atol=1e-12)
    np.testing.assert_allclose(one.deviation[lit], two.deviation[lit], rtol=1e-9)
    channels = lattice_channels_weighted(frame, given, 5, weights)
    np.testing.assert_allclose(channels.samples.reshape(25, 7, 8), 25 * one.samples, atol=1e-12)


def test_dead_and_saturated_pixels_are_bridged() -> None:
    given, shape = lattice("square", 9.7, 0.01), (120, 130)
    y, x = np.mgrid[: shape[0], : shape[1]] / 100
    frame, weights = 1 + y + 2 * x, np.ones(shape)
    frame[40:44, 50:53], weights[40:44, 50:53] = np.nan, 0
    frame[80, 20:30], weights[80, 20:30] = 4095, 0
    found = lattice_channels_weighted(frame, given, 7, weights)
    plain = lattice_channels(1 + y + 2 * x, given, 7)
    assert np.isfinite(found.deviation).all()
    # what stands in for a missing channel is of super-pixels around it, over which this light changes evenly
    np.testing.assert_allclose(found.samples, plain, atol=0.25)
    assert (np.abs(found.samples - plain) < 1e-9).mean() > 0.9
    with pytest.raises(InputError):
        lattice_channels(frame, given, 7)


def test_what_no_pixel_measures_is_said() -> None:
    given, frame = SuperPixelLattice("square", (2.0, 2.0), (5.0, 0.0), (0.0, 5.0)), np.ones((35, 40))
    weights = np.ones(frame.shape)
    weights[2::5, 3::5] = 0
    found = demultiplex_lattice_weighted(frame, given, mask("lenslet", 5), weights)
    lost = np.isinf(found.deviation).all((1, 2))
    assert np.flatnonzero(lost).tolist() == [13] and not found.samples[13].any()
    assert np.isfinite(np.delete(found.deviation, 13, 0)).all()
    assert np.isinf(lattice_channels_weighted(frame, given, 5, weights).deviation[2, 3]).all()


@pytest.mark.parametrize("m", [mask("MURA", 5), mask("lenslet", 5)], ids=lambda m: m.name)
@pytest.mark.few(1)
def test_the_told_deviation_is_measured_within_a_percent(m: Modulator) -> None:
    given, shape = lattice("square"), (60, 64)
    deviation = RNG(10).uniform(0.5, 2.0, shape)
    rng, ratios = RNG(11), []
    for _ in range(20):
        one = demultiplex_lattice_weighted(deviation * rng.standard_normal(shape), given, m, 1 / deviation**2)
        ratios.append((one.samples / one.deviation) ** 2)
    assert np.sqrt(np.mean(ratios)) == pytest.approx(1, abs=0.01)


def test_bad_weights() -> None:
    given, frame = lattice("square"), np.ones((41, 44))
    for bad in (np.zeros(frame.shape), -np.ones(frame.shape), np.ones((3, 3)), np.full(frame.shape, np.nan)):
        with pytest.raises(InputError, match="weights of the pixels"):
            demultiplex_lattice(frame, given, mask("MURA", 5), weights=bad)
        with pytest.raises(InputError, match="weights of the pixels"):
            lattice_channels(frame, given, 5, weights=bad)
    for options in ({"filter": "cubic"}, {"route": "fourier"}, {"filter": "sinc"}):
        with pytest.raises(InputError, match="reconstruction with weights"):
            demultiplex_lattice(frame, given, mask("MURA", 5), weights=np.ones(frame.shape), **options)
    with pytest.raises(InputError, match="super-pixel"):
        demultiplex_lattice_weighted(frame, given, cfa("Bayer"), np.ones(frame.shape))
