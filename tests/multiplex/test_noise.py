"""Transmission, amplification and gain: closed forms, the paper's statements, Monte Carlo."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Sensor, preset
from lfcal.multiplex import (
    CFA_PATTERNS,
    amplification,
    camera_chi2,
    cfa,
    gain_curves,
    mask,
    modulator_from_matrix,
    monte_carlo_gain,
    snr_gain,
    transmission,
)

BAYER = cfa("Bayer")
PINHOLE = mask("pinhole", 11)
CHI2 = np.concatenate([[0.0], np.logspace(-4, 4, 33), [math.inf]])


@pytest.mark.parametrize(
    ("modulator", "alpha", "tau"),
    [
        (BAYER, math.sqrt(2.5 / 3), 1 / 3),
        (cfa("CYMG"), math.sqrt(13 / 21), 7 / 12),
        (mask("MURA", 11), 11 / 60, 60 / 121),
        (PINHOLE, 1.0, 1 / 121),
        (mask("lenslet", 11), 1 / 121, 1.0),
        (cfa("RGBW"), math.sqrt(2.25 / 3), 1 / 2),
        (cfa("CYYM"), math.sqrt(1.875 / 3), 2 / 3),
    ],
    ids=lambda v: getattr(v, "name", None),
)
def test_closed_forms(modulator, alpha: float, tau: float) -> None:
    assert amplification(modulator) == pytest.approx(alpha, rel=0, abs=1e-12)
    assert transmission(modulator) == pytest.approx(tau, rel=0, abs=1e-12)


@pytest.mark.parametrize("p", [3, 5, 7, 13, 17])
def test_mura_of_any_prime(p: int) -> None:
    assert amplification(mask("MURA", p)) == pytest.approx(2 * p / (p * p - 1), rel=0, abs=1e-12)


@pytest.mark.parametrize("name", CFA_PATTERNS)
def test_amplification_is_the_printed_trace(name: str) -> None:
    m = cfa(name)
    printed = np.linalg.inv(m.plenoptic @ m.spatial.T @ m.spatial @ m.plenoptic.T)
    assert amplification(m) == pytest.approx(math.sqrt(np.trace(printed) / m.count), rel=1e-12)


def test_amplification_of_what_is_recoverable_counts_that_alone() -> None:
    """Red and green from two pixels each, blue from none: a variance of 1/2 each, over two samples and not three."""
    poor = cfa("RRGG")
    assert amplification(poor) == math.inf
    assert amplification(poor, recoverable=True) == pytest.approx(math.sqrt(1 / 2))
    assert amplification(BAYER, recoverable=True) == amplification(BAYER)


@pytest.mark.parametrize("rank", [1, 2, 4])
def test_amplification_of_what_is_recoverable_is_the_noise_that_comes_out(rank: int) -> None:
    rng = np.random.default_rng(rank)
    matrix = np.abs(rng.standard_normal((9, rank))) @ np.abs(rng.standard_normal((rank, 4)))
    m = modulator_from_matrix("few", (3, 3), matrix / matrix.max(), views=(2, 2))
    noise = rng.standard_normal((40_000, 9)) @ np.linalg.pinv(m.matrix, rcond=1e-9).T
    out = math.sqrt(float((noise**2).sum(1).mean()) / rank)
    assert amplification(m, rcond=1e-9, recoverable=True) == pytest.approx(out, rel=0.02)


def test_the_papers_statements() -> None:
    cymg = cfa("CYMG")
    assert snr_gain(cymg, BAYER, chi2=0.0) == pytest.approx(0.6, abs=0.05)
    assert snr_gain(cymg, BAYER, math.inf) < 0
    others = [snr_gain(cfa(name), BAYER, 0.0) for name in CFA_PATTERNS if name != "CYMG"]
    assert max(others) < snr_gain(cymg, BAYER, 0.0)
    pairs = [cfa(name) for name in CFA_PATTERNS if len(CFA_PATTERNS[name]) == 5 and name != "Bayer"]
    assert all(snr_gain(m, BAYER, 0.0) > 0 > snr_gain(m, BAYER, math.inf) for m in pairs)
    lens, mura, sines = (snr_gain(mask(kind, 11), PINHOLE, CHI2) for kind in ("lenslet", "MURA", "sum_of_sinusoids"))
    assert (lens > mura).all() and (lens > sines).all() and (lens > 0).all()
    assert mura[0] > 0 > mura[-1]
    assert (sines < 0).all()
    assert snr_gain(mask("MURA", 11), PINHOLE, 10**-0.93) > 7  # close to additive at the Dragonfly's chi^2


@pytest.mark.parametrize("p", [3, 5, 7, 17])
def test_sinusoids_lose_to_a_pinhole_at_any_size(p: int) -> None:
    assert (snr_gain(mask("sum_of_sinusoids", p), mask("pinhole", p), CHI2) < 0).all()


def test_gain_is_equation_14_for_equal_super_pixels() -> None:
    for chi2 in (0.0, 0.3, 12.0):
        a, b = cfa("CMYW"), BAYER
        s = [math.sqrt(1 + transmission(m) * chi2) for m in (a, b)]
        printed = 10 * math.log10(amplification(b) * s[1] / (amplification(a) * s[0]))
        assert snr_gain(a, b, chi2) == pytest.approx(printed, abs=1e-12)


def test_a_pattern_written_twice_gains_nothing() -> None:
    twice = cfa("RGRG/GBGB/RGRG/GBGB")
    np.testing.assert_allclose(snr_gain(twice, BAYER, CHI2), 0, atol=1e-12)
    assert amplification(twice) == pytest.approx(amplification(BAYER) / 2)


def test_gain_is_continuous_up_to_infinity() -> None:
    curve = snr_gain(cfa("CYMG"), BAYER, CHI2)
    assert (np.diff(curve) <= 1e-12).all()
    assert snr_gain(cfa("CYMG"), BAYER, 1e300) == pytest.approx(float(curve[-1]), abs=1e-12)
    assert snr_gain(BAYER, cfa("CYMG"), 2.0) == pytest.approx(-snr_gain(cfa("CYMG"), BAYER, 2.0))


@pytest.mark.parametrize("chi2", [0.0, 10**-0.93, 30.0, math.inf])
@pytest.mark.parametrize(
    ("modulator", "reference", "trials"),
    [
        (cfa("CYMG"), BAYER, 60_000),
        (cfa("X-Trans"), BAYER, 60_000),
        (mask("MURA", 11), PINHOLE, 1500),
        (mask("sum_of_sinusoids", 5), mask("pinhole", 5), 5000),
        (mask("lenslet", 5), mask("pinhole", 5), 5000),
    ],
    ids=lambda v: getattr(v, "name", None),
)
def test_monte_carlo_agrees_within_one_per_cent(modulator, reference, trials: int, chi2: float) -> None:
    measured = monte_carlo_gain(modulator, reference, chi2, rng=np.random.default_rng(5), trials=trials)
    ratio = 10 ** ((measured - snr_gain(modulator, reference, chi2)) / 10)
    assert ratio == pytest.approx(1, abs=0.01)


def test_shot_noise_of_each_pixel_changes_little() -> None:
    """Equation 12 takes the mean light; each pixel's own costs CYMG 0.16 dB more where photon noise rules."""
    measured = monte_carlo_gain(
        cfa("CYMG"), BAYER, math.inf, rng=np.random.default_rng(1), trials=60_000, noise="pixel"
    )
    assert snr_gain(cfa("CYMG"), BAYER, math.inf) - measured == pytest.approx(0.16, abs=0.05)


