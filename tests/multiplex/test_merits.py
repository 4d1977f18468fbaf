"""Merits besides equation 14: gains of every sample and sensor, colour error, resolution, designs that can be made."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from lfcal.base.errors import InputError
from lfcal.camera import Sensor
from lfcal.multiplex import (
    Spectra,
    bandpass_filters,
    cfa,
    mask,
    mask_at_distance,
    mask_gain_bound,
    modulator_from_matrix,
    noise_optimal_inverse,
    polarisers,
    sensor_noise,
    shipped_spectra,
    snr_gain,
    spectral_array,
)
from lfcal.multiplex._colour_error import colour_difference, colour_error, lab
from lfcal.multiplex.design import best_array, best_printed_mask, with_crosstalk
from lfcal.multiplex.noise import gain_map, sample_deviation, sensor_gain
from lfcal.multiplex.quality import modulation_transfer
from lfcal.multiplex.spectra import colour_matching

RNG = np.random.default_rng
SENSOR = Sensor(shape=(40, 40), bit_depth=10, full_well_e=8000.0, read_noise_e=6.0, dark_current_e_s=50.0, prnu=0.02)

SHARMA = """
50.0000 2.6772 -79.7751 50.0000 0.0000 -82.7485 2.0425
50.0000 3.1571 -77.2803 50.0000 0.0000 -82.7485 2.8615
50.0000 2.8361 -74.0200 50.0000 0.0000 -82.7485 3.4412
50.0000 -1.3802 -84.2814 50.0000 0.0000 -82.7485 1.0000
50.0000 -1.1848 -84.8006 50.0000 0.0000 -82.7485 1.0000
50.0000 -0.9009 -85.5211 50.0000 0.0000 -82.7485 1.0000
50.0000 0.0000 0.0000 50.0000 -1.0000 2.0000 2.3669
50.0000 -1.0000 2.0000 50.0000 0.0000 0.0000 2.3669
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0009 7.1792
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0010 7.1792
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0011 7.2195
50.0000 2.4900 -0.0010 50.0000 -2.4900 0.0012 7.2195
50.0000 -0.0010 2.4900 50.0000 0.0009 -2.4900 4.8045
50.0000 -0.0010 2.4900 50.0000 0.0010 -2.4900 4.8045
50.0000 -0.0010 2.4900 50.0000 0.0011 -2.4900 4.7461
50.0000 2.5000 0.0000 50.0000 0.0000 -2.5000 4.3065
50.0000 2.5000 0.0000 73.0000 25.0000 -18.0000 27.1492
50.0000 2.5000 0.0000 61.0000 -5.0000 29.0000 22.8977
50.0000 2.5000 0.0000 56.0000 -27.0000 -3.0000 31.9030
50.0000 2.5000 0.0000 58.0000 24.0000 15.0000 19.4535
50.0000 2.5000 0.0000 50.0000 3.1736 0.5854 1.0000
50.0000 2.5000 0.0000 50.0000 3.2972 0.0000 1.0000
50.0000 2.5000 0.0000 50.0000 1.8634 0.5757 1.0000
50.0000 2.5000 0.0000 50.0000 3.2592 0.3350 1.0000
60.2574 -34.0099 36.2677 60.4626 -34.1751 39.4387 1.2644
63.0109 -31.0961 -5.8663 62.8187 -29.7946 -4.0864 1.2630
61.2901 3.7196 -5.3901 61.4292 2.2480 -4.9620 1.8731
35.0831 -44.1164 3.7933 35.0232 -40.0716 1.5901 1.8645
22.7233 20.0904 -46.6940 23.0331 14.9730 -42.5619 2.0373
36.4612 47.8580 18.3852 36.2715 50.5065 21.2231 1.4146
90.8027 -2.0831 1.4410 91.1528 -1.6435 0.0447 1.4441
90.9257 -0.5406 -0.9208 88.6381 -0.8985 -0.7239 1.5381
6.7747 -0.2908 -2.4247 5.8714 -0.0985 -2.2286 0.6377
2.0776 0.0795 -1.1350 0.9033 -0.0636 -0.5514 0.9082
"""
"""Pairs of CIELAB colours and their difference, published by Sharma, Wu and Dalal 2005."""


def test_colour_differences_are_those_published() -> None:
    table = np.array([[float(v) for v in line.split()] for line in SHARMA.strip().splitlines()])
    found = colour_difference(table[:, :3], table[:, 3:6])
    np.testing.assert_allclose(found, table[:, 6], atol=1e-4)
    np.testing.assert_allclose(colour_difference(table[:, 3:6], table[:, :3]), found, atol=1e-9)
    assert lab([0.9505, 1.0, 1.089], [0.9505, 1.0, 1.089]) == pytest.approx([100, 0, 0], abs=1e-9)


def test_colour_error_of_filters() -> None:
    """Filters that are the eye's are without error; real-like ones are not, and noise adds to it."""
    waves = np.arange(390.0, 711.0, 1.0)
    d65 = shipped_spectra("illuminants").named("D65")
    eye = colour_matching(waves) / waves  # photons are counted, the eye's functions are of power
    eye = np.maximum(eye, 0) / eye.max()
    own = colour_error("X,Y/Z,Y", filters=Spectra(("X", "Y", "Z"), waves, eye), illuminant=d65)
    assert own.mean < 0.15 and own.worst < 0.6
    bayer = colour_error("RG/GB", efficiency=shipped_spectra("silicon"), noise=sensor_noise(SENSOR))
    assert 0.2 < bayer.mean < 5 and bayer.noise is not None and bayer.noise > 0
    noisy = colour_error("RG/GB", efficiency=shipped_spectra("silicon"), noise=sensor_noise(SENSOR, gain=16))
    assert noisy.noise > 2 * bayer.noise and noisy.mean == pytest.approx(bayer.mean)
    narrow = colour_error("F0,F1/F1,F2", filters=bandpass_filters([450, 540, 610], 10))
    assert narrow.mean > 10 * own.mean, "narrow bands miss what lies between"
    # white is white
    found = colour_error("RG/GB", reflectances=Spectra(("white",), np.array([400.0, 700]), np.ones((1, 2))))
    assert found.worst == pytest.approx(0, abs=1e-6)
    with pytest.raises(InputError, match="reflectances"):
        colour_error("RG/GB", reflectances=Spectra(("w",), np.array([400.0, 700]), np.full((1, 2), 50.0)))


