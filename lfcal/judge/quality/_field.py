"""Split a quantity over the positions of a cell into the part that the lattice may cause and the remainder."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Parts", "split"]

SHARE = 0.12
"""Number of harmonics of the cell that count as ripple of the lattice, as a fraction of the positions."""

MOST_TERMS = 90
ROUNDS = 10
HUBER = 2.5


@dataclass(frozen=True, slots=True)
class Parts:
    """A field ``(ny, nx)`` as mean + ramp + ripple + residual.

    Attributes
    ----------
    mean
        Robust mean.
    ramp
        Change over the cell along (y, x), which cannot repeat from cell to cell; NaN with too few positions.
    ramp_error
        Standard errors of the ramps.
    ripple
        The smooth part that repeats, ``(ny, nx)``, as caused by a lattice.
    residual
        Residual from position to position, ``(ny, nx)``; NaN where the field was not used.
    """

    mean: float
    ramp: tuple[float, float]
    ramp_error: tuple[float, float]
    ripple: NDArray[np.float64]
    residual: NDArray[np.float64]

    def sure_ramp(self, axis: int) -> float:
        """Return the size of a ramp minus the contribution of chance: two standard errors, in quadrature.

        NaN with too few positions.
        """
        left = self.ramp[axis] ** 2 - (2 * self.ramp_error[axis]) ** 2
        return left if math.isnan(left) else math.sqrt(max(0.0, left))

    @property
    def rms(self) -> float:
        """Root mean square of the residual; NaN for fewer than two positions."""
        used = self._used
        return float(np.sqrt(np.mean(used**2))) if used.size > 1 else math.nan

    @property
    def spread(self) -> float:
        """Standard deviation of the residual from its median deviation, robust to outliers; NaN if empty."""
        used = self._used
        return 1.4826 * float(np.median(np.abs(used))) if used.size else math.nan

    @property
    def alternation(self) -> float:
        """Half the difference between even and odd rows, as caused by a stage with play; NaN without positions."""
        rows = [(float(row[ok].mean()), k) for k, row in enumerate(self.residual) if (ok := np.isfinite(row)).any()]
        return abs(math.fsum(-mean if k % 2 else mean for mean, k in rows)) / len(rows) if rows else math.nan

    @property
    def _used(self) -> NDArray[np.float64]:
        return self.residual[np.isfinite(self.residual)]


@dataclass(frozen=True, slots=True)
class _Basis:
    """One, the ramps, and low harmonics of a cell: ``terms = smooth @ inverse(solve)`` with orthonormal columns.

    ``error`` is the standard error of each coefficient per unit of noise, ``ramps`` the axes with a ramp.
    """

    terms: NDArray[np.float64]
    smooth: NDArray[np.float64]
    solve: NDArray[np.float64]
    error: NDArray[np.float64]
    ramps: tuple[int, ...]


@functools.lru_cache(maxsize=8)
def _basis(ny: int, nx: int) -> _Basis:
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    columns = [np.ones(ny * nx)]
    ramps = tuple(axis for axis, n in enumerate((ny, nx)) if n > 1)
    for axis in ramps:
        # about the middle of the cell, so that mean and ramp are independent
        columns.append((((y, x)[axis] + 0.5) / (ny, nx)[axis] - 0.5).ravel())
    # half of all waves, because the others are their complex conjugates
    waves = [(my, mx) for my in range(-(ny // 3), ny // 3 + 1) for mx in range(nx // 3 + 1) if (mx, my) > (0, 0)]
    # lowest frequencies first, ties by their numbers, so that the choice is repeatable
    waves.sort(key=lambda m: ((m[0] / ny) ** 2 + (m[1] / nx) ** 2, m))
    for my, mx in waves[: max(0, int(min(SHARE * ny * nx, MOST_TERMS)) // 2)]:
        phase = (2 * np.pi * (my * y / ny + mx * x / nx)).ravel()
        columns += [np.cos(phase), np.sin(phase)]
    terms = np.stack(columns, 1)
    # with orthonormal columns, each round of the robust fit is two products instead of a solution
    smooth, triangle = np.linalg.qr(terms)
    solve = np.linalg.inv(triangle)
    return _Basis(terms, smooth, solve, np.sqrt((solve**2).sum(1)), ramps)


def split(field: NDArray[np.float64], use: NDArray[np.bool_] | None = None) -> Parts:
    """Split a field over the cell into mean, ramp, ripple and residual, by robust least squares.

    The patterns of a perfect scan repeat with the cell, so any of their properties is a periodic function of the
    position. It is also smooth, because lenslets are many pixels wide, and thus described by low harmonics. A ramp
    does not repeat, and changes between neighbouring positions are not caused by a lattice.

    Parameters
    ----------
    field
        Values ``(ny, nx)``.
    use
        Positions to use; the others are ignored and have a residual of NaN.
    """
    ny, nx = field.shape
    good = np.isfinite(field) if use is None else use & np.isfinite(field)
    keep = good.ravel()
    basis = _basis(ny, nx)
    if keep.sum() < max(4, basis.terms.shape[1]):  # too few positions to determine a ripple
        mean = float(np.median(field[good])) if good.any() else math.nan
        unknown = (math.nan, math.nan)
        return Parts(mean, unknown, unknown, np.zeros((ny, nx)), np.where(good, field - mean, np.nan))
    values = np.where(good, field, np.median(field[good])).ravel()
    fit = np.full(values.size, values[keep].mean())
    scale = 0.0
    for _ in range(ROUNDS):
        # Huber by modified residuals: outliers are moved inwards, unused values are replaced by the fit
        left = np.where(keep, values - fit, 0.0)
        scale = 1.4826 * float(np.median(np.abs(left[keep])))
        # an exact fit has no scale for clipping
        if scale <= 1e-12 * float(np.abs(values).max()):
            break
        drawn = np.clip(left, -HUBER * scale, HUBER * scale)
        fit = basis.smooth @ (basis.smooth.T @ (fit + drawn))
    p = basis.solve @ (basis.smooth.T @ fit)
    left = np.where(keep, values - fit, np.nan)
    noise = float(np.sqrt(np.nanmean(np.clip(left, -3 * scale, 3 * scale) ** 2))) if scale else 0.0
    ramp, error = [0.0, 0.0], [0.0, 0.0]
    for k, axis in enumerate(basis.ramps):
        ramp[axis], error[axis] = float(p[1 + k]), noise * float(basis.error[1 + k])
    first = 1 + len(basis.ramps)
    ripple = (basis.terms[:, first:] @ p[first:]).reshape(ny, nx)
    return Parts(float(p[0]), (ramp[0], ramp[1]), (error[0], error[1]), ripple, left.reshape(ny, nx))
