"""Fourier reconstruction (theorem 2): tiles of the spectrum cropped, re-weighted and inverse transformed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.multiplex.modulator import Modulator

__all__ = ["fourier_tiles", "reconstruct_fourier"]

Image = NDArray[Any]
Spectrum = NDArray[Any]


def _signed(count: int) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the frequencies of a tile of ``count`` super-pixels, and their weights (1/2 at the ends of even tiles)."""
    k = np.arange(-(count // 2), count // 2 + 1)
    weight = np.ones(len(k))
    if count % 2 == 0:
        weight[[0, -1]] = 0.5
    return k, weight


def fourier_tiles(frame: Image, side: tuple[int, int]) -> Spectrum:
    """Return the Fourier channels c_k(w') ``(K, rows, columns)`` cropped from the frame's spectrum (equation 7).

    Tile k is centred on the k-th multiple of the super-pixel's frequency; w' covers one tile including both ends.
    """
    from scipy import fft

    exact: Any = np.asarray(frame, np.float64 if frame.dtype == np.float64 else np.float32)
    spectrum: Spectrum = fft.fft2(exact)
    (py, px), (rows, columns) = side, frame.shape
    ky, kx = _signed(rows // py)[0], _signed(columns // px)[0]
    y = (np.arange(py)[:, None] * (rows // py) + ky) % rows
    x = (np.arange(px)[:, None] * (columns // px) + kx) % columns
    tiles: Spectrum = spectrum[y[:, None, :, None], x[None, :, None, :]].reshape(py * px, len(ky), len(kx))
    return tiles


def reconstruct_fourier(
    frame: Image,
    modulator: Modulator,
    samples: tuple[int, int],
    out: Image,
    rcond: float | None = None,
) -> Image:
    """Write the plenoptic samples of a frame to ``out`` ``(N, rows, columns)`` and return it.

    The spectrum of the samples is l-hat(w') = (Sigma-hat Pi^T)^+ c-hat(w') with Sigma-hat = F Sigma (equation 8). It is
    zero-padded to the size of the output and inverse transformed; this corresponds to a sinc filter for every
    modulator (section 3.2). The frame must consist of complete super-pixels and is assumed to be periodic.
    """
    from scipy import fft

    tiles = fourier_tiles(frame, modulator.side)
    cells = (frame.shape[0] // modulator.side[0], frame.shape[1] // modulator.side[1])
    (ky, weight_y), (kx, weight_x) = _signed(cells[0]), _signed(cells[1])
    tiles *= (weight_y[:, None] * weight_x).astype(tiles.real.dtype)
    if modulator.lenslets:
        _move_to_lenslets(tiles, modulator, ky / cells[0], kx / cells[1])
    demix = _decorrelation(modulator, rcond).astype(tiles.dtype)
    size = (cells[0] * samples[0], cells[1] * samples[1])
    scale = samples[0] * samples[1] / modulator.pixels
    # output sample 0 lies (side/samples - 1)/2 pixels into the first super-pixel
    start = [(side / m - 1) / 2 / side for side, m in zip(modulator.side, samples, strict=True)]
    ramp_y, ramp_x = (np.exp(2j * np.pi * k * s / n) for k, s, n in zip((ky, kx), start, cells, strict=True))
    ramp = (scale * ramp_y[:, None] * ramp_x).astype(tiles.dtype)
    flat = tiles.reshape(len(tiles), -1)
    for j in range(modulator.count):
        padded = np.zeros(size, tiles.dtype)
        # the two ends of a tile may coincide at one frequency of the output
        np.add.at(padded, (ky[:, None] % size[0], kx[None, :] % size[1]), (demix[j] @ flat).reshape(ramp.shape) * ramp)
        out[j] = fft.ifft2(padded, overwrite_x=True).real
    return out


def _decorrelation(modulator: Modulator, rcond: float | None) -> NDArray[np.complex128]:
    """Return (F Sigma Pi^T)^+ = A^+ F^-1 ``(N, K)``, tiles counted by rows."""
    inverse = modulator.inverse(rcond).reshape(-1, *modulator.side)
    result: NDArray[np.complex128] = np.fft.ifft2(inverse, axes=(1, 2)).reshape(len(inverse), -1) * modulator.pixels
    return result


def _move_to_lenslets(tiles: Spectrum, modulator: Modulator, wy: NDArray[np.float64], wx: NDArray[np.float64]) -> None:
    """Move every measurement channel from its pixel to the position of its lenslet by a phase ramp, in place."""
    py, px = modulator.side
    channels = np.fft.ifft2(tiles.reshape(py, px, len(wy), len(wx)), axes=(0, 1))
    for axis, (w, positions) in enumerate(zip((wy, wx), modulator.positions, strict=True)):
        move = (np.arange(len(positions)) - positions) / len(positions)
        ramp = np.exp(2j * np.pi * move[:, None] * w)
        channels *= ramp[:, None, :, None] if axis == 0 else ramp[None, :, None, :]
    tiles[:] = np.fft.fft2(channels, axes=(0, 1)).reshape(tiles.shape)