def test_curves_carry_cameras_and_numbers() -> None:
    curves = gain_curves([cfa("CYMG"), BAYER], BAYER, cameras={"mine": 7.0})
    assert curves.gains.shape == (2, len(curves.chi2))
    np.testing.assert_allclose(curves.gains[1], 0, atol=1e-12)
    assert curves.cameras == {"PG Dragonfly": pytest.approx(10**-0.93), "mine": 7.0}
    assert curves.alpha[0] == amplification(cfa("CYMG"))


def test_chi2_of_a_camera() -> None:
    assert camera_chi2(preset("r29").sensor) == pytest.approx(20e3 / (144 + (20e3 / 4095) ** 2 / 12))
    assert camera_chi2(preset("r29").sensor, gain=4) == pytest.approx(5e3 / (144 + (5e3 / 4095) ** 2 / 12))
    assert camera_chi2(Sensor(read_noise_e=0.0)) == pytest.approx(12 * 4095**2 / 20e3)


@pytest.mark.parametrize("chi2", [-1.0, math.nan, [0.0, -2.0]])
def test_bad_chi2(chi2) -> None:
    with pytest.raises(InputError, match="chi"):
        snr_gain(BAYER, BAYER, chi2)


def test_unlike_samples_are_not_compared() -> None:
    with pytest.raises(InputError, match="3 plenoptic samples"):
        snr_gain(BAYER, PINHOLE, 0.0)
    with pytest.raises(InputError, match="recovers every sample"):
        snr_gain(BAYER, cfa("RRRG"), 0.0)