def test_the_gain_is_the_mean_of_the_gains_of_samples() -> None:
    chi2 = [0.0, 1.0, math.inf]
    for one, two in (
        (cfa("CYMG"), cfa("Bayer")),
        (polarisers([[0, 45], [135, 90]]), polarisers([[0, 60, 120]])),
        (spectral_array("MY/CG", 3), spectral_array("RG/GB", 3)),
    ):
        found = gain_map(one, two, chi2)
        assert found.samples == one.sample_names and found.gains.shape == (3, 3)
        variances = [(m.inverse() ** 2).sum(1) * m.pixels for m in (one, two)]
        # rms over samples: the reference's share of each weighs its gain
        mean = 5 * np.log10(variances[1].sum() / (variances[1][:, None] * 10 ** (-found.gains / 5)).sum(0))
        np.testing.assert_allclose(mean, snr_gain(one, two, chi2), atol=1e-9)
        with pytest.raises(InputError):
            gain_map(one, cfa("RRGG"))
    assert np.isneginf(gain_map(cfa("RRGG"), cfa("Bayer"), 1.0).gains[2, 0])


@pytest.mark.parametrize(
    "modulator", [cfa("RGBW 4x4"), mask("MURA", 3), polarisers([[0, 45], [135, 90]])], ids=lambda m: m.name
)
def test_the_noise_of_the_sensor_by_monte_carlo(modulator) -> None:
    """Poisson, read, dark, quantised, uneven pixels: simulated count by count, within a percent."""
    noise = sensor_noise(SENSOR, exposure_s=0.5, flat_corrected=False)
    rng, trials = RNG(1), 40_000
    light = modulator.matrix @ modulator.light * SENSOR.full_well_e
    photo = rng.poisson(light, (trials, len(light))) + light * SENSOR.prnu * rng.standard_normal((trials, len(light)))
    dark = rng.poisson(25.0, photo.shape) - 25.0 + 6.0 * rng.standard_normal(photo.shape)
    step = SENSOR.electrons_per_count
    counts = np.rint((photo + dark) / step) * step / SENSOR.full_well_e
    optimal = noise_optimal_inverse(modulator, noise.variance(light))
    for decorrelation, inverse in (("plain", modulator.inverse()), ("optimal", optimal)):
        stated = sample_deviation(modulator, noise, decorrelation=decorrelation)
        measured = np.sqrt(np.mean((counts @ inverse.T - modulator.light) ** 2, axis=0))
        np.testing.assert_allclose(np.sqrt(np.mean(measured**2)), np.sqrt(np.mean(stated**2)), rtol=0.01)


