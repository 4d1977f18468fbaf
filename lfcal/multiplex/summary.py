"""Key figures of modulators."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from lfcal.base import InputError
from lfcal.multiplex._colour_error import colour_error
from lfcal.multiplex._sensor_noise import SensorNoise
from lfcal.multiplex.colour_filters import parse_pattern
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.noise import amplification, sample_deviation, sensor_gain, snr_gain, transmission
from lfcal.multiplex.quality import modulation_transfer
from lfcal.multiplex.spectra import shipped_spectra

__all__ = ["Merits", "ModulatorNumbers", "describe", "merits"]

MOST_ENTRIES = 40_000
"""Largest product of pixels and samples for which the MTF is measured: masks of 13 x 13 px."""


@dataclass(frozen=True, slots=True)
class ModulatorNumbers:
    """Key figures of a modulator.

    Attributes
    ----------
    name
        Name of the modulator.
    side
        Pixels ``(rows, columns)`` of the super-pixel.
    pixels, samples, rank
        Number K of pixels, number N of samples, and number of independent measurements (`Modulator.rank`).
    condition
        Ratio of the largest to the smallest singular value; infinite if rank < N.
    transmission, amplification
        Transmission tau and noise amplification alpha.
    lost
        Unrecoverable fraction (0 to 1) of each sample that is not fully recovered, by the name of the sample.
    gain_additive_db, gain_photon_db, gain_db
        Gain over the reference at chi^2 = 0, at infinity and at the camera's chi^2 (dB); None without a reference.
    """

    name: str
    side: tuple[int, int]
    pixels: int
    samples: int
    rank: int
    condition: float
    transmission: float
    amplification: float
    lost: dict[str, float]
    gain_additive_db: float | None = None
    gain_photon_db: float | None = None
    gain_db: float | None = None


def describe(
    modulator: Modulator, reference: Modulator | None = None, chi2: float | None = None, rcond: float | None = None
) -> ModulatorNumbers:
    """Return the key figures of a modulator, with its gains if a reference with as many samples is given.

    Parameters
    ----------
    modulator, reference
        As in `lfcal.multiplex.snr_gain`.
    chi2
        Ratio chi^2 of photon to additive noise variance of the camera (`camera_chi2`), 0 to inf. None: ``gain_db`` of
        the result is None.
    rcond
        Singular values up to this fraction of the largest count as zero. None: `default_rcond`.
    """
    gains: list[float | None] = [None, None, None]
    if reference is not None and reference.count == modulator.count:
        ratios = (0.0, math.inf, chi2)
        gains = [None if c is None else snr_gain(modulator, reference, c) for c in ratios]
    shares = modulator.lost(rcond)
    rank = modulator.rank(rcond)
    condition = modulator.condition if rank == modulator.count else math.inf
    lost = {name: float(s) for name, s in zip(modulator.sample_names, shares, strict=True) if s > 1e-9}
    return ModulatorNumbers(
        modulator.name,
        modulator.side,
        modulator.pixels,
        modulator.count,
        rank,
        condition,
        transmission(modulator),
        amplification(modulator, rcond=rcond),
        lost,
        *gains,
    )


class Merits(NamedTuple):
    """Benefit of a modulator for a sensor; values that do not apply are None.

    Attributes
    ----------
    gain_plain_db, gain_optimal_db
        Gain over the reference with the sensor's noise, for plain and noise-optimal decorrelation (dB).
    worst_noise_percent
        Largest standard deviation of a sample (% of full scale).
    mtf_low, mtf_high, false_detail
        Mean over samples of the MTF at 0.1 and 0.25 cycles per pixel, and of the aliasing at 0.25.
    delta_e, delta_e_noise
        Mean colour error (CIEDE2000) of 100 smooth reflectances with the included filters, and the rms colour
        difference that noise causes.
    """

    gain_plain_db: float | None
    gain_optimal_db: float | None
    worst_noise_percent: float
    mtf_low: float | None
    mtf_high: float | None
    false_detail: float | None
    delta_e: float | None
    delta_e_noise: float | None


def merits(
    modulator: Modulator,
    noise: SensorNoise,
    reference: Modulator | None = None,
    *,
    pattern: str = "",
    filter: str | None = None,
    most_entries: int = MOST_ENTRIES,
) -> Merits:
    """Return the benefit of a modulator for a sensor.

    Parameters
    ----------
    modulator, reference
        As in `lfcal.multiplex.sensor_gain`; without a reference there are no gains.
    noise
        Noise of the sensor.
    pattern
        Name or rows of the colour filter array; its colour error is computed if lfcal includes the curves of its
        filters. Empty: no colour error.
    filter
        Filter of the reconstruction for the MTF. None: the default of `lfcal.multiplex.demultiplex`.
    most_entries
        Largest product of pixels and samples for which the MTF is measured. Above it, the measurement would take
        minutes and gigabytes.
    """
    plain = optimal = low = high = false = None
    if reference is not None:
        plain, optimal = (sensor_gain(modulator, reference, noise, decorrelation=way) for way in ("plain", "optimal"))
    if modulator.count * modulator.pixels <= most_entries:
        waves = modulation_transfer(modulator, [0.1, 0.25], filter=filter)
        low, high = waves.transfer.mean(0).tolist()
        false = float(waves.aliased[:, 1].mean())
    worst = 100 * float(sample_deviation(modulator, noise).max())
    return Merits(plain, optimal, worst, low, high, false, *_colour_errors(modulator, pattern, noise))


def _colour_errors(modulator: Modulator, pattern: str, noise: SensorNoise) -> tuple[float | None, float | None]:
    if not pattern or modulator.colours != ("R", "G", "B") or modulator.views != (1, 1):
        return None, None
    try:
        rows = "/".join(parse_pattern(pattern))
        found = colour_error(rows, efficiency=shipped_spectra("silicon"), noise=noise)
    except InputError:  # a user's matrix, or filters without curves, such as emerald
        return None, None
    return found.mean, found.noise
