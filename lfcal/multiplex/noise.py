"""Noise of multiplexed acquisition: transmission, noise amplification and SNR gain (equations 12 to 14).

In addition to equation 14, there are the gain of each sample and the gain for a sensor with all its noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words, check_choice
from lfcal.camera import Sensor
from lfcal.multiplex._sensor_noise import SensorNoise, sensor_noise
from lfcal.multiplex.modulator import Modulator

__all__ = [
    "PAPER_CAMERAS",
    "GainCurves",
    "GainMap",
    "amplification",
    "camera_chi2",
    "decorrelation_gain",
    "gain_curves",
    "gain_map",
    "monte_carlo_gain",
    "noise_optimal_inverse",
    "pixel_variance",
    "sample_deviation",
    "sensor_gain",
    "snr_gain",
    "transmission",
]

Array = NDArray[np.float64]

PAPER_CAMERAS: Mapping[str, float] = {"PG Dragonfly": 10**-0.93}
"""chi^2 of the camera in the paper (section 5)."""


def transmission(modulator: Modulator) -> float:
    """Return tau, the mean fraction of the unmodulated light (`Modulator.light`) that reaches the sensor, 0 to 1.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, mask, transmission
    >>> for one in (cfa("Bayer"), cfa("CYYM"), mask("pinhole", 11)):
    ...     print(f"{one.name}: {transmission(one):.3f}")
    Bayer: 0.333
    CYYM: 0.667
    pinhole: 0.008
    """
    return float((modulator.matrix @ modulator.light).mean())


def amplification(modulator: Modulator, *, rcond: float | None = None, recoverable: bool = False) -> float:
    """Return alpha, the rms noise of the recovered samples divided by that of a pixel.

    It is sqrt(trace((A^T A)^-1) / N) for the matrix A = Sigma Pi^T of a modulator with N samples. It is infinite if
    some combination of samples is not measured; with ``recoverable``, only measured combinations are included. Singular
    values of A up to ``rcond`` times the largest count as zero. None: `default_rcond`.

    Examples
    --------
    >>> from lfcal.multiplex import amplification, cfa, mask
    >>> print(f"{amplification(cfa('Bayer')):.3f}")  # two green pixels: sqrt((1 + 1/2 + 1) / 3)
    0.913
    >>> print(f"{amplification(mask('lenslet', 5)):.3f}")  # 25 times the light
    0.040
    >>> print(amplification(cfa("RC/CR")))  # red and cyan cannot separate green from blue
    inf
    """
    values = modulator.singular_values
    rank = modulator.rank(rcond)
    if rank == 0 or (rank < modulator.count and not recoverable):
        return math.inf
    # alpha is the rms over samples, of which trace counts the sum of squares of 1/singular values
    return math.sqrt(float((values[:rank] ** -2.0).sum()) / rank)


@overload
def snr_gain(modulator: Modulator, reference: Modulator, chi2: float) -> float: ...
@overload
def snr_gain(modulator: Modulator, reference: Modulator, chi2: Sequence[float] | Array) -> Array: ...
def snr_gain(modulator: Modulator, reference: Modulator, chi2: float | Sequence[float] | Array) -> float | Array:
    """Return the SNR gain over ``reference``, 10 log10(alpha_ref s_ref / (alpha s)) in dB (Ihrke et al., eq. 14).

    Here, alpha is `amplification`, tau is `transmission`, and s^2 = s_c^2 + tau s_p^2 is the noise variance of a pixel.
    Its parts are the variance s_c^2 of additive noise and the variance s_p^2 of photon noise at full scale, with
    chi^2 = s_p^2 / s_c^2 (eq. 12). Super-pixels of different size are compared per pixel. For K pixels, alpha is
    multiplied by sqrt(K), so that repeating a pattern does not change the gain. A modulator that does not recover every
    sample has a gain of minus infinity.

    Parameters
    ----------
    modulator, reference
        Modulators with the same number of plenoptic samples.
    chi2
        Ratio chi^2 of photon to additive noise variance at full scale, 0 to inf; a number or an array.

    Raises
    ------
    InputError
        If the numbers of samples differ, the reference does not recover all samples, or ``chi2`` is negative or NaN.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, snr_gain
    >>> print(snr_gain(cfa("CYMG"), cfa("Bayer"), [0.0, 1.0, 1e4]).round(2))  # dB; it loses where photon noise rules
    [ 0.65  0.27 -0.57]
    """
    ratios = np.asarray(chi2, float)
    if np.isnan(ratios).any() or (ratios < 0).any():
        raise InputError.expected("chi^2", "numbers from 0 to inf", chi2, "give numbers in this range")
    if modulator.count != reference.count:
        raise InputError.expected(
            f"reference of {modulator.name}",
            f"{modulator.count} plenoptic samples",
            reference.count,
            "compare modulators that recover the same samples",
        )
    if not math.isfinite(amplification(reference)):
        raise InputError.expected(
            f"reference {reference.name}",
            f"a reference of rank {reference.count}",
            f"rank {reference.rank()}",
            "choose a reference that recovers every sample",
        )
    # 10 log10 of a ratio of deviations is 5 log10 of that of variances
    result = 5 * (np.log10(_variance(reference, ratios)) - np.log10(_variance(modulator, ratios)))
    return result if result.ndim else float(result)


def noise_optimal_inverse(modulator: Modulator, covariance: ArrayLike) -> Array:
    """Return the decorrelation matrix ``(N, K)`` with the least noise, (A^T C^-1 A)^+ A^T C^-1 (Gauss-Markov).

    A is `Modulator.matrix` and C the noise covariance. If A is square and of full rank, the result is its inverse. If
    there are more pixels than samples, less noisy pixels have more weight.

    Parameters
    ----------
    modulator
        Modulator of the pixels.
    covariance
        Noise covariance C of the K pixels of a super-pixel: positive variances ``(K,)``, or a positive definite matrix
        ``(K, K)``, in any unit.

    Raises
    ------
    InputError
        If ``covariance`` has another shape, or is not positive definite.

    Examples
    --------
    >>> from lfcal.multiplex import modulator_from_matrix, noise_optimal_inverse
    >>> twice = modulator_from_matrix("two bare pixels", (1, 2), [[1.0], [1.0]])
    >>> print(noise_optimal_inverse(twice, [1.0, 4.0]).round(3), "plain", twice.inverse().round(3))
    [[0.8 0.2]] plain [[0.5 0.5]]
    """
    noise = np.asarray(covariance, float)
    full = np.diag(noise) if noise.ndim == 1 else noise
    good = full.shape == (modulator.pixels, modulator.pixels) and np.isfinite(full).all()
    values = np.linalg.eigvalsh(full) if good and np.allclose(full, full.T) else np.zeros(1)
    if not values[0] > 0:
        wanted = f"positive variances ({modulator.pixels},) or a positive definite matrix"
        raise InputError.expected(f"noise of {modulator.name}", wanted, array_words(noise), "give one of these")
    # whitened: the pseudo-inverse of L^-1 A with C = L L^T, least squares of unit noise
    white = np.linalg.inv(np.linalg.cholesky(full))
    return np.asarray(np.linalg.pinv(white @ modulator.matrix, rcond=1e-12) @ white)


def pixel_variance(modulator: Modulator, chi2: float) -> Array:
    """Return the noise variance of each pixel in unmodulated light, ``(K,)``, relative to that of an open pixel.

    It is (1 + chi^2 i)/(1 + chi^2) for a pixel that receives the fraction i of the unmodulated light. ``chi2``, 0 to
    inf, is the ratio of photon to additive noise variance of an open pixel. This is equation 12 of Ihrke et al. with
    the light of each pixel instead of the mean light.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, pixel_variance
    >>> for chi2 in (0.0, 1.0, float("inf")):  # red, green, blue, white
    ...     print(pixel_variance(cfa("RGBW"), chi2).round(3))
    [1. 1. 1. 1.]
    [0.667 0.667 0.667 1.   ]
    [0.333 0.333 0.333 1.   ]
    """
    if not chi2 >= 0:
        raise InputError.expected("chi^2", "a number from 0 to inf", chi2, "give a number in this range")
    additive = 1.0 / (1.0 + chi2)
    return np.asarray(additive + (1.0 - additive) * np.maximum(modulator.matrix @ modulator.light, 1e-12))


def decorrelation_gain(modulator: Modulator, chi2: float) -> float:
    """Return the SNR gain (dB, at least 0) of the noise-optimal over the unweighted decorrelation in unmodulated light.

    The noise is as in `pixel_variance` for ``chi2``, and the noise-optimal matrix as in `noise_optimal_inverse`.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, decorrelation_gain
    >>> for chi2 in (1.0, 1e4):  # white, the fourth pixel for three colours, is the noisiest in bright light
    ...     print(f"chi^2 = {chi2:g}: {decorrelation_gain(cfa('RGBW'), chi2):.2f} dB")
    chi^2 = 1: 0.01 dB
    chi^2 = 10000: 0.11 dB
    """
    variance = pixel_variance(modulator, chi2)
    plain, best = modulator.inverse(), noise_optimal_inverse(modulator, variance)
    gain = 5 * math.log10(float((plain**2 @ variance).sum()) / float((best**2 @ variance).sum()))
    # rounding may give a negative gain if the plain inverse is already optimal
    return max(0.0, gain)


def _variance(modulator: Modulator, chi2: Array) -> Array:
    """Return the variance of a sample per pixel, as a fraction of s_c^2 + s_p^2."""
    alpha = amplification(modulator)
    if not math.isfinite(alpha):
        return np.full(chi2.shape, math.inf)
    additive = 1.0 / (1.0 + chi2)
    variance: Array = modulator.pixels * alpha**2 * (additive + (1.0 - additive) * transmission(modulator))
    return variance


def camera_chi2(sensor: Sensor, *, gain: float = 1.0, exposure_s: float = 0.0) -> float:
    """Return chi^2 of a camera: the ratio of photon to additive noise variance at full scale.

    Parameters
    ----------
    sensor
        Sensor, whose full well, read noise, dark current and bit depth are used (`sensor_noise`). Without additive
        noise, chi^2 is inf.
    gain
        Amplifier gain as a factor (not dB): full scale corresponds to the full well divided by the gain (electrons).
    exposure_s
        Exposure time (s), which determines the dark signal.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.multiplex import camera_chi2
    >>> sensor = preset("r29").sensor
    >>> print(sensor.full_well_e, sensor.read_noise_e)  # electrons
    20000.0 12.0
    >>> print(f"{camera_chi2(sensor):.0f} {camera_chi2(sensor, gain=10):.1f}")  # 20000 / (12^2 + quantisation)
    137 13.9
    """
    return sensor_noise(sensor, gain=gain, exposure_s=exposure_s).chi2


@dataclass(frozen=True, eq=False)
class GainCurves:
    """SNR gain of several modulators as a function of chi^2, as in figure 6 of Ihrke et al.

    Attributes
    ----------
    names
        Names of the modulators.
    reference
        Name of the modulator to which the gains refer.
    chi2
        Ratios chi^2 of photon to additive noise variance, ``(n,)``.
    gains
        Gain of each modulator over the reference (dB), ``(len(names), n)``.
    alpha, tau
        Noise amplification (`amplification`) and transmission (`transmission`) of each modulator.
    cameras
        Mapping from names of cameras to their chi^2, to be marked in plots.

    Examples
    --------
    >>> from lfcal.multiplex import GainCurves, cfa, gain_curves
    >>> curves: GainCurves = gain_curves([cfa("CYYM")], cfa("Bayer"))
    >>> crossing = curves.chi2[curves.gains[0] > 0].max()
    >>> print(f"{curves.names[0]} is better than {curves.reference} up to chi^2 = {crossing:.2g}")
    CYYM is better than Bayer up to chi^2 = 1.4
    """

    names: tuple[str, ...]
    reference: str
    chi2: Array = field(repr=False)
    gains: Array = field(repr=False)
    alpha: tuple[float, ...]
    tau: tuple[float, ...]
    cameras: Mapping[str, float]


def gain_curves(
    modulators: Sequence[Modulator],
    reference: Modulator,
    chi2: ArrayLike | None = None,
    *,
    cameras: Mapping[str, float] | None = None,
) -> GainCurves:
    """Return the SNR gains (dB) of ``modulators`` over ``reference`` for several values of chi^2.

    ``chi2`` contains ratios of photon to additive noise variance; None: values from 1e-4 to 1e4. ``cameras`` maps names
    of cameras to chi^2 (`camera_chi2`), to be marked in plots in addition to the camera of Ihrke et al.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, gain_curves
    >>> curves = gain_curves([cfa("CYMG"), cfa("RGBW")], cfa("Bayer"), chi2=[0.01, 1, 100])
    >>> for name, gains in zip(curves.names, curves.gains):
    ...     print(name, gains.round(2), "dB")
    CYMG [ 0.64  0.27 -0.54] dB
    RGBW [ 0.23 -0.03 -0.63] dB
    """
    ratios = np.logspace(-4, 4, 161) if chi2 is None else np.asarray(chi2, float).ravel()
    gains = np.array([snr_gain(m, reference, ratios) for m in modulators])
    return GainCurves(
        tuple(m.name for m in modulators),
        reference.name,
        ratios,
        gains,
        tuple(amplification(m) for m in modulators),
        tuple(transmission(m) for m in modulators),
        dict(PAPER_CAMERAS) | dict(cameras or {}),
    )


def monte_carlo_gain(
    modulator: Modulator,
    reference: Modulator,
    chi2: float,
    *,
    rng: np.random.Generator,
    trials: int = 4000,
    noise: str = "mean",
) -> float:
    """Return the SNR gain (dB) over ``reference``, measured on simulated acquisitions of unmodulated light.

    Parameters
    ----------
    modulator, reference, chi2
        As in `snr_gain`.
    rng
        Random number generator for the noise.
    trials
        Number of super-pixels that are simulated for each modulator.
    noise
        Noise model. ``"mean"``: every pixel has the variance for the mean light, as in `snr_gain`. ``"pixel"``: each
        pixel has the shot noise of the light that it receives.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.multiplex import mask, monte_carlo_gain, snr_gain
    >>> mura, hole = mask("MURA", 5), mask("pinhole", 5)
    >>> gain = monte_carlo_gain(mura, hole, 0.1, rng=np.random.default_rng(0))
    >>> print(f"simulated {gain:.1f} dB, equation 14 {snr_gain(mura, hole, 0.1):.1f} dB")
    simulated 3.7 dB, equation 14 3.7 dB
    """
    errors = [math.sqrt(m.pixels) * _error(m, chi2, rng, trials, noise) for m in (modulator, reference)]
    return 10 * math.log10(errors[1] / errors[0])


def _error(modulator: Modulator, chi2: float, rng: np.random.Generator, trials: int, noise: str) -> float:
    """Return the rms error of the recovered samples for s_c^2 + s_p^2 = 1."""
    check_choice("noise", noise, ("mean", "pixel"))
    even = modulator.light
    light = modulator.matrix @ even
    level = np.full_like(light, light.mean()) if noise == "mean" else light
    additive = 1.0 / (1.0 + chi2)
    deviation = np.sqrt(additive + (1.0 - additive) * level)
    inverse = modulator.inverse()
    total = 0.0
    for start in range(0, trials, 512):  # limits memory, because a large mask has thousands of pixels
        n = min(512, trials - start)
        seen = light + deviation * rng.standard_normal((n, len(light)))
        total += float(((seen @ inverse.T - even) ** 2).sum())
    return math.sqrt(total / (trials * modulator.count))


DECORRELATIONS = ("plain", "optimal")


@dataclass(frozen=True, eq=False)
class GainMap:
    """SNR gain of each plenoptic sample (band, colour or view) of a modulator as a function of chi^2.

    Attributes
    ----------
    modulator, reference
        Name of the modulator, and name of the reference.
    samples
        Names of the N samples; wavelengths for spectral bands.
    chi2
        Ratios chi^2 of photon to additive noise variance, ``(n,)``.
    gains
        Gain of each sample over the reference (dB), ``(N, n)``; minus infinity for samples that the modulator does not
        recover.

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
    """Return the SNR gain (dB) of each sample of ``modulator`` over ``reference`` as a function of chi^2.

    The noise variance of sample n is s^2 sum_k (A^+)_nk^2, with the pseudo-inverse A^+ of `Modulator.matrix` and the
    pixel noise s of `snr_gain`. Super-pixels of different size are compared per pixel. The mean of these variances over
    the samples is the variance used by `snr_gain`.

    Parameters
    ----------
    modulator, reference
        Modulators with the same number of samples; the reference must recover all of them.
    chi2
        Ratios of photon to additive noise variance, 0 to inf. None: values from 1e-4 to 1e4.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, gain_map
    >>> found = gain_map(cfa("RG/BB"), cfa("Bayer"), 1.0)
    >>> print(found.samples, (10 ** (found.gains[:, 0] / 10)).round(3))  # half the green pixels, twice the blue ones
    ('R', 'G', 'B') [1.    0.707 1.414]
    """
    ratios = np.logspace(-4, 4, 81) if chi2 is None else np.atleast_1d(np.asarray(chi2, float))
    if np.isnan(ratios).any() or (ratios < 0).any():
        raise InputError.expected("chi^2", "numbers from 0 to inf", chi2, "give numbers in this range")
    if modulator.count != reference.count or reference.rank() < reference.count:
        got = f"{reference.name}: {reference.count} samples, rank {reference.rank()}"
        raise InputError.expected(
            "reference", f"a reference that recovers {modulator.count} samples", got, "choose another reference"
        )
    additive = 1.0 / (1.0 + ratios)
    logs = []
    for m in (reference, modulator):
        rows = m.pixels * (m.inverse() ** 2).sum(1)
        rows[m.lost() > 1e-9] = math.inf
        logs.append(np.log10(rows[:, None]) + np.log10(additive + (1 - additive) * transmission(m)))
    return GainMap(modulator.name, reference.name, modulator.sample_names, ratios, 5 * (logs[0] - logs[1]))