def test_gain_of_a_sensor() -> None:
    noise = sensor_noise(SENSOR)
    assert sensor_gain(cfa("Bayer"), cfa("Bayer"), noise) == 0
    plain, best = (sensor_gain(cfa("RGBW 4x4"), cfa("Bayer"), noise, decorrelation=d) for d in ("plain", "optimal"))
    assert best > plain and sensor_gain(cfa("RRGG"), cfa("Bayer"), noise) == -math.inf
    # masks in even light are lit evenly: equation 12's mean is each pixel's own
    assert sensor_gain(mask("pinhole", 5), mask("pinhole", 5), noise) == 0
    found = sensor_gain(mask("lenslet", 5), mask("pinhole", 5), noise)
    assert found == pytest.approx(snr_gain(mask("lenslet", 5), mask("pinhole", 5), noise.chi2), abs=1e-9)


def test_modulation_transfer() -> None:
    identity = modulator_from_matrix("bare", (1, 1), np.ones((1, 1)))
    bare = modulation_transfer(identity, [0.0, 0.1, 0.4], filter="cubic")
    np.testing.assert_allclose(bare.transfer, 1, atol=1e-12)
    np.testing.assert_allclose(bare.aliased, 0, atol=1e-12)
    found = modulation_transfer(cfa("Bayer"), [0.02, 0.1, 0.2], filter="linear")
    # linear interpolation of every second pixel: what lies on a pixel is exact, between two cos(2 pi f)
    for k, f in enumerate(found.frequencies):
        assert found.transfer[0, k] == pytest.approx((1 + math.cos(2 * math.pi * f)) / 2, abs=0.02)
    assert (np.diff(found.transfer[0]) < 0).all() and (np.diff(found.aliased[0]) > 0).all()
    sinc = modulation_transfer(cfa("Bayer"), [0.2], route="fourier")
    assert sinc.transfer[0, 0] > found.transfer[0, 2]
    rows = modulation_transfer(mask("MURA", 3), [0.05], filter="cubic", axis="y")
    assert rows.transfer.shape == (9, 1) and 0.8 < rows.transfer.min() <= rows.transfer.max() < 1.05
    for bad in ([0.7], [0.6], [-0.1], [], [math.nan], [0.1, math.nan]):
        with pytest.raises(InputError, match="frequencies"):
            modulation_transfer(identity, bad)


# -- designs ------------------------------------------------------------------------------------------
def test_crosstalk_keeps_light_and_costs_gain() -> None:
    for m in (cfa("X-Trans"), mask("MURA", 5)):
        mixed = with_crosstalk(m, 0.1)
        assert mixed.matrix.mean() == pytest.approx(m.matrix.mean())
        assert snr_gain(mixed, m, 0.0) < -0.05
    assert np.array_equal(with_crosstalk(cfa("Bayer"), 0.0).matrix, cfa("Bayer").matrix)
    one = with_crosstalk(modulator_from_matrix("dot", (3, 3), np.eye(9)[:, 4:5]), 0.2).matrix.reshape(3, 3)
    np.testing.assert_allclose(one, [[0, 0.05, 0], [0.05, 0.8, 0.05], [0, 0.05, 0]])
    with pytest.raises(InputError):
        with_crosstalk(cfa("Bayer"), 0.9)


