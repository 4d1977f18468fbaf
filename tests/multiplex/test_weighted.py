"""Weights, black levels, noise-optimal decorrelation, the general route: dense algebra and Monte Carlo."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Sensor
from lfcal.multiplex import (
    cfa,
    decorrelation_gain,
    demultiplex,
    demultiplex_generally,
    demultiplex_weighted,
    mask,
    modulator_from_matrix,
    multiplex,
    neutral_density,
    noise_optimal_inverse,
    pixel_variance,
    pixel_weights,
    sensor_noise,
    without_black_level,
)
from lfcal.multiplex._sensor_noise import black_level_map
from lfcal.multiplex.general import GeneralModel, mask_shadows
from lfcal.multiplex.recorded import RecordedFrame

RNG = np.random.default_rng
ND = neutral_density([[1.0, 0.25], [0.25, 0.0625]])
SENSOR = Sensor(
    shape=(40, 40), bit_depth=12, full_well_e=4095.0, read_noise_e=3.0, black_level=0.0, dark_current_e_s=2.0, prnu=0.02
)


def test_clipped_pixels_do_not_count() -> None:
    """Four filters of assorted pixels, radiance 5: two pixels clip at 1; unweighted that gave 1.19."""
    frame = np.minimum(multiplex(np.full((1, 12, 12), 5.0), ND), 1.0)
    assert demultiplex(frame, ND).max() < 2
    weights = np.where(frame >= 1.0, 0.0, 1.0)
    np.testing.assert_allclose(demultiplex(frame, ND, weights=weights), 5.0, rtol=1e-12)
    found = demultiplex_weighted(frame, ND, weights)
    assert np.isfinite(found.deviation).all()


def test_parts_of_rows_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    frame, weights = multiplex(RNG(0).random((1, 12, 12)), ND), RNG(1).random((12, 12))
    whole = demultiplex_weighted(frame, ND, weights)
    monkeypatch.setattr("lfcal.multiplex.weighted.VALUES_AT_ONCE", 1)
    parts = demultiplex_weighted(frame, ND, weights)
    np.testing.assert_allclose(parts.samples, whole.samples, rtol=1e-12)
    np.testing.assert_allclose(parts.deviation, whole.deviation, rtol=1e-12)


def test_high_dynamic_range_of_a_sensor() -> None:
    """Radiance over four decades: relative error by shot noise where something is unclipped, none larger."""
    radiance = np.logspace(1.5, 4.6, 640)[None, :] * np.ones((80, 1))
    electrons = RNG(0).poisson(multiplex(radiance[None], ND)) + 3.0 * RNG(1).standard_normal(radiance.shape)
    raw = np.clip(np.rint(electrons), 0, 4095)
    first = demultiplex_weighted(raw, ND, pixel_weights(raw, SENSOR))
    # the prediction in place of the noisy frame: dark samples then weigh no more than they should
    found = demultiplex_weighted(raw, ND, pixel_weights(raw, SENSOR, expected=multiplex(first.samples, ND)))
    ratio = found.samples[0] / radiance
    # 3 % where a filter's pixels begin to clip: only those that noise left below full scale count there
    assert np.abs(ratio.reshape(80, 80, 8).mean((0, 2)) - 1).max() < 0.04
    plain = demultiplex(raw, ND)[0] / radiance
    assert np.median(plain, axis=0).min() < 0.5, "without weights clipped pixels pull the radiance down"


def test_dead_pixels_are_bridged() -> None:
    y, x = np.mgrid[0:24, 0:24] / 24
    light = np.stack([y, 0.5 + 0 * y, 1 - x])
    frame = multiplex(light, cfa("Bayer"))
    weights = np.ones(frame.shape)
    frame[10, 12], weights[10, 12] = np.nan, 0
    frame[5, 5], weights[5, 5] = 1e9, 0
    found = demultiplex_weighted(frame, cfa("Bayer"), weights)
    inner = np.s_[:, 3:-3, 3:-3]
    np.testing.assert_allclose(found.samples[inner], light[inner], atol=0.06)
    assert found.deviation[0, 10, 12] > 0
    with pytest.raises(InputError):
        demultiplex(frame, cfa("Bayer"))


@pytest.mark.parametrize("modulator", [cfa("Bayer"), cfa("RGBW 4x4"), mask("MURA", 3), ND], ids=lambda m: m.name)
def test_weighted_is_dense_least_squares(modulator) -> None:
    """At one place, by matrices written out: interpolation, weights, normal equations."""
    py, px = modulator.side
    shape = (py * 4, px * 4)
    frame, weights = RNG(2).random(shape), RNG(3).random(shape) * (RNG(4).random(shape) > 0.1)
    found = demultiplex_weighted(frame, modulator, weights, samples=modulator.side)
    even = demultiplex(frame, modulator, filter="linear", samples=modulator.side)
    flat = demultiplex_weighted(frame, modulator, np.full(shape, 7.0), samples=modulator.side)
    if modulator.pixels == modulator.count:  # square: weights of channels do not matter
        np.testing.assert_allclose(flat.samples, even, atol=1e-9)
    y, x = py + py // 2, px + px // 2
    values, trust = [], []
    for a, b in np.ndindex(modulator.side):
        up, across = (np.maximum(0, 1 - np.abs(np.arange(4) * s + k - p) / s) for s, k, p in ((py, a, y), (px, b, x)))
        h = np.outer(up, across)
        w, f = weights[a::py, b::px], frame[a::py, b::px]
        total = (h * w).sum()
        values.append((h * w * f).sum() / total if total else 0.0)
        trust.append(total**2 / (h**2 * w).sum() if total else 0.0)
    root = np.sqrt(trust)
    wanted = np.linalg.lstsq(root[:, None] * modulator.matrix, root * values, rcond=None)[0]
    np.testing.assert_allclose(found.samples[:, y, x], wanted, atol=1e-9)
    inverse = np.linalg.pinv(root[:, None] * modulator.matrix)
    np.testing.assert_allclose(found.deviation[:, y, x], np.sqrt((inverse**2).sum(1)), rtol=1e-6)


def test_what_no_pixel_measures_has_an_infinite_deviation() -> None:
    frame = np.ones((12, 12))
    weights = np.ones((12, 12))
    weights[::2, ::2] = 0  # all reds
    found = demultiplex_weighted(frame, cfa("Bayer"), weights)
    assert np.isinf(found.deviation[0]).all() and np.isfinite(found.deviation[1:]).all()
    np.testing.assert_allclose(found.samples[0], 0, atol=1e-12)
    with pytest.raises(InputError, match="weights"):
        demultiplex(frame, cfa("Bayer"), weights=np.zeros((12, 12)))
    for bad in (-np.ones((12, 12)), np.ones((3, 3)), np.full((12, 12), np.nan)):
        with pytest.raises(InputError, match="weights"):
            demultiplex_weighted(frame, cfa("Bayer"), bad)
    with pytest.raises(InputError, match="reconstruction with weights"):
        demultiplex(frame, cfa("Bayer"), weights=np.ones((12, 12)), filter="cubic")


@pytest.mark.long
def test_the_stated_deviation_is_measured_within_a_percent() -> None:
    modulator = cfa("RGBW 4x4")
    light = np.array([300.0, 500, 200])[:, None, None] * np.ones((256, 256))
    pure = multiplex(light, modulator)
    deviation = np.sqrt(9 + pure)
    rng, found = RNG(5), []
    for _ in range(4):
        one = demultiplex_weighted(pure + deviation * rng.standard_normal(pure.shape), modulator, 1 / deviation**2)
        found.append(np.mean(((one.samples - light) / one.deviation) ** 2))
    assert np.sqrt(np.mean(found)) == pytest.approx(1, abs=0.01)


def test_the_noise_of_the_sensor() -> None:
    noise = sensor_noise(SENSOR, exposure_s=2.0)
    assert noise.additive_e2 == pytest.approx(9 + 4 + 1 / 12) and noise.chi2 == pytest.approx(4095 / (13 + 1 / 12))
    assert sensor_noise(SENSOR, gain=4.0).additive_e2 == pytest.approx(9 + 1 / 192)
    left = sensor_noise(SENSOR, flat_corrected=False)
    assert left.variance(1000.0) == pytest.approx(9 + 1 / 12 + 1000 + 400)
    assert np.array_equal(
        pixel_weights(np.array([[10.0, 4095, 5000, np.nan]]), SENSOR) > 0, [[True, False, False, False]]
    )
    dead = pixel_weights(np.full((2, 2), 100.0), SENSOR, dead=np.eye(2))
    assert dead[0, 0] == 0 and dead[0, 1] == pytest.approx(1 / (109 + 1 / 12))
    with pytest.raises(InputError):
        pixel_weights(np.ones((2, 2)), SENSOR, dead=np.ones((3, 3)))


@pytest.mark.few(6)
@pytest.mark.parametrize("chi2", [0.0, 5.0, math.inf])
@pytest.mark.parametrize("name", ["Bayer", "RGBW", "CYMG", "RGBW 4x4", "X-Trans"])
def test_noise_optimal_decorrelation(name: str, chi2: float) -> None:
    """Against generalised least squares written out, against Monte Carlo, and never worse than the plain one."""
    m = cfa(name)
    variance = pixel_variance(m, chi2)
    best = noise_optimal_inverse(m, variance)
    wanted = np.linalg.solve(m.matrix.T @ np.diag(1 / variance) @ m.matrix, m.matrix.T / variance)
    np.testing.assert_allclose(best, wanted, atol=1e-10)
    np.testing.assert_allclose(best @ m.matrix, np.eye(3), atol=1e-10)
    gain = decorrelation_gain(m, chi2)
    assert gain >= -1e-12 and (chi2 > 0 or gain == pytest.approx(0, abs=1e-9))
    rng = RNG(6)
    noise = np.sqrt(variance) * rng.standard_normal((60_000, m.pixels))
    rms = [np.sqrt(np.mean((noise @ inverse.T) ** 2)) for inverse in (m.inverse(), best)]
    assert 10 ** (gain / 10) == pytest.approx(rms[0] / rms[1], rel=0.01)


def test_optimal_decorrelation_of_correlated_noise_and_of_square_super_pixels() -> None:
    m = mask("MURA", 3)
    np.testing.assert_allclose(noise_optimal_inverse(m, RNG(7).random(9) + 0.1), m.inverse(), atol=1e-10)
    wide = modulator_from_matrix("two", (1, 2), np.ones((2, 1)))
    common = np.array([[1.0, 0.9], [0.9, 4.0]])
    found = noise_optimal_inverse(wide, common)
    assert float((found @ common @ found.T)[0, 0]) < min(1.0, float((wide.inverse() @ common @ wide.inverse().T)[0, 0]))
    for bad in (np.zeros(2), np.ones(3), -np.eye(2), np.array([[1, 2], [0, 1.0]])):
        with pytest.raises(InputError, match="noise"):
            noise_optimal_inverse(wide, bad)


# -- the general route ----------------------------------------------------------------------------------
def test_adjoint_of_the_general_model() -> None:
    for spacing in ((1.0, 1.0), (2.0, 3.0), (2.7, 4.1), (30.0, 30.0)):
        model = GeneralModel(RNG(0).random((3, 17, 22)), spacing)
        x, y = RNG(1).random(model.grid), RNG(2).random(model.shape)
        assert float((model.forward(x) * y).sum()) == pytest.approx(float((x * model.adjoint(y)).sum()), rel=1e-12)


def test_general_route_is_dense_least_squares() -> None:
    shares, weights = RNG(3).random((2, 9, 8)), RNG(4).random((9, 8))
    model = GeneralModel(shares, (2.0, 2.0))
    frame = RNG(5).random(model.shape)
    found = demultiplex_generally(frame, shares, 2.0, weights=weights, smoothness=1e-3, tolerance=1e-12)
    size = int(np.prod(model.grid))
    dense = np.stack([model.forward(e).ravel() for e in np.eye(size)], 1)
    w = (weights / weights.max()).ravel()
    rough = np.zeros((size, size))
    index = np.arange(size).reshape(model.grid)
    for one, two in ((index[:, 1:], index[:, :-1]), (index[:, :, 1:], index[:, :, :-1])):
        for i, j in zip(one.ravel(), two.ravel(), strict=True):
            rough[i, i] += 1
            rough[j, j] += 1
            rough[i, j] -= 1
            rough[j, i] -= 1
    share = (dense.T @ (w * (dense @ np.ones(size)))).mean()
    wanted = np.linalg.solve(dense.T * w @ dense + 1e-3 * share * rough, dense.T @ (w * frame.ravel()))
    np.testing.assert_allclose(found.samples.ravel(), wanted, atol=1e-8)
    assert found.operations == (found.iterations + 2) * model.operations and found.iterations > 1


def test_a_mask_that_never_repeats() -> None:
    """Views behind a random mask: no super-pixel, no separable basis; a wrong mask must not fit."""
    pattern = (RNG(6).random((90, 90)) < 0.5) * 1.0
    shares = mask_shadows(pattern, (60, 60), (2, 2), 1.4)
    assert shares.min() >= 0 and shares.max() <= 1
    y, x = np.mgrid[0:60, 0:60] / 60
    light = np.stack([1 + 0.5 * np.sin(2 * np.pi * (y * a + x * b)) for a, b in ((1, 0), (0, 1), (1, 1), (-1, 1))])
    frame = (shares * light).sum(0)
    found = demultiplex_generally(frame, shares, 3.0)
    nodes = np.arange(20) * 3 + 1
    error = np.sqrt(np.mean((found.samples - light[:, nodes][:, :, nodes]) ** 2))
    assert error < 0.03 and found.residual < 0.02
    wrong = demultiplex_generally(frame, shares[::-1], 3.0)
    assert np.sqrt(np.mean((wrong.samples - light[:, nodes][:, :, nodes]) ** 2)) > 5 * error


def test_shadows_of_a_mask_keep_its_light_within_a_frame() -> None:
    pattern = np.zeros((41, 41))
    pattern[15:26, 15:26] = RNG(8).random((11, 11))
    for shift in (0.0, 0.37, 1.0, 2.5):
        shares = mask_shadows(pattern, (41, 41), (3, 3), shift)
        np.testing.assert_allclose(shares.sum((1, 2)), pattern.sum(), rtol=1e-9)
        np.testing.assert_allclose(shares[4], pattern, atol=1e-12)


def test_general_route_of_periodic_modulators_and_dead_pixels() -> None:
    light = np.array([0.2, 0.5, 0.9])[:, None, None] * np.ones((18, 18))
    frame = multiplex(light, cfa("CYMG"))
    weights = np.ones(frame.shape)
    frame[4, 4], weights[4, 4] = np.nan, 0.0
    found = demultiplex_generally(frame, cfa("CYMG"), 2.0, weights=weights)
    np.testing.assert_allclose(found.samples, light[:, :9, :9], atol=1e-4)


def test_wrong_input_of_the_general_route_is_refused() -> None:
    frame, ones = np.ones((8, 8)), np.ones((2, 8, 8))
    for shares, message in (
        (np.ones((2, 7, 8)), "shape (N, 8, 8)"),
        (0 * ones, "some light"),
        (frame, "shape (N, rows, columns)"),
        (np.nan * ones, "finite numbers, got NaN or infinity"),
        (1e7 * ones, "magnitudes up to 1e+06, got 1e+07"),
        (1j * ones, "real numbers"),
    ):
        with pytest.raises(InputError, match=re.escape(f"transmissions: expected {message}")):
            demultiplex_generally(frame, shares, 2.0)
    for options in ({"most": 0}, {"most": 1.5}, {"smoothness": -1}, {"tolerance": 0}, {"spacing": 0.1}):
        with pytest.raises(InputError):
            demultiplex_generally(frame, ones, **{"spacing": 2.0, **options})


def test_black_levels_of_a_pattern_are_at_their_pixels() -> None:
    frame = np.arange(35, dtype=np.uint16).reshape(5, 7) + 100
    light = without_black_level(frame, (1.0, 2.0, 3.0, 4.0))
    assert light.dtype == np.float32
    for y, x in np.ndindex(frame.shape):
        assert light[y, x] == frame[y, x] - (1, 2, 3, 4)[y % 2 * 2 + x % 2]
    np.testing.assert_array_equal(without_black_level(frame, 7), frame - 7.0)
    np.testing.assert_array_equal(without_black_level(frame, (7,)), frame - 7.0)
    assert black_level_map((7,), frame.shape).shape == black_level_map(7, frame.shape).shape == ()
    assert without_black_level(frame.astype(float), frame / 2).dtype == np.float64
    np.testing.assert_array_equal(without_black_level(frame, frame / 2), frame / 2)
    for bad in ((), (1, 2), (1, 2, 3), np.nan, np.ones((4, 7))):
        with pytest.raises(InputError, match="black level"):
            without_black_level(frame, bad)
    with pytest.raises(InputError, match="frame"):
        without_black_level(np.zeros((3, 4, 5)), 1)


def test_the_given_level_counts_before_that_of_the_file_and_of_the_sensor() -> None:
    sensor, raw = Sensor(black_level=64.0), np.zeros((2, 2), np.uint16)
    stated, silent = (RecordedFrame(Path("a.tif"), raw, "", level) for level in ((10.0, 20.0, 20.0, 10.0), None))
    assert stated.level(0.0, sensor) == 0.0, "0 is a level"
    assert stated.level(None, sensor) == (10.0, 20.0, 20.0, 10.0)
    assert silent.level(None, sensor) == 64.0 and silent.level() == 0.0


def test_weights_subtract_the_level_of_the_file() -> None:
    sensor = Sensor(bit_depth=12, full_well_e=4095.0, read_noise_e=3.0, black_level=0.0)
    frame = np.array([[110.0, 220.0], [120.0, 210.0]])
    level = (100.0, 200.0, 100.0, 200.0)
    weights = pixel_weights(frame, sensor, black_level=level)
    np.testing.assert_allclose(1 / weights, 9 + 1 / 12 + np.array([[10.0, 20.0], [20.0, 10.0]]), rtol=1e-9)
    assert (pixel_weights(frame, sensor) < weights).all(), "without it the level is taken for light"
