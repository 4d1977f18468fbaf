"""Transmission, amplification and gain: closed forms, the paper's statements and figures, Monte Carlo, acquisitions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Sensor, preset
from lfcal.multiplex import (
    CFA_PATTERNS,
    MASKS,
    acquire_light_field,
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
from lfcal.multiplex.noise import PAPER_CAMERAS
from lfcal.multiplex.paper import paper_figure
from lfcal.multiplex.scenes import filament_light_field

BAYER = cfa("Bayer")
PINHOLE = mask("pinhole", 11)
CHI2 = np.concatenate([[0.0], np.logspace(-4, 4, 33), [math.inf]])


def test_closed_forms_of_amplification_and_transmission() -> None:
    for modulator, alpha, tau in (
        (BAYER, math.sqrt(2.5 / 3), 1 / 3),
        (cfa("CYMG"), math.sqrt(13 / 21), 7 / 12),
        (PINHOLE, 1.0, 1 / 121),
        (mask("lenslet", 11), 1 / 121, 1.0),
        (cfa("RGBW"), math.sqrt(2.25 / 3), 1 / 2),
        (cfa("CYYM"), math.sqrt(1.875 / 3), 2 / 3),
        *((mask("MURA", p), 2 * p / (p * p - 1), (p * p - 1) / 2 / p**2) for p in (3, 5, 7, 11, 13, 17)),
    ):
        assert amplification(modulator) == pytest.approx(alpha, rel=0, abs=1e-12), modulator.name
        assert transmission(modulator) == pytest.approx(tau, rel=0, abs=1e-12), modulator.name
    for name in CFA_PATTERNS:
        m = cfa(name)
        printed = np.linalg.inv(m.plenoptic @ m.spatial.T @ m.spatial @ m.plenoptic.T)
        assert amplification(m) == pytest.approx(math.sqrt(np.trace(printed) / m.count), rel=1e-12), name


def test_amplification_of_recoverable_samples() -> None:
    """Red and green from two pixels each, blue from none: a variance of 1/2 each, over two samples and not three."""
    poor = cfa("RRGG")
    assert amplification(poor) == math.inf
    assert amplification(poor, recoverable=True) == pytest.approx(math.sqrt(1 / 2))
    assert amplification(BAYER, recoverable=True) == amplification(BAYER)
    for rank in (1, 2, 4):
        rng = np.random.default_rng(rank)
        matrix = np.abs(rng.standard_normal((9, rank))) @ np.abs(rng.standard_normal((rank, 4)))
        m = modulator_from_matrix("few", (3, 3), matrix / matrix.max(), views=(2, 2))
        noise = rng.standard_normal((40_000, 9)) @ np.linalg.pinv(m.matrix, rcond=1e-9).T
        out = math.sqrt(float((noise**2).sum(1).mean()) / rank)
        assert amplification(m, rcond=1e-9, recoverable=True) == pytest.approx(out, rel=0.02), rank


def test_the_statements_of_the_paper() -> None:
    """Alternative filters are slightly better with additive noise; lenslets always; sums of sinusoids never."""
    cymg, ends = cfa("CYMG"), [0.0, math.inf]
    assert snr_gain(cymg, BAYER, chi2=0.0) == pytest.approx(0.6, abs=0.05)
    assert all(snr_gain(cfa(name), BAYER, 0.0) < snr_gain(cymg, BAYER, 0.0) for name in CFA_PATTERNS if name != "CYMG")
    pairs = [cfa(name) for name in CFA_PATTERNS if len(CFA_PATTERNS[name]) == 5 and name != "Bayer"]
    for weak, bright in (snr_gain(m, BAYER, ends) for m in [*pairs, cfa("RGBE"), cymg]):
        assert weak > 0 > bright
    lens, mura, sines = (snr_gain(mask(kind, 11), PINHOLE, CHI2) for kind in ("lenslet", "MURA", "sum_of_sinusoids"))
    assert (lens > np.maximum(mura, sines)).all() and (lens > 0).all() and mura[0] > 0 > mura[-1]
    assert snr_gain(mask("MURA", 11), PINHOLE, 10**-0.93) > 7  # close to additive at the Dragonfly's chi^2
    for p in (3, 5, 7, 11, 17):
        assert (snr_gain(mask("sum_of_sinusoids", p), mask("pinhole", p), CHI2) < 0).all()


def test_gain_is_equation_14_for_equal_super_pixels() -> None:
    for chi2 in (0.0, 0.3, 12.0):
        a, b = cfa("CMYW"), BAYER
        s = [math.sqrt(1 + transmission(m) * chi2) for m in (a, b)]
        printed = 10 * math.log10(amplification(b) * s[1] / (amplification(a) * s[0]))
        assert snr_gain(a, b, chi2) == pytest.approx(printed, abs=1e-12)
    # a pattern written twice gains nothing
    twice = cfa("RGRG/GBGB/RGRG/GBGB")
    np.testing.assert_allclose(snr_gain(twice, BAYER, CHI2), 0, atol=1e-12)
    assert amplification(twice) == pytest.approx(amplification(BAYER) / 2)
    curve = snr_gain(cfa("CYMG"), BAYER, CHI2)
    assert (np.diff(curve) <= 1e-12).all()
    assert snr_gain(cfa("CYMG"), BAYER, 1e300) == pytest.approx(float(curve[-1]), abs=1e-12)
    assert snr_gain(BAYER, cfa("CYMG"), 2.0) == pytest.approx(-snr_gain(cfa("CYMG"), BAYER, 2.0))


@pytest.mark.few(5)
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


def test_gain_curves_have_cameras_and_numbers() -> None:
    curves = gain_curves([cfa("CYMG"), BAYER], BAYER, cameras={"mine": 7.0})
    assert curves.gains.shape == (2, len(curves.chi2))
    np.testing.assert_allclose(curves.gains[1], 0, atol=1e-12)
    assert curves.cameras == {"PG Dragonfly": pytest.approx(10**-0.93), "mine": 7.0}
    assert curves.alpha[0] == amplification(cfa("CYMG"))


def test_chi2_of_a_camera() -> None:
    assert camera_chi2(preset("r29").sensor) == pytest.approx(20e3 / (144 + (20e3 / 4095) ** 2 / 12))
    assert camera_chi2(preset("r29").sensor, gain=4) == pytest.approx(5e3 / (144 + (5e3 / 4095) ** 2 / 12))
    assert camera_chi2(Sensor(read_noise_e=0.0)) == pytest.approx(12 * 4095**2 / 20e3)


def test_wrong_chi2_and_modulators_of_other_samples_are_refused() -> None:
    for chi2 in (-1.0, math.nan, [0.0, -2.0]):
        with pytest.raises(InputError, match="chi"):
            snr_gain(BAYER, BAYER, chi2)
    with pytest.raises(InputError, match="3 plenoptic samples"):
        snr_gain(BAYER, PINHOLE, 0.0)
    with pytest.raises(InputError, match="recovers every sample"):
        snr_gain(BAYER, cfa("RRRG"), 0.0)


def number(words: str, before: str) -> float:
    """Return the number after some words of a line."""
    return float(words.split(before)[1].split()[0])


def test_figure_3_spatial_does_not_ring_and_fourier_does() -> None:
    panels = {p.title: p for p in paper_figure(3).panels}
    fourier, spatial = (number(panels[name].numbers, "uniform parts") for name in ("Fourier", "spatial, cubic"))
    assert fourier > 1 > spatial
    assert number(panels["spatial, cubic"].numbers, "rms") < number(panels["Fourier"].numbers, "rms")
    assert panels["Fourier"].image.shape == panels["spatial, cubic"].image.shape == (40, 50, 3)
    # shown as bright as the scene is: neither black nor burnt out
    for title in ("ground truth, magnified", "spatial, cubic"):
        image = np.asarray(panels[title].image, float)
        assert 0.1 * image.max() < image.mean() < 0.9 * image.max() and len(np.unique(image)) > 2, title


def test_figure_5_has_one_scale_and_cubic_channels_avoid_ringing() -> None:
    found = paper_figure(5)
    assert len({p.levels for p in found.panels}) == 1 and len(found.panels) == 6 and found.columns == 3
    for row in (found.panels[:3], found.panels[3:]):
        rings = [number(p.numbers, "uniform parts") for p in row]
        assert rings[2] < 0.2 * rings[1] < 0.2 * rings[0]


def test_figure_6_marks_the_camera_of_the_user() -> None:
    for _, curves in paper_figure(6, camera="mine", chi2=30.0).curves:
        assert curves.cameras["mine"] == 30.0 and set(PAPER_CAMERAS) <= set(curves.cameras)


@pytest.mark.long
def test_figure_7_orders_the_modulators_as_the_paper() -> None:
    found = paper_figure(7)
    views = found.panels[4:]
    order = [number(p.numbers, "SNR") for p in views]
    assert order == sorted(order, reverse=True) and len({p.levels for p in views}) == 1
    assert [number(p.numbers, "forecast") for p in views] == pytest.approx([20.6, 7.2, 0.0, -0.9], abs=0.06)


def test_a_figure_that_is_none_of_these_is_refused() -> None:
    with pytest.raises(InputError):
        paper_figure(4)


@pytest.mark.long
def test_figure_7_of_a_camera_in_bright_light() -> None:
    bright = paper_figure(7, camera="mine", chi2=1e3)
    assert "mine" in bright.title and number(bright.panels[5].numbers, "forecast") < 0


DRAGONFLY = 10**-0.93


def test_measured_gain_is_the_forecast() -> None:
    """Even light: the noise of demultiplexed views compared with a pinhole's, as in figure 7."""
    light = np.full((25, 100, 100), 1 / 25)
    kinds = [mask(kind, 5) for kind in MASKS]
    for chi2 in (DRAGONFLY, math.inf):
        rng = np.random.default_rng(0)
        found = acquire_light_field(light, kinds, chi2=chi2, signal_e=1e6, rng=rng, filter="nearest")
        for one in found:
            gain = 10 * math.log10(found[0].noise / one.noise)
            assert gain == pytest.approx(snr_gain(one.modulator, kinds[0], chi2), abs=0.1)
            assert one.snr_db == pytest.approx(10 * math.log10(1 / 25 / one.noise))


