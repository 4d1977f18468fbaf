"""What there is to say about a modulator in numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.noise import amplification, snr_gain, transmission

__all__ = ["ModulatorNumbers", "describe"]


@dataclass(frozen=True, slots=True)
class ModulatorNumbers:
    """One modulator's numbers.

    Attributes
    ----------
    name
        Its name.
    side
        Pixels ``(rows, columns)`` of the super-pixel.
    pixels, samples, rank
        K, N, and how many combinations of the N samples are measured.
    condition
        Largest over smallest singular value; infinite where rank < N.
    transmission, amplification
        tau and alpha.
    lost
        Names of the samples that are not recovered whole, and the share of each that is lost.
    gain_additive_db, gain_photon_db, gain_db
        Gain over the reference at chi^2 = 0, infinity, and the camera's (dB); None without a reference.
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
    """Return the numbers of a modulator, with its gains where a reference of as many samples is given.

    Parameters
    ----------
    modulator, reference
        As in `lfcal.multiplex.snr_gain`.
    chi2
        The camera's.
    rcond
        Singular values up to this share of the largest count as zero.
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
