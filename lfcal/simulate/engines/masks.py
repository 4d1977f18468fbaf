"""Lenslet apertures with low-passed edges, so that sums over samples are exact for band-limited fields.

A hard mask on samples ``dx`` apart has an area error of 4e-4 at two samples per pixel. Here, the spectrum of an
indicator is exact up to W and falls to zero at 1/dx - W. The trapezoid rule is then exact for every field band-limited
to W. The removed part could only alias.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy.fft as sf
from numpy.typing import NDArray
from scipy.special import j0

from lfcal.base import InputError
from lfcal.simulate.engines._polygon import Points, disc_transform, spectrum
from lfcal.simulate.engines._quadrature import gauss_legendre

__all__ = [
    "FLAT",
    "RING",
    "Bend",
    "bent_fineness",
    "bent_polygon",
    "bent_polygon_table",
    "disc_table",
    "disc_values",
    "fineness",
    "polygon_mask",
    "polygon_table",
    "taper",
]

FLAT = 0.30
"""Exact part W of the band, in units of 1/dx."""
BENT_FLAT, BENT_FINE = 0.4, 6
"""Oversampling of apertures that are low-passed together with their phase, and the smallest oversampling for curved
masks if memory allows: their masks are exact up to 0.15 of the sampling rate."""
KNOWN, KNOT = 8, 4
"""Samples per table entry from which a low-passed disc is interpolated (error 4e-6); half the spline's order."""
RING = 3
"""Samples kept beyond the aperture's edge for the ripple of the low-passed edge."""
FINE, FINE_UP_TO = 16, 40
"""Fine samples for each sample of a polygon's table, and the aperture's reach (samples) up to which this applies."""
MAX_TABLE = 6000
"""Largest side of a polygon's table (samples): 0.6 GB while it is computed."""
MAX_CACHED = 2400
"""Largest side of a table that is kept for other scenes (samples): 46 MB."""


class Bend(NamedTuple):
    """Phase of a lenslet (rad) at the distance r (µm) from its centre: ``square * r^2 + quartic * r^4``."""

    square: float
    quartic: float = 0.0

    def turned(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.complex128]:
        """Return exp(i phase), ``(len(y), len(x))``, at ``y`` and ``x`` (µm) relative to the lenslet's centre."""
        # equal distances on either side of the centre are computed once
        (x2, column), (y2, row) = (np.unique(axis**2, return_inverse=True) for axis in (x, y))
        turn: NDArray[np.complex128] = np.exp(1j * self.square * y2)[:, None] * np.exp(1j * self.square * x2)
        if self.quartic:
            turn *= np.exp(1j * self.quartic * (y2[:, None] + x2) ** 2)
        return turn[np.ix_(row, column)]


def taper(f: NDArray[np.float64], flat: float, stop: float) -> NDArray[np.float64]:
    """Return 1 for ``|f|`` up to ``flat``, 0 from ``stop``, and a raised cosine in between."""
    t = np.clip((np.abs(f) - flat) / (stop - flat), 0.0, 1.0)
    value: NDArray[np.float64] = np.cos(np.pi / 2 * t) ** 2
    return value


