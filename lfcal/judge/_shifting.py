"""Shift patterns by fractions of a pixel with their Fourier series."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import fft

__all__ = ["best_shift", "shifted"]

F8 = NDArray[np.float64]

TURNS = 12
"""Largest number of steps of Newton's method."""

FARTHEST = 0.25
"""Fraction of the cutout up to which a shift is searched for."""


def _frequencies(shape: tuple[int, int]) -> tuple[F8, F8]:
    """Return cycles per pixel along rows ``(nt, 1)`` and columns ``(1, ns // 2 + 1)``."""
    return fft.fftfreq(shape[0])[:, None], fft.rfftfreq(shape[1])[None, :]


def shifted(patterns: F8, shift: F8) -> tuple[F8, F8, F8]:
    """Return patterns ``(n, nt, ns)`` shifted by (row, column) pixels, and their derivatives by row and by column.

    Cutouts have an odd number of rows and of columns, so that their Fourier series contain no Nyquist frequency.
    """
    shape = (patterns.shape[1], patterns.shape[2])
    v, u = _frequencies(shape)
    turned = fft.rfft2(patterns) * np.exp(-2j * np.pi * (v * shift[0] + u * shift[1]))
    down, along = (fft.irfft2(turned * (2j * np.pi * f), shape) for f in (v, u))
    moved: F8 = fft.irfft2(turned, shape)
    return moved, down, along


def best_shift(a: F8, b: F8) -> F8:
    """Return the shift (row, column) at which patterns ``b`` ``(n, nt, ns)`` correlate best with ``a``.

    The highest whole pixel of the correlation is refined by Newton's method on its Fourier series.
    """
    shape = (a.shape[1], a.shape[2])
    cross = (fft.rfft2(a) * np.conj(fft.rfft2(b))).sum(0)
    v, u = _frequencies(shape)
    surface = fft.irfft2(cross, shape)
    reach = [max(1, int(FARTHEST * n)) for n in shape]
    near = [np.r_[0 : r + 1, n - r : n] for r, n in zip(reach, shape, strict=True)]
    inner = surface[np.ix_(*near)]
    peak = np.unravel_index(int(inner.argmax()), inner.shape)
    at = np.array([float(rows[k]) for rows, k in zip(near, peak, strict=True)])
    at = np.where(at > np.array(shape) / 2, at - shape, at)
    whole = at.copy()
    # the omitted half of the spectrum belongs to the columns other than the first
    weight = np.where(u == 0, 1.0, 2.0)
    w = 2 * np.pi * np.stack(np.broadcast_arrays(v, u))
    for _ in range(TURNS):
        turned = weight * cross * np.exp(1j * (w[0] * at[0] + w[1] * at[1]))
        slope = np.array([-(w[i] * turned.imag).sum() for i in range(2)])
        bend = np.array([[-(w[i] * w[j] * turned.real).sum() for j in range(2)] for i in range(2)])
        if not np.linalg.eigvalsh(bend)[-1] < 0:
            break  # there is no maximum nearby: keep the whole pixel
        step = np.clip(-np.linalg.solve(bend, slope), -0.5, 0.5)
        at = at + step
        if np.abs(step).max() < 1e-10:
            break
    found: F8 = at if np.abs(at - whole).max() <= 1.0 else whole
    return found
