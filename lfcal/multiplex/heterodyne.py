"""Both routes for a real lattice: super-pixels of any pitch, rotated and sheared, without resampling the frame.

With reciprocal vectors g of the lattice (cycles per pixel) a frame behind a periodic modulator is ``i(x) = sum_k exp(2
pi i g_k x) c_k(x)`` (equations 5 to 7). Theorem 2 crops each ``c_k`` from the spectrum about ``g_k`` and brings it to
zero frequency. Theorem 1 samples the frame at each pixel of the super-pixels, also between the pixels of the sensor,
and interpolates. With a sinc filter, both are equal if the frame has no content between the tiles.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, check_choice, check_tuple
from lfcal.lattice import MicroImageLattice, ViewGrid
from lfcal.multiplex.modulator import MAX_SAMPLES, Modulator

__all__ = [
    "PROFILES",
    "is_straight",
    "lattice_by_sinc",
    "lattice_by_spectrum",
    "lattice_transmissions",
    "sample_places",
]

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

PROFILES = ("cells", "sinusoids")
"""Profile between a modulator's values: uniform cells with sharp borders, or the smoothest curve through them."""

TAPS = 24
SHAPE = 27.7
"""Taps and shape of the Kaiser window: 260 dB for tiles that cover at most a third of the sensor's band."""

SUB = 8
"""Number of points along a pixel for the mean of a mask's cells."""

MOST_CELLS = 4096
MOST_BENT_PX = 0.05
"""Largest deviation of a centre twenty rows and columns away from a straight lattice (pixels)."""

VALUES_AT_ONCE = 2_000_000