def sample_deviation(modulator: Modulator, noise: SensorNoise, *, decorrelation: str = "plain") -> Array:
    """Return the standard deviation of each sample, ``(N,)``, in unmodulated light, relative to full scale.

    Every pixel has the noise that corresponds to the light that it receives: read, dark, quantisation and shot noise,
    and response non-uniformity. Interpolation between super-pixels is not included.

    Parameters
    ----------
    modulator
        Modulator; samples that it does not recover have an infinite standard deviation.
    noise
        Noise model of the camera (`sensor_noise`).
    decorrelation
        ``"plain"``: unweighted least squares; ``"optimal"``: `noise_optimal_inverse` for this noise.

    Examples
    --------
    >>> from lfcal.multiplex import SensorNoise, cfa, sample_deviation
    >>> noise = SensorNoise(full_e=9000, additive_e2=100)
    >>> print((9000 * sample_deviation(cfa("Bayer"), noise)).round(1))  # electrons; sqrt(3000 + 100) of one pixel
    [55.7 39.4 55.7]
    """
    check_choice("decorrelation", decorrelation, DECORRELATIONS)
    variance = noise.variance(modulator.matrix @ modulator.light * noise.full_e) / noise.full_e**2
    if decorrelation == "optimal":  # a dark pixel has no shot noise; a tiny value keeps its variance positive
        inverse = noise_optimal_inverse(modulator, np.maximum(variance, 1e-12 * variance.max()))
    else:
        inverse = modulator.inverse()
    deviation = np.sqrt(inverse**2 @ variance)
    deviation[modulator.lost() > 1e-9] = math.inf
    return np.asarray(deviation)


def sensor_gain(
    modulator: Modulator, reference: Modulator, noise: SensorNoise, *, decorrelation: str = "plain"
) -> float:
    """Return the SNR gain over ``reference`` (dB) for the noise of a camera, at equal exposure and compared per pixel.

    Each pixel has the noise of the light that it receives, whereas `snr_gain` uses the mean light of all pixels.
    ``reference`` must have as many samples as ``modulator`` and recover all of them. The other parameters are those of
    `sample_deviation`.

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
        raise InputError.expected(
            "modulator and reference",
            "the same number of samples",
            got,
            "compare modulators that recover the same samples",
        )
    rms = [
        m.pixels * np.mean(sample_deviation(m, noise, decorrelation=decorrelation) ** 2) for m in (reference, modulator)
    ]
    if not math.isfinite(rms[0]):
        raise InputError.expected(
            f"reference {reference.name}",
            "a reference that recovers all samples",
            "one that recovers fewer",
            "choose another reference",
        )
    return -math.inf if math.isinf(rms[1]) else 5 * math.log10(float(rms[0] / rms[1]))
