"""A quantity over the positions of a cell, split into what the lattice may do to it and what it may not."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Parts", "split"]

SHARE = 0.12
"""Harmonics of the cell that count as the lattice's own ripple, as a share of the positions."""

MOST_TERMS = 90
ROUNDS = 4
HUBER = 2.5


@dataclass(frozen=True, slots=True)
class Parts:
    """A field ``(ny, nx)`` as mean + ramp + ripple + residual.

    Attributes
    ----------
    mean
        Robust mean.
    ramp
        Change over the whole cell along (y, x): what cannot repeat from cell to cell.
    ripple
        The smooth part that repeats, ``(ny, nx)``: a lattice makes one.
    residual
        What changes from position to position, ``(ny, nx)``; NaN where the field was not used.
    """

    mean: float
    ramp: tuple[float, float]
    ripple: NDArray[np.float64]
    residual: NDArray[np.float64]

    @property
    def rms(self) -> float:
        """Root mean square of the residual."""
        return float(np.sqrt(np.nanmean(self.residual**2)))

    @property
    def spread(self) -> float:
        """Standard deviation of the residual by its median deviation: blind to outliers."""
        return 1.4826 * float(np.nanmedian(np.abs(self.residual)))

    @property
    def alternation(self) -> float:
        """Half the difference of even and odd rows: what a stage with play does on the way back."""
        rows = np.nanmean(self.residual, axis=1)
        sign = np.where(np.arange(rows.size) % 2, -1.0, 1.0)
        return abs(float(np.nanmean(rows * sign)))


@functools.lru_cache(maxsize=8)
def _terms(ny: int, nx: int) -> NDArray[np.float64]:
    """Return the basis ``(ny * nx, terms)``: one, two ramps, low harmonics of the cell."""
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    terms = [np.ones(ny * nx)]
    for index, n in ((y, ny), (x, nx)):
        if n > 1:
            terms.append(((index + 0.5) / n - 0.5).ravel())
    waves = [(my, mx) for my in range(-(ny // 3), ny // 3 + 1) for mx in range(nx // 3 + 1) if (mx, my) > (0, 0)]
    waves.sort(key=lambda m: ((m[0] / ny) ** 2 + (m[1] / nx) ** 2, m))
    for my, mx in waves[: max(0, int(min(SHARE * ny * nx, MOST_TERMS)) // 2)]:
        phase = (2 * np.pi * (my * y / ny + mx * x / nx)).ravel()
        terms += [np.cos(phase), np.sin(phase)]
    basis = np.stack(terms, 1)
    basis.setflags(write=False)
    return basis


def split(field: NDArray[np.float64], use: NDArray[np.bool_] | None = None) -> Parts:
    """Split a field over the cell into mean, ramp, ripple and residual, by robust least squares.

    The patterns of a perfect scan repeat with the cell, so any quantity of theirs is a periodic function of
    the position, and, lenslets being many pixels wide, a smooth one: low harmonics. A ramp does not repeat,
    and what changes from one position to the next is no lattice's doing.

    Parameters
    ----------
    field
        Values ``(ny, nx)``.
    use
        Positions to use; the others do not enter and have a residual of NaN.
    """
    ny, nx = field.shape
    basis = _terms(ny, nx)
    good = np.isfinite(field) if use is None else use & np.isfinite(field)
    keep = good.ravel()
    ramps = [k for k, n in ((0, ny), (1, nx)) if n > 1]
    if keep.sum() < max(4, basis.shape[1]):  # too few positions to know a ripple
        basis = basis[:, : 1 + len(ramps)] if keep.sum() > 8 else basis[:, :1]
        ramps = ramps if basis.shape[1] > 1 else []
    values = np.where(good, field, 0.0).ravel()
    weight = keep.astype(float)
    p = np.zeros(basis.shape[1])
    for _ in range(ROUNDS):
        weighted = basis * weight[:, None]
        normal = basis.T @ weighted
        normal[np.diag_indices_from(normal)] += 1e-9 * max(1.0, float(weight.sum()))
        p = np.linalg.solve(normal, weighted.T @ values)
        residual = values - basis @ p
        scale = 1.4826 * float(np.median(np.abs(residual[keep]))) if keep.any() else 0.0
        if scale <= 1e-12 * max(1e-300, float(np.abs(values).max())):
            break
        weight = keep / np.maximum(1.0, np.abs(residual) / (HUBER * scale)) ** 2
    first = 1 + len(ramps)
    ramp = [0.0, 0.0]
    for k, axis in enumerate(ramps):
        ramp[axis] = float(p[1 + k])
    ripple = (basis[:, first:] @ p[first:]).reshape(ny, nx)
    left = np.where(keep, values - basis @ p, np.nan).reshape(ny, nx)
    return Parts(float(p[0]), (ramp[0], ramp[1]), ripple, left)
