"""Gains beyond equation 14: of each sample over chi^2, and of the user's sensor with all of its noise."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_choice
from lfcal.multiplex._sensor_noise import SensorNoise
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.noise import noise_optimal_inverse, transmission

__all__ = ["DECORRELATIONS", "GainMap", "gain_map", "sample_deviation", "sensor_gain"]

Array = NDArray[np.float64]

DECORRELATIONS = ("plain", "optimal")


@dataclass(frozen=True, eq=False)
class GainMap:
    """Gain of each sample (band, colour, view) over chi^2.

    Attributes
    ----------
    modulator, reference
        Names.
    samples
        Names of the samples: wavelengths where these are bands.
    chi2
        ``(n,)``.
    gains
        ``(N, n)`` in dB; minus infinity where the modulator does not recover the sample.

    Examples
    --------
    >>> from lfcal.multiplex import GainMap, cfa, gain_map
    >>> found: GainMap = gain_map(cfa("CYMG"), cfa("Bayer"))
    >>> print(found.modulator, "over", found.reference, found.samples, found.gains.shape)
    CYMG over Bayer ('R', 'G', 'B') (3, 81)
    >>> print(found.gains[:, 0].round(1), found.gains[:, -1].round(1))  # chi^2 of 1e-4 and 1e4
    [0.7 0.3 0.7] [-0.5 -0.9 -0.5]
    """

    modulator: str
    reference: str
    samples: tuple[str, ...]
    chi2: Array = field(repr=False)
    gains: Array = field(repr=False)


def gain_map(modulator: Modulator, reference: Modulator, chi2: ArrayLike | None = None) -> GainMap:
    """Return the gain of each sample over ``reference`` (dB), of which `snr_gain` is the mean in variance.

    The noise of sample n is that of its row of the decorrelation, s^2 sum_k (A^+)_nk^2 with equation 12's s; unlike
    super-pixels are compared per pixel.

    Parameters
    ----------
    modulator, reference
        Of the same samples; the reference must recover all.
    chi2
        0 … inf; by default from 1e-4 to 1e4.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, gain_map
    >>> found = gain_map(cfa("RG/BB"), cfa("Bayer"), 1.0)
    >>> print(found.samples, (10 ** (found.gains[:, 0] / 10)).round(3))  # half the green pixels, twice the blue ones
    ('R', 'G', 'B') [1.    0.707 1.414]
    """
    ratios = np.logspace(-4, 4, 81) if chi2 is None else np.atleast_1d(np.asarray(chi2, float))
    if np.isnan(ratios).any() or (ratios < 0).any():
        raise InputError.expected("chi^2", "numbers from 0 to inf", chi2, "correct it")
    if modulator.count != reference.count or reference.rank() < reference.count:
        got = f"{reference.name}: {reference.count} samples, rank {reference.rank()}"
        raise InputError.expected("reference", f"one that recovers {modulator.count} samples", got, "choose another")
    additive = 1.0 / (1.0 + ratios)
    logs = []
    for m in (reference, modulator):
        rows = m.pixels * (m.inverse() ** 2).sum(1)
        rows[m.lost() > 1e-9] = math.inf
        logs.append(np.log10(rows[:, None]) + np.log10(additive + (1 - additive) * transmission(m)))
    return GainMap(modulator.name, reference.name, modulator.sample_names, ratios, 5 * (logs[0] - logs[1]))


def sample_deviation(modulator: Modulator, noise: SensorNoise, *, decorrelation: str = "plain") -> Array:
    """Return the standard deviation of each sample ``(N,)`` of unmodulated light at full scale (shares of that light).

    Every pixel has the noise of its own light (read, dark, quantisation, shot, response); super-pixels as they are.

    Parameters
    ----------
    modulator
        Samples that are not recovered have an infinite deviation.
    noise
        The camera's, `lfcal.multiplex.sensor_noise`.
    decorrelation
        ``"plain"``: least squares; ``"optimal"``: `lfcal.multiplex.noise_optimal_inverse` of this noise.

    Examples
    --------
    >>> from lfcal.multiplex import SensorNoise, cfa, sample_deviation
    >>> noise = SensorNoise(full_e=9000, additive_e2=100)
    >>> print((9000 * sample_deviation(cfa("Bayer"), noise)).round(1))  # electrons; sqrt(3000 + 100) of one pixel
    [55.7 39.4 55.7]
    """
    check_choice("decorrelation", decorrelation, DECORRELATIONS)
    variance = noise.variance(modulator.matrix @ modulator.light * noise.full_e) / noise.full_e**2
    if decorrelation == "optimal":  # shot noise of a pixel in the dark is none: rounding keeps it a variance
        inverse = noise_optimal_inverse(modulator, np.maximum(variance, 1e-12 * variance.max()))
    else:
        inverse = modulator.inverse()
    deviation = np.sqrt(inverse**2 @ variance)
    deviation[modulator.lost() > 1e-9] = math.inf
    return np.asarray(deviation)


def sensor_gain(
    modulator: Modulator, reference: Modulator, noise: SensorNoise, *, decorrelation: str = "plain"
) -> float:
    """Return the gain over ``reference`` (dB) for a camera's own noise, at equal exposure, compared per pixel.

    Equation 14 with the noise of every pixel's own light, where `snr_gain` takes the mean light of all pixels.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.multiplex import mask, sensor_gain, sensor_noise
    >>> for gain in (1, 64):
    ...     noise = sensor_noise(preset("r29").sensor, gain=gain)
    ...     print(f"chi^2 {noise.chi2:.0f}: {sensor_gain(mask('lenslet', 5), mask('pinhole', 5), noise):.2f} dB")
    chi^2 137: 7.34 dB
    chi^2 2: 11.65 dB
    """
    if modulator.count != reference.count:
        got = f"{modulator.count} and {reference.count}"
        raise InputError.expected("modulator and reference", "the same number of samples", got, "choose others")
    rms = [
        m.pixels * np.mean(sample_deviation(m, noise, decorrelation=decorrelation) ** 2) for m in (reference, modulator)
    ]
    if not math.isfinite(rms[0]):
        raise InputError.expected(f"reference {reference.name}", "all samples recovered", "fewer", "choose another")
    return -math.inf if math.isinf(rms[1]) else 5 * math.log10(float(rms[0] / rms[1]))