def test_the_best_array_is_the_best_of_all() -> None:
    """Each candidate by the public gain, one by one."""
    for crosstalk, chi2 in ((0.0, 0.0), (0.15, 0.0), (0.15, 20.0)):
        found = best_array((2, 2), chi2, letters="RGBCY", crosstalk=crosstalk)
        base = with_crosstalk(cfa("Bayer"), crosstalk)
        every = [
            float(snr_gain(with_crosstalk(cfa("".join(p[:2]) + "/" + "".join(p[2:])), crosstalk), base, chi2))
            for p in itertools.product("RGBCY", repeat=4)
        ]
        assert found.gain_db == pytest.approx(max(every), abs=1e-9) and found.exhaustive
        assert found.bound_db == found.gain_db and "best of all" in found.certificate
    assert best_array((2, 2), 1e4).modulator.name == "Bayer", "of equal layouts the known one"
    assert best_array((2, 2), 0.0).gain_db == pytest.approx(snr_gain(cfa("CYMG"), cfa("Bayer"), 0.0))


def test_limits_of_arrays_are_kept() -> None:
    free = best_array((2, 3), 0.0)
    few = best_array((2, 3), 0.0, most_kinds=3)
    bright = best_array((2, 3), 0.0, least_light=0.8)
    assert len(set(few.modulator.name.replace("/", ""))) <= 3 and few.gain_db <= free.gain_db
    assert bright.modulator.matrix.mean() >= 0.8 - 1e-9 and bright.gain_db < free.gain_db
    with pytest.raises(InputError, match="candidates"):
        best_array((4, 4), 0.0, crosstalk=0.1)
    letters = ({"letters": "RG"}, {"letters": "X"}, {"most_kinds": 2}, {"most_kinds": 0})
    for options in (*letters, {"crosstalk": math.nan}, {"crosstalk": 0.6}, {"least_light": math.nan}):
        with pytest.raises(InputError):
            best_array((2, 2), 1.0, **options)


@pytest.mark.long
@pytest.mark.parametrize(
    ("crosstalk", "chi2"),
    [(0.1, 10.0), *(pytest.param(*one, marks=pytest.mark.long) for one in ((0.0, 0.0), (0.1, 0.0), (0.0, 10.0)))],
)
def test_printed_masks(crosstalk: float, chi2: float) -> None:
    def gain(modulator, size: int) -> float:
        hole = with_crosstalk(mask("pinhole", size), crosstalk)
        return float(snr_gain(with_crosstalk(modulator, crosstalk), hole, chi2))

    small = best_printed_mask(3, chi2, crosstalk=crosstalk)
    every = [
        gain(mask_at_distance(np.array(p, float).reshape(3, 3), 1.0), 3)
        for p in itertools.product((0, 1), repeat=9)
        if any(p)
    ]
    assert small.exhaustive and small.gain_db == pytest.approx(max(every), abs=1e-9)
    large = best_printed_mask(5, chi2, crosstalk=crosstalk, starts=1)
    values = np.round(large.modulator.matrix, 9)
    assert set(np.unique(values)) <= {0.0, 1.0} and not large.exhaustive and "at most" in large.certificate
    assert large.gain_db == pytest.approx(gain(large.modulator, 5), abs=1e-9)
    assert gain(mask("MURA", 5), 5) - 1e-9 <= large.gain_db <= large.bound_db + 1e-9
    if not crosstalk:
        assert large.bound_db == pytest.approx(mask_gain_bound(5, chi2))
    for seed in range(50):  # no mask exceeds the bound
        assert gain(mask_at_distance(RNG(seed).random((5, 5)), 1.0), 5) <= large.bound_db + 1e-9


def test_masks_within_limits() -> None:
    dim = best_printed_mask(4, 0.0, most_light=0.3, levels=3, starts=1)
    assert dim.modulator.matrix[:, 0].mean() <= 0.3 + 1e-9
    grey = best_printed_mask(4, 10.0, levels=5, starts=1)
    assert np.allclose(grey.modulator.matrix * 4, np.rint(grey.modulator.matrix * 4), atol=1e-9)
    assert grey.gain_db >= best_printed_mask(4, 10.0, starts=1).gain_db - 0.05
    for options in ({"levels": 1}, {"crosstalk": 0.6}, {"least_light": 0.6, "most_light": 0.5}, {"most_light": 0.01}):
        with pytest.raises(InputError):
            best_printed_mask(3, 0.0, **options)
