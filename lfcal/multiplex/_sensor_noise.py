"""Noise of a sensor, weights of recorded samples, and black level of recorded frames.

Noise consists of read, dark, shot, quantisation and fixed-pattern noise. The black level is one number, or one number
for each position in a pattern, as in RAW files.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, array_words, check_number
from lfcal.camera import Sensor

__all__ = ["SensorNoise", "black_level_map", "pixel_weights", "sensor_noise", "without_black_level"]


def black_level_map(levels: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the black level of every pixel, ``(rows, columns)``; for a single level, an array of shape ``()``.

    Parameters
    ----------
    levels
        One level, one per pixel ``(rows, columns)``, or the levels of a square pattern in row-major order, such as (R,
        G, G, B), as in the metadata ``black_level`` of a frame.
    shape
        Rows and columns of the frame; its first pixel is the first one of the pattern.

    Raises
    ------
    InputError
        If the levels are not finite, or are not those of a square pattern.
    """
    values = np.asarray(levels, float)
    if values.ndim == 2 and values.shape == tuple(shape) and np.isfinite(values).all():
        return values
    side = math.isqrt(values.size)
    if not values.size or side * side != values.size or not np.isfinite(values).all():
        raise InputError.expected(
            "black level",
            "a number, or the square array of numbers of a pattern's period",
            array_words(values),
            "give one of these",
        )
    if values.size == 1:
        return values.reshape(())
    rows, columns = (np.arange(n) % side for n in shape)
    found: NDArray[np.float64] = values.ravel()[rows[:, None] * side + columns]
    return found


