"""Several points lit at once: codes, gain of each entry by the formula and by Monte Carlo, and codes on a display."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base.errors import InputError
from lfcal.camera import preset
from lfcal.multiplex import (
    SensorNoise,
    code_matrix,
    coding_gain,
    coding_pays,
    display_fit,
    display_frames,
    measured_coding_gain,
    overlapping_patterns,
    random_code,
    s_matrix,
)
from lfcal.multiplex.coding import s_matrix_orders

RNG = np.random.default_rng
Array = NDArray[np.float64]
NOISE = SensorNoise(full_e=10_000.0, additive_e2=100.0)


def spots(points: int = 7, size: int = 12) -> Array:
    """Return patterns of a bright core, a halo and dark entries about it, each at a place of its own."""
    y, x = np.mgrid[:size, :size]
    found = []
    for k in range(points):
        r2 = (y - 3 - k % 3 * 2) ** 2 + (x - 3 - k // 3 * 2) ** 2
        found.append(np.exp(-r2 / 1.5) + 0.02 * np.exp(-r2 / 18))
    return np.array(found)


def test_s_matrices_have_their_algebra() -> None:
    for n in (3, 7, 11, 15, 19, 23, 31, 43, 63, 127):
        s, eye, ones = s_matrix(n), np.eye(n), np.ones((n, n))
        assert set(np.unique(s)) == {0.0, 1.0}
        np.testing.assert_array_equal(s @ s.T, (n + 1) / 4 * (eye + ones))
        np.testing.assert_allclose(s @ (2 / (n + 1) * (2 * s.T - ones)), eye, atol=1e-12)


def test_orders_and_codes() -> None:
    assert s_matrix_orders(50) == [3, 7, 11, 15, 19, 23, 31, 43, 47]
    for n in (1, 5, 9, 27, 35, 2000):
        with pytest.raises(InputError, match="order of the S-matrix"):
            s_matrix(n)
    # of the smallest order with as many columns
    assert code_matrix("S", 9).shape == (11, 9) and code_matrix("S", 7).shape == (7, 7)
    np.testing.assert_array_equal(code_matrix("single", 4), np.eye(4))
    code = code_matrix("random", 6, frames=12, density=0.3, rng=RNG(1))
    assert code.shape == (12, 6) and np.linalg.matrix_rank(code) == 6 and 0.1 < code.mean() < 0.5
    np.testing.assert_array_equal(code, random_code(12, 6, 0.3, RNG(1)))


def test_gain_of_an_s_matrix_in_closed_form() -> None:
    """The additive noise falls to 4n/(n+1)^2, and that of the photons of all patterns at a pixel to 2/(n+1)."""
    light, n = spots(), 7
    for signal in (5.0, 300.0, 2000.0):
        found = coding_gain(light, s_matrix(n), NOISE, signal_e=signal)
        electrons = signal * light / light.max()
        coded = 4 * n / (n + 1) ** 2 * NOISE.additive_e2 + 2 / (n + 1) * electrons.sum(0)
        alone = NOISE.additive_e2 + electrons
        assert found.time.exposure == 1, "nothing saturates"
        np.testing.assert_allclose(found.time_db, 5 * np.log10(alone / coded), atol=1e-9)
        mean = alone.mean() / np.broadcast_to(coded, light.shape).mean()
        assert found.time.rms_db == pytest.approx(5 * math.log10(mean))


def test_codes_reduce_additive_noise_and_spread_photon_noise_over_dark_entries() -> None:
    light = spots()
    weak = coding_gain(light, s_matrix(7), NOISE, signal_e=0.01)
    # the known gain of S-matrices, (n + 1)/(2 sqrt n)
    np.testing.assert_allclose(weak.time_db, 10 * math.log10(8 / (2 * math.sqrt(7))), atol=1e-3)
    photons = coding_gain(light, s_matrix(7), SensorNoise(1e6, 1e-6), signal_e=1e5)
    # a core alone at its pixel has up to 3 dB more light, paid by the dark entries of the others
    assert photons.time.dark_db < -3 and 0 < photons.time.core_db < 10 * math.log10(2)
    assert photons.time.rms_db < 0 and 0 < photons.time.better < 0.5
    # an entry gains where it is brighter than half of a quarter of all at its pixel: 2/(n + 1) of them
    flat = light.reshape(7, -1)
    np.testing.assert_array_equal((photons.time_db > 1e-9).reshape(7, -1), flat > 2 / 8 * flat.sum(0) * (1 + 1e-9))


def test_exposures_are_reduced_if_sums_would_saturate() -> None:
    light = np.ones((3, 4, 4))
    found = coding_gain(light, s_matrix(3), NOISE, signal_e=8000.0)
    assert found.time.exposure == pytest.approx(10_000 / 16_000) and found.time.peak_e == pytest.approx(10_000)
    # at equal full well two points that lie over each other have half the exposure each
    assert found.full_well.exposure == pytest.approx(0.5) and found.full_well.peak_e == pytest.approx(10_000)
    e = 5000.0
    coded = (4 * 3 / 16 * NOISE.additive_e2 + 2 / 4 * 3 * e) / e**2
    single = (NOISE.additive_e2 + 10_000.0) / 10_000.0**2
    np.testing.assert_allclose(found.full_well_db, 5 * math.log10(single / coded), atol=1e-9)


def test_more_frames_are_compared_with_more_frames() -> None:
    """A code of twice the frames is compared with each point twice alone: repeating a code gains nothing."""
    light = spots()
    once = coding_gain(light, s_matrix(7), NOISE, signal_e=300.0)
    twice = coding_gain(light, np.vstack([s_matrix(7)] * 2), NOISE, signal_e=300.0)
    np.testing.assert_allclose(twice.time_db, once.time_db, atol=1e-9)
    alone = coding_gain(light, np.eye(7), SensorNoise(1e4, 100.0, 0.02), signal_e=300.0)
    np.testing.assert_allclose(alone.time_db, 0, atol=1e-12)
    np.testing.assert_allclose(alone.full_well_db, 0, atol=1e-12)


@pytest.mark.few(4)
@pytest.mark.parametrize("limit", ["time", "full well"])
@pytest.mark.parametrize("prnu", [0.0, 0.02])
@pytest.mark.parametrize(
    ("code", "signal"),
    [(s_matrix(7), 300.0), (s_matrix(7), 9000.0), (code_matrix("random", 7, frames=14, rng=RNG(3)), 300.0)],
    ids=["S, weak", "S, full", "random"],
)
def test_monte_carlo_is_the_formula_within_a_percent(code: Array, signal: float, prnu: float, limit: str) -> None:
    noise, light = SensorNoise(10_000.0, 100.0, prnu), spots()
    found = coding_gain(light, code, noise, signal_e=signal)
    wanted = (found.time if limit == "time" else found.full_well).rms_db
    measured = measured_coding_gain(light, code, noise, signal_e=signal, limit=limit, trials=400, rng=RNG(4))
    assert 10 ** ((measured - wanted) / 10) == pytest.approx(1, abs=0.01)


def test_coding_pays_for_weak_light_only() -> None:
    light = spots()
    found = coding_pays(light, NOISE, signal_e=50.0)
    assert found.pays and found.gain.time.rms_db > 0 and found.words.startswith("coding pays")
    assert 50 < found.break_even_e < NOISE.full_e
    for signal, pays in ((0.97 * found.break_even_e, True), (1.03 * found.break_even_e, False)):
        assert coding_pays(light, NOISE, signal_e=signal).pays is pays
    full = coding_pays(light, NOISE, limit="full well")
    assert not full.pays and "does not pay" in full.words and "equal full well" in full.words
    # a pattern without a bright core over a noisy sensor: always; photons alone: never
    flat = np.ones((3, 4, 4)) * np.array([1.0, 0.001, 0.001])[:, None, None]
    assert coding_pays(flat, SensorNoise(100.0, 1e6)).break_even_e == math.inf
    never = coding_pays(light, SensorNoise(1e4, 1e-9), signal_e=100.0)
    assert never.break_even_e == 0 or never.break_even_e < 1e-2
    assert not never.pays


def test_patterns_of_neighbours_are_at_their_points() -> None:
    plane = RNG(5).random((3, 4, 5, 7))
    light, places = overlapping_patterns(plane, 5, step=2, first=(2, 3))
    assert light.shape == (5, 2 + 5, 4 + 7)
    np.testing.assert_array_equal(places, [[2, 3], [2, 5], [2, 7], [4, 3], [4, 5]])
    for pattern, (y, x) in zip(light, places, strict=True):
        top, left = y - 2, x - 3
        np.testing.assert_array_equal(pattern[top : top + 5, left : left + 7], plane[y % 3, x % 4])
        assert np.isnan(pattern).sum() == pattern.size - 35, "beyond its cutout a point has no entry"
    # what is no entry has no gain and does not count
    found = coding_gain(light, code_matrix("S", 5), NOISE, signal_e=100.0)
    np.testing.assert_array_equal(np.isnan(found.time_db), np.isnan(light))
    assert math.isfinite(found.time.rms_db)


def test_wrong_codes_and_patterns_are_refused() -> None:
    ones, light, code = np.ones((3, 4, 5, 7)), spots(), s_matrix(7)
    for call in (
        lambda: code_matrix("H", 7),
        lambda: code_matrix("S", 0),
        lambda: code_matrix("S", 7, frames=9),
        lambda: random_code(3, 6, 0.5, RNG(0)),
        lambda: random_code(6, 6, 1.0, RNG(0)),
        lambda: random_code(40, 40, 1e-6, RNG(0)),
        lambda: overlapping_patterns(0 * ones, 3),
        lambda: overlapping_patterns(ones[0], 3),
        lambda: overlapping_patterns(np.inf * ones, 3),
        lambda: overlapping_patterns(ones, 0),
        lambda: overlapping_patterns(ones, 3, step=0),
        lambda: coding_gain(light, s_matrix(3), NOISE, signal_e=10.0),
        lambda: coding_gain(light, np.ones((7, 7)), NOISE, signal_e=10.0),
        lambda: coding_gain(light, 2 * code, NOISE, signal_e=10.0),
        lambda: coding_gain(light, code, NOISE, signal_e=1e6),
        lambda: coding_gain(light, code, NOISE, signal_e=math.nan),
        lambda: coding_pays(light, NOISE, limit="money"),
        lambda: coding_pays(light, NOISE, code="H"),
        lambda: measured_coding_gain(light, random_code(9, 7, 0.5, RNG(0)), NOISE, signal_e=10, rng=RNG(0), trials=1),
    ):
        with pytest.raises(InputError):
            call()


def test_a_display_is_judged_by_its_pixel_in_the_image() -> None:
    step = preset("r29").step_um(0.0)
    fine, equal = display_fit(step, step / 8), display_fit(step, step)
    assert fine.fits and fine.placing_px == 0 and "fine enough" in fine.words
    assert equal.fits and equal.image_px == pytest.approx(1), "one display pixel to each position"
    coarse = display_fit(step, 3 * step)
    assert not coarse.fits and coarse.image_px == pytest.approx(3)
    assert "too coarse" in coarse.words and f"{step:.4g} µm" in coarse.words and "3 times" in coarse.words
    odd = display_fit(10.0, 4.0)  # 2.5 to a step: positions fall between pixels
    assert not odd.fits and odd.placing_px == pytest.approx(0.2) and "too coarse" in odd.words
    assert display_fit(10.0, 1.9).fits and display_fit(10.0, 1.9).placing_px == pytest.approx(0.095)
    for bad in ((0, 1), (1, 0), (1, np.nan), (np.inf, 1)):
        with pytest.raises(InputError):
            display_fit(*bad)


def test_frames_show_the_code_at_the_points() -> None:
    code, places = s_matrix(7), np.array([[2, 3], [2, 4], [2, 5], [3, 3], [3, 4], [3, 5], [4, 3]])
    fit = display_fit(10.0, 5.0)
    frames = list(display_frames(code, places, fit, (11, 12)))
    assert len(frames) == 7 and all(frame.shape == (11, 12) and frame.dtype == np.uint8 for frame in frames)
    # a block of 5 x 5 display pixels in the middle
    spots = (places - places.min(0)) * 2 + [3, 3]
    for frame, lit in zip(frames, code, strict=True):
        np.testing.assert_array_equal(frame[spots[:, 0], spots[:, 1]], 255 * lit)
        assert (frame > 0).sum() == lit.sum()
    many = list(display_frames(code / 2, places, fit, (40, 60), repeat=(6, 7)))
    assert (many[0] > 0).sum() == 3 * 4 * code[0].sum() and set(np.unique(many[0])) == {0, 128}
    # blocks of 3 x 3 display pixels may touch
    near = list(display_frames(code, places, display_fit(5.0, 5.0), (9, 9), repeat=(3, 3)))
    assert (near[0] > 0).sum() == 9 * code[0].sum()
    for bad in ({"shape": (4, 60)}, {"repeat": (1, 1), "shape": (40, 60)}):
        with pytest.raises(InputError):
            list(display_frames(code, places, fit, bad.pop("shape"), **bad))
    with pytest.raises(InputError, match="display pixel for each"):
        list(display_frames(code, places, display_fit(10.0, 30.0), (40, 60)))
    with pytest.raises(InputError, match="positions"):
        list(display_frames(code, places[:3], fit, (40, 60)))