def disc_values(radius: float, dx: float, r: NDArray[np.float64], flat: float = FLAT) -> NDArray[np.float64]:
    """Return the low-pass-filtered indicator function of a disc of ``radius`` at the distances ``r`` from its centre.

    It is a Hankel integral, computed by Gauss-Legendre quadrature. ``radius``, ``r`` and the sample spacing ``dx`` are
    in µm. The filter is 1 up to the frequency ``flat / dx``, and 0 from ``(1 - flat) / dx``.
    """
    top = (1 - flat) / dx
    phase = 2 * math.pi * top * (radius + float(r.max(initial=0.0)))
    f, w = gauss_legendre(int(phase / 2) + 60, 0.0, top)
    g = 2 * np.pi * f * w * disc_transform(radius, f) * taper(f, flat / dx, top)
    # in parts, because radii times frequencies would be a large matrix
    parts = np.array_split(r, 1 + r.size // 4096)
    return np.concatenate([np.einsum("rf,f->r", j0(2 * np.pi * np.outer(part, f)), g) for part in parts])


@lru_cache(maxsize=16)
def disc_table(
    radius: float, dx: float, reach: float, flat: float = FLAT, fine: int = 128
) -> tuple[NDArray[np.float64], float]:
    """Return a table of `disc_values` at equidistant values of r^2, and the step in r^2 (µm²).

    The table extends from 0 to beyond ``reach``^2. It has ``fine`` entries per sample near the edge of the disc; with
    128, the error of linear interpolation is within 2e-4. The other arguments are as in `disc_values`.
    """
    from scipy.interpolate import make_interp_spline  # slow to import

    step = 2 * radius * dx / fine
    r = np.sqrt(step * np.arange(math.ceil(reach**2 / step) + 2))
    # few values determine a band-limited function, which needs a tenth of the Bessel functions
    known = np.arange(-KNOT, math.ceil(KNOWN * float(r[-1]) / dx) + KNOT, dtype=np.float64) * (dx / KNOWN)
    half = disc_values(radius, dx, known[KNOT:], flat)
    values = make_interp_spline(known, np.concatenate([half[KNOT:0:-1], half]), k=2 * KNOT - 1)(r)
    # shared by lens types, and by scenes that differ in other properties
    values.setflags(write=False)
    return values, step


def polygon_mask(
    outline: Points, dx: float, centre: tuple[float, float], n: int, flat: float = FLAT, fine: int = 1
) -> NDArray[np.float64]:
    """Return the low-pass-filtered indicator of a polygon on ``n`` x ``n`` samples, spaced by ``dx / fine``.

    ``outline`` contains the corners (x, y), and ``centre`` is the position (x, y) of their origin relative to sample
    (n // 2, n // 2); lengths are in µm. ``flat`` is as in `disc_values`.
    """
    h = dx / max(2, fine)  # the spectrum extends to 1/dx - W, past the Nyquist frequency of dx
    skip = max(2, fine) // fine
    size = sf.next_fast_len(n * skip + math.ceil(4 * RING * dx / h))
    f = sf.fftfreq(size, h)
    # computed only where it is not zero, and for half the plane, because the mask is real
    rows = _below(f, (1 - flat) / dx)
    fx, fy = f[rows[f[rows] >= 0]], f[rows]
    x0, y0 = n // 2 * skip * h + centre[0], n // 2 * skip * h + centre[1]
    g = spectrum(outline, fx, fy)
    g *= taper(np.hypot(fx[None, :], fy[:, None]), flat / dx, (1 - flat) / dx)
    g *= np.exp(-2j * np.pi * fx * x0)[None, :] * np.exp(-2j * np.pi * fy * y0)[:, None]
    columns = np.zeros((size, fx.size), np.complex128)
    columns[rows] = g
    columns = sf.ifft(columns, axis=0, overwrite_x=True)[: n * skip : skip]
    mask: NDArray[np.float64] = np.ascontiguousarray(sf.irfft(columns, size, axis=1)[:, : n * skip : skip]) / (h * h)
    return mask


def _below(f: NDArray[np.float64], top: float) -> NDArray[np.intp]:
    """Return the indices of the frequencies with a magnitude below ``top``."""
    return np.flatnonzero(np.abs(f) < top)


def polygon_table(
    outline: Points, dx: float, reach: float, fine: int | None = None
) -> tuple[NDArray[np.float64], float]:
    """Return a fine table of the low-pass-filtered polygon from ``-reach`` to ``reach`` about its origin, and its step.

    The table is square. The sample spacing is ``dx`` divided by the oversampling ``fine``. None: that of `fineness`.
    The outline is as in `polygon_mask`.

    Raises
    ------
    InputError
        If the table would need more than `MAX_TABLE` samples per side.
    """
    chosen = fineness(reach / dx) if fine is None else fine
    n = _table_side(dx / chosen, reach)
    corners = tuple(map(tuple, outline.tolist()))
    make = _cached_table if n <= MAX_CACHED else _table
    return make(corners, dx, n, chosen), dx / chosen


def bent_polygon(
    outline: Points,
    dx: float,
    centre: tuple[float, float],
    n: int,
    bend: Bend,
    fine: int = BENT_FINE,
    *,
    every: int = 1,
) -> NDArray[np.complex128]:
    """Return the low-pass-filtered product of a polygon's indicator and exp(i phase), on ``n`` x ``n`` samples.

    The product is computed on samples spaced by ``dx / fine``, every ``every``-th of which is returned. ``bend`` is the
    phase; ``outline``, ``dx`` and ``centre`` are as in `polygon_mask`.

    If lenslets touch, the filtered products add up to the filtered array. Masks that are filtered before they are
    multiplied by the phase do not. Beyond its edge, each of these masks continues with its lenslet's phase, which makes
    focused light there up to 36 % too bright.
    """
    step = dx / fine
    size = int(sf.next_fast_len(n * every + math.ceil(4 * RING * fine)))
    away = [(n // 2 * every - size // 2) * step + c for c in centre]
    axis = (np.arange(size, dtype=np.float64) - n // 2 * every) * step
    piece = bend.turned(axis - centre[0], axis - centre[1])
    piece *= polygon_mask(outline, 2 * step, (away[0], away[1]), size, fine=2)
    f = sf.fftfreq(size, step)
    band = _below(f, (1 - BENT_FLAT) / dx)
    within = sf.fft(sf.fft(piece, axis=1, overwrite_x=True)[:, band], axis=0, overwrite_x=True)[band]
    within *= taper(np.hypot(f[band][None, :], f[band][:, None]), BENT_FLAT / dx, (1 - BENT_FLAT) / dx)
    # back along the rows' axis, and then along the columns' axis
    for _ in range(2):
        across = np.zeros((size, within.shape[1]), np.complex128)
        across[band] = within
        within = sf.ifft(across, axis=0, overwrite_x=True)[: n * every : every].T
    return np.ascontiguousarray(within)


def bent_polygon_table(
    outline: Points, dx: float, reach: float, bend: Bend
) -> tuple[tuple[NDArray[np.float64], NDArray[np.float64]], float]:
    """Return the real and imaginary parts of `bent_polygon` as tables like that of `polygon_table`, and their step.

    The arguments are as in `bent_polygon`; ``reach`` is as in `polygon_table`.
    """
    fine = bent_fineness(reach / dx)
    n = _table_side(dx / fine, reach)
    corners = tuple(map(tuple, outline.tolist()))
    make = _cached_bent_table if n <= MAX_CACHED else _bent_table
    return make(corners, dx, n, fine, bend), dx / fine


def bent_fineness(samples: float) -> int:
    """Return `fineness` for an aperture that is multiplied by its phase before it is low-pass-filtered.

    It is at least 6, or the largest number that `MAX_TABLE` allows.
    """
    return max(fineness(samples), min(BENT_FINE, int((MAX_TABLE - 4) / (2 * max(samples, 1.0)))))


def _bent_table(
    corners: tuple[tuple[float, ...], ...], dx: float, n: int, fine: int, bend: Bend
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    made = bent_polygon(np.array(corners), dx, (0.0, 0.0), n, bend, fine)
    parts = np.ascontiguousarray(made.real), np.ascontiguousarray(made.imag)
    for part in parts:
        part.setflags(write=False)
    return parts


_cached_bent_table = lru_cache(maxsize=2)(_bent_table)
"""Cached tables, shared by planes; see `_cached_table`."""


def _table_side(step: float, reach: float) -> int:
    """Return the number of samples along a side of a table; raise `InputError` if it is too large.

    ``step`` is the sample spacing, and ``reach`` the half side of the table.
    """
    n = 2 * math.ceil(reach / step) + 3
    if n > MAX_TABLE:
        raise InputError.expected(
            "sampled transmission of a lenslet",
            f"at most {MAX_TABLE} samples on each side",
            n,
            "use fewer samples or nodes per pixel, or the level geometric",
        )
    return n


def _table(corners: tuple[tuple[float, ...], ...], dx: float, n: int, fine: int) -> NDArray[np.float64]:
    return polygon_mask(np.array(corners), dx, (0.0, 0.0), n, fine=fine)


@lru_cache(maxsize=2)
def _cached_table(corners: tuple[tuple[float, ...], ...], dx: float, n: int, fine: int) -> NDArray[np.float64]:
    """Return a table from the cache.

    Planes and scenes with the same aperture share it. Otherwise, it would take two thirds of the time of a fit of a
    microscope.
    """
    values = _table(corners, dx, n, fine)
    values.setflags(write=False)
    return values


def fineness(samples: float) -> int:
    """Return the number of fine samples for each sample on the array, 2 to 16.

    The aperture extends ``samples`` samples from its centre. A table is interpolated between fine samples. Only the
    edge has an error, which is proportional to the square of their spacing. The larger the aperture, the less its edge
    contributes.
    """
    return max(2, min(FINE, math.ceil(FINE * math.sqrt(FINE_UP_TO / max(samples, 1.0)))))