def without_black_level(frame: ArrayLike, levels: ArrayLike) -> NDArray[Any]:
    """Return a copy of ``frame`` minus its black level: float64 for float64 frames, float32 for others.

    ``levels`` (counts) contains one black level, one for each pixel of a square pattern in row-major order, or one for
    each pixel of the frame.

    Examples
    --------
    >>> from lfcal.multiplex import without_black_level
    >>> raw = [[110, 220], [330, 400]]
    >>> without_black_level(raw, (10, 20, 30, 40)).tolist()  # of a pattern of 2 x 2, as RAW files state them
    [[100.0, 200.0], [300.0, 360.0]]
    >>> without_black_level(raw, 64).tolist()
    [[46.0, 156.0], [266.0, 336.0]]
    """
    raw = np.asarray(frame)
    if raw.ndim != 2 or raw.dtype.kind not in "uif":
        raise InputError.expected(
            "frame",
            "numbers in rows and columns",
            f"{raw.dtype} of shape {raw.shape}",
            "give one plane of real numbers",
        )
    kind = np.float64 if raw.dtype == np.float64 else np.float32
    light: NDArray[Any] = raw.astype(kind) - black_level_map(levels, raw.shape).astype(kind)
    return light


Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Noise model of a sensor: the variance of a pixel is additive_e2 + signal + (prnu signal)², in electrons².

    Attributes
    ----------
    full_e
        Signal at full scale (electrons), the signal of unmodulated light.
    additive_e2
        Signal-independent variance (electrons²) due to read noise, dark current, offsets and quantisation.
    prnu
        Relative rms of the photo-response non-uniformity; 0 if frames are corrected for it.

    Examples
    --------
    >>> from lfcal.multiplex import SensorNoise
    >>> noise = SensorNoise(full_e=10_000, additive_e2=100)  # read noise 10 electrons
    >>> print(noise.chi2, noise.variance([0, 900]).tolist())
    100.0 [100.0, 1000.0]
    """

    full_e: float
    additive_e2: float
    prnu: float = 0.0

    @property
    def chi2(self) -> float:
        """Ratio of photon-noise to additive-noise variance at full scale (Ihrke et al., eq. 12), 0 to inf."""
        return self.full_e / self.additive_e2 if self.additive_e2 > 0 else float("inf")

    def variance(self, electrons: ArrayLike) -> Array:
        """Return the noise variance (electrons²) of pixels with the given signals (electrons)."""
        signal = np.maximum(np.asarray(electrons, float), 0.0)
        return np.asarray(self.additive_e2 + signal + (self.prnu * signal) ** 2)


def sensor_noise(
    sensor: Sensor, *, gain: float = 1.0, exposure_s: float = 0.0, flat_corrected: bool = True
) -> SensorNoise:
    """Return the noise model of a sensor for an amplifier gain and an exposure time.

    Parameters
    ----------
    sensor
        Sensor, whose full well, read noise, dark current, bit depth, DSNU and PRNU are used.
    gain
        Amplifier gain as a factor (not dB): full scale corresponds to the full well divided by the gain (electrons).
    exposure_s
        Exposure time (s), which determines the dark signal.
    flat_corrected
        Whether fixed-pattern noise (DSNU and PRNU) is removed from frames by dark and flat-field correction, and is
        therefore not included.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.multiplex import sensor_noise
    >>> noise = sensor_noise(preset("r29").sensor, gain=2)
    >>> print(f"{noise.full_e:.0f} e- at full scale, {noise.additive_e2**0.5:.1f} e- of noise in the dark")
    10000 e- at full scale, 12.0 e- of noise in the dark
    """
    check_number("gain", gain, above=0)
    check_number("exposure (s)", exposure_s, at_least=0)
    step = sensor.electrons_per_count / gain
    dark = sensor.dark_current_e_s * exposure_s
    additive = sensor.read_noise_e**2 + dark + (0.0 if flat_corrected else (sensor.dsnu_e or 0.0) ** 2) + step**2 / 12
    return SensorNoise(sensor.full_well_e / gain, additive, 0.0 if flat_corrected else sensor.prnu)


def pixel_weights(
    frame: ArrayLike,
    sensor: Sensor,
    *,
    dead: ArrayLike | None = None,
    expected: ArrayLike | None = None,
    gain: float = 1.0,
    exposure_s: float = 0.0,
    flat_corrected: bool = True,
    black_level: ArrayLike | None = None,
) -> Array:
    """Return the weight of each pixel of a frame, ``(rows, columns)``: its inverse variance, or 0 if saturated or dead.

    Parameters
    ----------
    frame
        Raw frame ``(rows, columns)`` in counts, including the black level; saturated pixels (`Sensor.saturated_from`)
        get the weight 0. Weights are in counts^-2.
    sensor, gain, exposure_s, flat_corrected
        As in `sensor_noise`.
    dead
        Mask of the same shape, nonzero at dead pixels. None: no dead pixels.
    expected
        Counts from which to compute the shot noise, such as a prediction or a smoothed frame, of the same shape. None:
        the frame itself; because of its noise, dark pixels then get slightly too much weight.
    black_level
        Black level stated in the file of the frame (counts), as in `without_black_level`. None: that of ``sensor``.

    Raises
    ------
    InputError
        If the arrays have different shapes.

    Examples
    --------
    >>> from lfcal.camera import Sensor
    >>> from lfcal.multiplex import pixel_weights
    >>> sensor = Sensor(bit_depth=12, full_well_e=4095, read_noise_e=10)  # one electron per count
    >>> print(pixel_weights([[0, 100, 4095]], sensor).round(4))  # dark, lit, saturated: 1/100, 1/200, none
    [[0.01  0.005 0.   ]]
    """
    raw = np.asarray(frame, float)
    level = raw if expected is None else np.asarray(expected, float)
    bad = np.zeros(raw.shape, bool) if dead is None else np.asarray(dead).astype(bool)
    if raw.ndim != 2:
        raise InputError.expected("frame", "two axes (rows, columns)", f"shape {raw.shape}", "give one frame")
    for what, other in (("expected signal", level), ("dead pixels", bad)):
        if other.shape != raw.shape:
            wanted = f"shape {raw.shape}, as the frame has"
            raise InputError.expected(what, wanted, f"shape {other.shape}", "crop both to the same pixels")
    noise = sensor_noise(sensor, gain=gain, exposure_s=exposure_s, flat_corrected=flat_corrected)
    step = sensor.electrons_per_count / gain
    black = black_level_map(sensor.black_level if black_level is None else black_level, raw.shape)
    weights = step**2 / noise.variance((level - black) * step)
    weights[bad | ~np.isfinite(raw) | (raw >= sensor.saturated_from)] = 0.0
    return np.asarray(weights)