def test_the_order_of_modulators_is_that_of_figure_7() -> None:
    scene = filament_light_field(5, (24, 28), np.random.default_rng(3))
    kinds = [mask(kind, 5) for kind in ("lenslet", "MURA", "pinhole", "sum_of_sinusoids")]
    found = acquire_light_field(scene, kinds, chi2=DRAGONFLY, signal_e=2e4, rng=np.random.default_rng(4))
    noise = [one.noise for one in found]
    assert noise == sorted(noise)
    assert found[0].views.shape == (25, 24, 28) and found[0].frame.shape == (120, 140)
    # without noise each recovers the scene
    span = np.ptp(found[0].truth)
    assert all(np.sqrt(np.mean((one.clean - one.truth) ** 2)) < 0.05 * span for one in found)


def test_scene_is_a_light_field() -> None:
    scene = filament_light_field(5, (12, 14), np.random.default_rng(3))
    assert scene.shape == (25, 60, 70) and scene.min() > 0 and scene.sum(0).max() <= 1 + 1e-6
    assert np.abs(scene[0] - scene[24]).max() > 0.1 * scene.max(), "views must differ"


def test_wrong_acquisitions_are_refused() -> None:
    for kind, chi2 in ((mask("MURA", 5), 0.0), (cfa("Bayer"), 1.0)):
        with pytest.raises(InputError):
            acquire_light_field(np.ones((25, 10, 10)), [kind], chi2=chi2, rng=np.random.default_rng(0))