def lattice_transmissions(
    shape: tuple[int, int], lattice: MicroImageLattice, modulator: Modulator, *, profile: str = "cells"
) -> Array:
    """Return the transmission of each of N samples at each pixel of a frame, ``(N, rows, columns)``.

    Parameters
    ----------
    shape
        Number of rows and columns of the frame.
    lattice
        Lattice of the super-pixels, whose points are their centres.
    modulator
        Modulator of one super-pixel; its pixels are at equal steps along the vectors of the lattice.
    profile
        ``"cells"``: a mask of uniform cells, averaged over the area of each pixel (sampled at 64 points).
        ``"sinusoids"``: the trigonometric polynomial through the modulator's values, as in optical heterodyning; it may
        exceed their range.

    Raises
    ------
    InputError
        If ``profile`` is unknown or ``shape`` is invalid.

    Examples
    --------
    >>> from lfcal.multiplex import SuperPixelLattice, lattice_transmissions, mask
    >>> lattice = SuperPixelLattice("square", (1.0, 1.0), (3.0, 0.0), (0.0, 3.5))  # rows are 3.5 pixels apart
    >>> seen = lattice_transmissions((7, 6), lattice, mask("pinhole", 3))
    >>> print(seen.shape, seen[4, :, 1].round(3))  # the middle view, down the first column of pinholes
    (9, 7, 6) [0.125 1.    0.125 0.    0.625 0.625 0.   ]
    """
    check_choice("profile", profile, PROFILES)
    rows, columns = check_tuple("frame (rows, columns)", shape, 2, at_least=1, at_most=20_000, integer=True)
    # rounding errors of bases, such as Fourier ones, are not light
    table = np.round(modulator.matrix, 12).reshape(*modulator.side, -1)
    out = np.empty((modulator.count, rows, columns))
    for top in range(0, rows, max(1, VALUES_AT_ONCE // (columns * modulator.pixels))):
        y = np.arange(top, min(rows, top + max(1, VALUES_AT_ONCE // (columns * modulator.pixels))))
        take = _by_cells if profile == "cells" else _by_sinusoids
        out[:, y] = np.moveaxis(take(lattice, table, y.astype(float), np.arange(columns, dtype=float)), -1, 0)
    return out


def _by_cells(lattice: MicroImageLattice, table: Array, y: Array, x: Array) -> Array:
    found = np.zeros((len(y), len(x), table.shape[2]))
    sub = (np.arange(SUB) + 0.5) / SUB - 0.5
    for dy in sub:
        for dx in sub:
            q, r = np.moveaxis(lattice.lenslet_at((y + dy)[:, None], (x + dx)[None, :]), -1, 0)
            a = np.floor((r - np.floor(r + 0.5) + 0.5) * table.shape[0]).astype(int) % table.shape[0]
            b = np.floor((q - np.floor(q + 0.5) + 0.5) * table.shape[1]).astype(int) % table.shape[1]
            found += table[a, b]
    return np.asarray(found / SUB**2)


def _by_sinusoids(lattice: MicroImageLattice, table: Array, y: Array, x: Array) -> Array:
    q, r = np.moveaxis(lattice.lenslet_at(y[:, None], x[None, :]), -1, 0)
    spectrum = np.fft.fft2(table, axes=(0, 1)) / (table.shape[0] * table.shape[1])
    waves = [_waves(r, table.shape[0]), _waves(q, table.shape[1])]
    (ky, kx) = (_harmonics(n)[0] for n in table.shape[:2])
    weights = spectrum[ky % table.shape[0]][:, kx % table.shape[1]]
    return np.asarray(np.einsum("yxk,klc,yxl->yxc", waves[0], weights, waves[1], optimize=True).real)


def _harmonics(n: int) -> tuple[NDArray[np.intp], Array]:
    """Return the harmonics of a period of n values and their weights (1/2 at both ends if n is even)."""
    k = np.arange(-(n // 2), n // 2 + 1)
    weight = np.ones(len(k))
    if n % 2 == 0:
        weight[[0, -1]] = 0.5
    return k, weight


def _waves(place: Array, n: int) -> Complex:
    """Return the harmonics ``(..., harmonics)`` at positions in periods, relative to the middle of a period."""
    k, weight = _harmonics(n)
    return np.asarray(weight * np.exp(2j * np.pi * k * (place[..., None] + (n - 1) / (2 * n))))


def sample_places(grid: ViewGrid) -> Array:
    """Return the position (row, column) in the frame (px) of each sample of a view, ``(rows * columns, 2)``.

    The samples of ``grid`` are in row-major order.
    """
    down = np.array([math.cos(grid.rotation_rad), -math.sin(grid.rotation_rad)])
    along = np.array([math.sin(grid.rotation_rad), math.cos(grid.rotation_rad)])
    i, j = np.indices(grid.shape)
    steps = i[..., None] * grid.step_px[0] * down + j[..., None] * grid.step_px[1] * along
    return np.asarray(grid.corner_px + steps).reshape(-1, 2)


def is_straight(lattice: MicroImageLattice) -> bool:
    """Return whether the rows of a lattice are straight, as both Fourier-based routes assume.

    The centre with the indices (20, 20) must be within `MOST_BENT_PX` of its extrapolation from the first centres.
    """
    origin, along, across = _steps(lattice)
    far = lattice.centres_px(20, 20)
    return bool(np.abs(origin + 20 * (along + across) - far).max() <= MOST_BENT_PX)


def _steps(lattice: MicroImageLattice) -> tuple[Array, Array, Array]:
    origin, along, across = (lattice.centres_px(*index) for index in ((0, 0), (1, 0), (0, 1)))
    return origin, along - origin, across - origin


def _vectors(lattice: MicroImageLattice) -> tuple[Array, Array, Array]:
    """Return origin and vectors of a lattice as (row, column); raise `InputError` if its rows are not straight."""
    if not is_straight(lattice):
        raise InputError.expected(
            "lattice for the route fourier",
            "a lattice without distortion",
            "a distorted lattice",
            "choose the route spatial with the filter cubic",
        )
    return _steps(lattice)


def lattice_by_spectrum(
    frame: NDArray[Any], lattice: MicroImageLattice, modulator: Modulator, places: Array, rcond: float | None = None
) -> Array:
    """Return the samples ``(N, n)`` at ``places`` by theorem 2, which decorrelates tiles of the spectrum.

    Each tile surrounds one harmonic of the lattice. ``places`` ``(n, 2)`` are positions (row, column) on the frame;
    ``rcond`` is as in `demultiplex_lattice`. The method requires one Fourier transform of the frame and one for each
    pixel of the super-pixel. It assumes that the frame is periodic, so samples within two super-pixels of a border
    depend on the opposite border.

    Raises
    ------
    InputError
        If the lattice is distorted (`is_straight`).
    """
    from scipy import fft

    image = np.asarray(frame, float)
    origin, along, across = _vectors(lattice)
    (py, px), spectrum = modulator.side, fft.fft2(image)
    tiles = np.zeros((py * px, len(places)), complex)
    g = np.linalg.inv(np.stack([across, along]))  # columns: reciprocal vectors (cycles per pixel)
    for k1, w1 in zip(*_harmonics(py), strict=True):
        for k2, w2 in zip(*_harmonics(px), strict=True):
            inside = _tile(image.shape, along, across, int(k1), int(k2))
            tile = _demodulated(fft.ifft2(spectrum * inside), g @ np.array([k1, k2], float), origin)
            # the super-pixel's first pixel is (n - 1)/2n of a period before its middle
            phase = np.exp(-2j * np.pi * (k1 * (py - 1) / (2 * py) + k2 * (px - 1) / (2 * px)))
            tiles[(k1 % py) * px + k2 % px] += w1 * w2 * phase * _interpolated(tile, places)
    return np.asarray((_decorrelation(modulator, rcond) @ tiles).real)


def _tile(shape: tuple[int, ...], along: Array, across: Array, k1: int, k2: int) -> Array:
    """Return the fraction of each frequency of a frame (in transform order) that is in the tile about g_k."""
    inside = np.zeros(shape)
    for turn_y in (-1, 0, 1):  # a tile at the end of the band wraps around
        for turn_x in (-1, 0, 1):
            fy, fx = (np.fft.fftfreq(n) + t for n, t in zip(shape, (turn_y, turn_x), strict=True))
            down = _share(fy[:, None] * across[0] + fx * across[1] - k1)  # in cycles per step of the lattice
            inside += down * _share(fy[:, None] * along[0] + fx * along[1] - k2)
    return inside


def _share(away: Array) -> Array:
    """Return the fraction of a frequency that belongs to a tile, ``away`` cycles per super-pixel from its middle."""
    size = np.abs(away)
    return np.where(size < 0.5 - 1e-9, 1.0, np.where(size <= 0.5 + 1e-9, 0.5, 0.0))


def _demodulated(tile: Complex, wave: Array, origin: Array) -> Complex:
    y, x = (np.arange(n) - o for n, o in zip(tile.shape, origin, strict=True))
    return np.asarray(tile * np.exp(-2j * np.pi * wave[0] * y)[:, None] * np.exp(-2j * np.pi * wave[1] * x))


def _decorrelation(modulator: Modulator, rcond: float | None) -> Complex:
    """Return (F Sigma Pi^T)^+ for tiles c_k = F c / K, ``(N, K)``."""
    inverse = modulator.inverse(rcond).reshape(-1, *modulator.side)
    return np.asarray(np.fft.ifft2(inverse, axes=(1, 2)).reshape(len(inverse), -1) * modulator.pixels)


def _interpolated(image: Complex, places: Array) -> Complex:
    """Return a smooth, periodic image between its pixels, interpolated with a Kaiser-windowed sinc."""
    first = np.floor(places).astype(np.intp) - TAPS // 2 + 1
    away = places[:, :, None] - first[:, :, None] - np.arange(TAPS)
    window = np.i0(SHAPE * np.sqrt(np.maximum(0, 1 - (2 * away / TAPS) ** 2))) / np.i0(SHAPE)
    weights = np.sinc(away) * window
    found = np.empty(len(places), complex)
    for start in range(0, len(places), VALUES_AT_ONCE // TAPS**2):
        part = slice(start, start + VALUES_AT_ONCE // TAPS**2)
        rows, columns = ((first[part, k, None] + np.arange(TAPS)) % image.shape[k] for k in range(2))
        block = image[rows[:, :, None], columns[:, None, :]]
        found[part] = np.einsum("na,nab,nb->n", weights[part, 0], block, weights[part, 1], optimize=True)
    return found


def lattice_by_sinc(
    frame: NDArray[Any], lattice: MicroImageLattice, modulator: Modulator, places: Array, rcond: float | None = None
) -> Array:
    """Return the samples ``(N, n)`` at positions ``places`` ``(n, 2)`` (row, column) by theorem 1 with a sinc filter.

    The trigonometric polynomial through the frame is evaluated at each pixel of the super-pixels, also between the
    sensor pixels. Each channel is interpolated to ``places`` with those frequencies of the frame that are in one cell
    of the reciprocal lattice. The channels are decorrelated there. The number of operations for each channel is about
    the number of pixels of the frame times the number of super-pixels. ``rcond`` is as in `demultiplex_lattice`.

    Raises
    ------
    InputError
        If the frame has more than 4096 super-pixels, or the lattice is distorted (`is_straight`).
    """
    image = np.asarray(frame, float)
    origin, along, across = _vectors(lattice)
    cells = _cells(image.shape, origin, along, across)
    if len(cells) > MOST_CELLS:
        remedy = "use the route fourier, which gives the same result, or the filter cubic"
        raise InputError.expected(
            "number of super-pixels for the filter sinc", f"at most {MOST_CELLS}", len(cells), remedy
        )
    frequency, weight = _cell_waves(image.shape, along, across)
    leave = np.exp(2j * np.pi * (places @ frequency.T)) * weight
    steps = [(np.arange(n) - (n - 1) / 2) / n for n in modulator.side]
    inverse, found = modulator.inverse(rcond), np.zeros((modulator.count, len(places)))
    for k in range(modulator.pixels):
        a, b = divmod(k, modulator.side[1])
        at = cells + steps[0][a] * across + steps[1][b] * along
        channel = _off_grid(image, at)
        waves = (np.exp(-2j * np.pi * (frequency @ at.T)) @ channel) / len(cells)
        found += inverse[:, k : k + 1] * (leave @ waves).real
    return found


def _cells(shape: tuple[int, ...], origin: Array, along: Array, across: Array) -> Array:
    """Return the centres (row, column) of the super-pixels within the frame, without its lower and right borders."""
    reach = math.ceil(2 * math.hypot(*shape) / min(math.hypot(*along), math.hypot(*across))) + 1
    if reach * reach > 64 * MAX_SAMPLES:
        raise InputError.expected(
            "number of super-pixels for the filter sinc",
            f"at most {MOST_CELLS}",
            "a larger number",
            "use the filter cubic",
        )
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)))
    centres = origin + q[:, None] * along + r[:, None] * across
    slack = 1e-6  # on a lattice that is periodic over the frame, the first cell also appears at the end
    inside = ((centres > -0.5 - slack) & (centres < np.array(shape) - 0.5 - slack)).all(1)
    return np.asarray(centres[inside])


def _cell_waves(shape: tuple[int, ...], along: Array, across: Array) -> tuple[Array, Array]:
    """Return the frame's frequencies (cycles per pixel) within the lattice's cell, ``(n, 2)``, and their weights."""
    fy, fx = (np.fft.fftfreq(n) for n in shape)
    weight = _share(fy[:, None] * across[0] + fx * across[1]) * _share(fy[:, None] * along[0] + fx * along[1])
    rows, columns = np.nonzero(weight)
    return np.stack([fy[rows], fx[columns]], 1), weight[rows, columns]


def _off_grid(image: Array, places: Array) -> Array:
    """Return the trigonometric polynomial through a frame's pixels at positions (row, column)."""
    down, across = (_dirichlet(places[:, k, None] - np.arange(n), n) for k, n in enumerate(image.shape))
    return np.asarray(((down @ image) * across).sum(1))


def _dirichlet(t: Array, count: int) -> Array:
    """Return the periodic sinc of ``count`` samples at distances t."""
    away = t - count * np.rint(t / count)  # within half a period, where zero is the only pole
    on = np.abs(away) < 1e-12
    angle = np.pi * np.where(on, 0.5, away) / count
    bottom = np.sin(angle) if count % 2 else np.tan(angle)
    return np.asarray(np.where(on, 1.0, np.sin(np.pi * away) / (count * bottom)))
