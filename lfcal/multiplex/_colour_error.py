"""Measure the colour error (CIEDE2000) of a filter array and a colour matrix on reflectances."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_number
from lfcal.multiplex._sensor_noise import SensorNoise
from lfcal.multiplex.spectra import Spectra, colour_matching, shipped_spectra, spectral_array

__all__ = ["ColourError", "colour_difference", "colour_error", "lab", "smooth_reflectances"]

Array = NDArray[np.float64]

EDGES_NM = np.arange(400.0, 701.0, 5.0)


@dataclass(frozen=True, eq=False)
class ColourError:
    """CIEDE2000 colour differences between true and reconstructed colours of test reflectances.

    Attributes
    ----------
    differences
        Colour difference of each of the n reflectances, ``(n,)``.
    matrix
        Matrix ``(3, kinds)`` from the signals of the different kinds of filter to CIE XYZ, scaled such that white has Y
        = 1.
    noise
        Rms colour difference due to the noise of the camera; None if no noise model is given.

    Examples
    --------
    >>> from lfcal.multiplex import ColourError, colour_error
    >>> found: ColourError = colour_error("CYM/MCY")
    >>> print(found.matrix.shape, found.differences.shape, found.noise)
    (3, 3) (100,) None
    >>> print(f"{found.mean:.1f} in the mean, {found.worst:.0f} at most")
    6.8 in the mean, 29 at most
    """

    differences: Array = field(repr=False)
    matrix: Array = field(repr=False)
    noise: float | None

    @property
    def mean(self) -> float:
        """Mean CIEDE2000 difference over the reflectances; a difference of about 1 is just visible."""
        return float(self.differences.mean())

    @property
    def worst(self) -> float:
        """Largest CIEDE2000 difference over the reflectances."""
        return float(self.differences.max())


def lab(xyz: ArrayLike, white: ArrayLike) -> Array:
    """Return the CIELAB colours ``(..., 3)`` of XYZ ``(..., 3)`` for a white point ``(3,)`` (CIE 15)."""
    t = np.asarray(xyz, float) / np.asarray(white, float)
    f = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)


def colour_difference(one: ArrayLike, two: ArrayLike) -> Array:
    """Return the CIEDE2000 differences ``(...)`` between CIELAB colours ``one`` and ``two``, ``(..., 3)``.

    The calculation follows Sharma, Wu and Dalal (2005), Color Research and Application 30:21, and reproduces their test
    data.

    Examples
    --------
    >>> from lfcal.multiplex import colour_difference
    >>> print(colour_difference((50, 2.6772, -79.7751), (50, 0, -82.7485)).round(4))  # Sharma's first pair
    2.0425
    >>> print(colour_difference((50, 0, 0), [(51, 0, 0), (55, 0, 0)]).round(2))
    [1.   4.91]
    """
    (l1, a1, b1), (l2, a2, b2) = (np.moveaxis(np.asarray(v, float), -1, 0) for v in (one, two))
    mean_c = (np.hypot(a1, b1) + np.hypot(a2, b2)) / 2
    g = 0.5 * (1 - np.sqrt(mean_c**7 / (mean_c**7 + 25.0**7)))
    a1, a2 = (1 + g) * a1, (1 + g) * a2
    c1, c2 = np.hypot(a1, b1), np.hypot(a2, b2)
    h1, h2 = (np.degrees(np.arctan2(b, a)) % 360 for a, b in ((a1, b1), (a2, b2)))
    grey = c1 * c2 == 0
    turn = np.where(grey, 0.0, (h2 - h1 + 180) % 360 - 180)
    # opposite hues: the formula keeps +180 if h2 - h1 is +180
    turn = np.where(~grey & (h2 - h1 == 180), 180.0, turn)
    dl, dc, dh = l2 - l1, c2 - c1, 2 * np.sqrt(c1 * c2) * np.sin(np.radians(turn / 2))
    ml, mc = (l1 + l2) / 2, (c1 + c2) / 2
    total = h1 + h2
    far = np.abs(h1 - h2) > 180
    mh = np.where(grey, total, np.where(far, np.where(total < 360, (total + 360) / 2, (total - 360) / 2), total / 2))
    sl, sc, sh, rt = _weights(ml, mc, mh)
    return np.asarray(np.sqrt((dl / sl) ** 2 + (dc / sc) ** 2 + (dh / sh) ** 2 + rt * (dc / sc) * (dh / sh)))


def _weights(ml: Array, mc: Array, mh: Array) -> tuple[Array, Array, Array, Array]:
    """Return S_L, S_C, S_H and R_T of CIEDE2000 at mean lightness, chroma and hue (degrees)."""
    cosines = ((-0.17, 1, -30.0), (0.24, 2, 0.0), (0.32, 3, 6.0), (-0.20, 4, -63.0))
    t = 1 + sum(weight * np.cos(np.radians(k * mh + phase)) for weight, k, phase in cosines)
    sl = 1 + 0.015 * (ml - 50) ** 2 / np.sqrt(20 + (ml - 50) ** 2)
    rotation = 60 * np.exp(-(((mh - 275) / 25) ** 2))
    rt = -2 * np.sqrt(mc**7 / (mc**7 + 25.0**7)) * np.sin(np.radians(rotation))
    return sl, 1 + 0.045 * mc, 1 + 0.015 * mc * t, rt


def smooth_reflectances(count: int, rng: np.random.Generator) -> Spectra:
    """Return ``count`` random smooth reflectance spectra between 400 and 700 nm, as a model of surfaces."""
    check_number("reflectances", count, at_least=1, at_most=100_000, integer=True)
    waves = np.linspace(395.0, 705.0, 63)
    phase = np.pi * (waves - 395) / 310
    amplitudes = rng.standard_normal((count, 6)) * np.array([1.5, 1.5, 1.2, 0.8, 0.5, 0.3])
    shapes = amplitudes @ np.cos(np.outer(np.arange(6), phase))
    return Spectra(tuple(f"surface {k}" for k in range(count)), waves, 0.02 + 0.96 / (1 + np.exp(-shapes)), "random")


def colour_error(
    pattern: str,
    *,
    filters: Spectra | None = None,
    illuminant: Spectra | None = None,
    efficiency: Spectra | None = None,
    reflectances: Spectra | None = None,
    noise: SensorNoise | None = None,
    rng: np.random.Generator | None = None,
) -> ColourError:
    """Return the colour error of a filter array, with the best linear conversion from its signals to CIE XYZ.

    The conversion matrix is fitted to 200 smooth reflectances, under the condition that white remains white. It is
    tested with other reflectances.

    Parameters
    ----------
    pattern, filters, efficiency
        As in `lfcal.multiplex.spectral_array`.
    illuminant
        Relative spectral power of the illuminant, one curve. None: D65.
    reflectances
        Reflectances for the test. None: 100 random smooth ones.
    noise
        Noise model of the camera, from which the resulting colour error is computed for unmodulated light at full
        scale. None: no noise.
    rng
        Random number generator for reflectances and noise. None: one with a fixed seed.

    Examples
    --------
    >>> from lfcal.multiplex import SensorNoise, colour_error
    >>> for pattern in ("RG/GB", "CY/MG"):
    ...     found = colour_error(pattern, noise=SensorNoise(full_e=2000, additive_e2=25))
    ...     print(pattern, f"{found.mean:.1f} in the mean, {found.noise:.0f} by noise")
    RG/GB 5.6 in the mean, 5 by noise
    CY/MG 2.5 in the mean, 29 by noise
    """
    random = rng or np.random.default_rng(0)
    light = shipped_spectra("illuminants").named("D65") if illuminant is None else illuminant
    train, test = smooth_reflectances(200, random), reflectances or smooth_reflectances(100, random)
    array = spectral_array(pattern, EDGES_NM.tolist(), filters=filters, illuminant=light, efficiency=efficiency)
    kinds = np.unique(np.round(array.matrix, 12), axis=0) * array.light  # of reflectances in the bands
    middles = (EDGES_NM[1:] + EDGES_NM[:-1]) / 2
    eye = colour_matching(middles) * light.on(middles)[0]
    eye /= eye[1].sum()
    shown = [s.on(middles) for s in (train, test)]
    for values in shown:
        if values.min() < 0 or values.max() > 1:
            raise InputError.expected(
                "reflectances",
                "values from 0 to 1",
                f"values from {values.min():.3g} to {values.max():.3g}",
                "give fractions, not per cent",
            )
    matrix = _fitted(shown[0] @ kinds.T, shown[0] @ eye.T, kinds.sum(1), eye.sum(1))
    white, seen = eye.sum(1), shown[1] @ kinds.T
    truth, found = lab(shown[1] @ eye.T, white), lab(seen @ matrix.T, white)
    return ColourError(colour_difference(truth, found), matrix, _noise(seen, matrix, white, found, noise, random))


def _fitted(seen: Array, wanted: Array, white: Array, white_xyz: Array) -> Array:
    """Return the matrix with the least squared error that maps white to white."""
    fit = np.linalg.lstsq(seen, wanted, rcond=None)[0].T
    # the constraint by one Lagrange multiplier in the metric of the samples
    step = np.linalg.pinv(seen.T @ seen) @ white
    result: Array = fit + np.outer(white_xyz - fit @ white, step) / float(white @ step)
    return result


def _noise(
    seen: Array, matrix: Array, white: Array, clean: Array, noise: SensorNoise | None, rng: np.random.Generator
) -> float | None:
    if noise is None:
        return None
    deviation = np.sqrt(noise.variance(seen * noise.full_e)) / noise.full_e
    trials = seen + deviation * rng.standard_normal((32, *seen.shape))
    return float(np.sqrt(np.mean(colour_difference(lab(trials @ matrix.T, white), clean) ** 2)))
