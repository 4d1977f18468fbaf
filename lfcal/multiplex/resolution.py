"""What a modulator and its reconstruction leave of fine detail: the modulation transfer beside the noise."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_choice
from lfcal.multiplex.demultiplexing import demultiplex, multiplex
from lfcal.multiplex.modulator import Modulator

__all__ = ["Transfer", "modulation_transfer"]

Array = NDArray[np.float64]

CELLS = 24
"""Super-pixels along the wave; a frequency is rounded to whole waves over these."""


@dataclass(frozen=True, eq=False)
class Transfer:
    """Modulation transfer of one modulator.

    Attributes
    ----------
    frequencies
        Cycles per pixel, as measured ``(n,)``.
    transfer
        Amplitude got back over that shown, of each sample ``(N, n)``.
    aliased
        Rms of all else that the wave makes (other frequencies, other samples), over the wave's rms ``(N, n)``.

    Examples
    --------
    >>> from lfcal.multiplex import Transfer, cfa, modulation_transfer
    >>> found: Transfer = modulation_transfer(cfa("Bayer"), [0.2], filter="linear")
    >>> print(found.frequencies.round(3))  # 10 waves over 48 pixels
    [0.208]
    >>> print(found.transfer[:, 0].round(2), "aliased", found.aliased[:, 0].round(2))  # red, green, blue
    [0.63 0.63 0.63] aliased [0.37 0.   0.37]
    """

    frequencies: Array = field(repr=False)
    transfer: Array = field(repr=False)
    aliased: Array = field(repr=False)


def modulation_transfer(
    modulator: Modulator,
    frequencies: ArrayLike,
    *,
    route: str = "spatial",
    filter: str | None = None,
    axis: str = "x",
) -> Transfer:
    """Return how much of sine waves the reconstruction gives back, shown equally to all samples in unmodulated light.

    Parameters
    ----------
    modulator
        With which the waves are recorded, without noise.
    frequencies
        Cycles per pixel, 0 … 1/2; taken to the nearest whole number of waves over 24 super-pixels.
    route, filter
        As in `lfcal.multiplex.demultiplex`.
    axis
        ``"x"``: waves along the rows, ``"y"``: along the columns.

    Examples
    --------
    >>> from lfcal.multiplex import cfa, modulation_transfer
    >>> found = modulation_transfer(cfa("Bayer"), [0, 0.125, 0.25], filter="linear")
    >>> print(found.transfer[0].round(3))  # red pixels, two apart: cos^2(pi f)
    [1.    0.854 0.5  ]
    """
    check_choice("axis", axis, ("x", "y"))
    wanted = np.atleast_1d(np.asarray(frequencies, float))
    if wanted.ndim != 1 or not wanted.size or not (wanted.min() >= 0 and wanted.max() <= 0.5):
        raise InputError.expected("frequencies", "0 … 0.5 cycles per pixel", wanted, "correct them")
    shape = tuple(s * (CELLS if (k == 0) == (axis == "y") else 8) for k, s in enumerate(modulator.side))
    length = shape[0 if axis == "y" else 1]
    waves = np.rint(wanted * length)
    light = np.abs(modulator.light)
    found = [_answer(modulator, shape, float(k), axis, light, route=route, filter=filter) for k in waves]
    transfer, aliased = (np.array(part).T for part in zip(*found, strict=True))
    return Transfer(waves / length, transfer, aliased)


def _answer(
    modulator: Modulator,
    shape: tuple[int, ...],
    waves: float,
    axis: str,
    light: Array,
    *,
    route: str,
    filter: str | None,
) -> tuple[Array, Array]:
    length = shape[0 if axis == "y" else 1]
    place = np.arange(length)
    results = []
    # a cosine and a sine: their mean transfer does not hang on where the pattern begins
    for shift in (0.0, 0.25) if 0 < waves < length / 2 else (0.0,):
        wave = np.cos(2 * np.pi * (waves * place / length + shift))
        field_ = np.broadcast_to(wave[:, None] if axis == "y" else wave, shape)
        frame = multiplex(light[:, None, None] * (1 + 0.5 * field_), modulator)
        samples = demultiplex(frame, modulator, route=route, filter=filter, samples=modulator.side)
        inner = tuple(slice(2 * s, n - 2 * s) for n, s in zip(shape, modulator.side, strict=True))
        seen = (samples / np.where(light > 0, light, 1.0)[:, None, None] - (light > 0)[:, None, None])[:, *inner] / 0.5
        results.append((_projected(seen, field_[inner]), seen, field_[inner]))
    transfer = np.mean([t for t, _, _ in results], axis=0)
    rest = [((s - t[:, None, None] * f) ** 2).mean((1, 2)) / float((f**2).mean()) for t, s, f in results]
    return transfer, np.sqrt(np.mean(rest, axis=0))


def _projected(seen: Array, wave: Array) -> Array:
    return np.asarray((seen * wave).sum((1, 2)) / float((wave**2).sum()))
