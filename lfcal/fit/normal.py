"""Normal equations of all patterns for the shared unknowns; unknowns of single patterns are eliminated (Schur)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.fit._weighing import PatternLevels, Response, Weighed

__all__ = ["Columns", "Local", "Normal", "normal_equations"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Columns:
    """Derivatives of the ``n`` patterns, each of ``m`` samples, at unit gain.

    Attributes
    ----------
    shared
        Derivatives with respect to each unknown, ``(k, n, m)``.
    displacements
        Derivatives with respect to the displacement (dy, dx) of each source, ``(2, n, m)``; None if sources are not
        displaced.
    """

    shared: F4
    displacements: F4 | None = None

    def with_others(self, others: Columns, which: Sequence[int]) -> Columns:
        """Return a copy of ``others`` that takes some of its derivatives from this object.

        These are the derivatives with respect to the unknowns ``which`` and to the displacements.
        """
        shared = others.shared.copy()
        shared[list(which)] = self.shared[list(which)]
        return Columns(shared, self.displacements)


@dataclass(frozen=True, eq=False)
class Local:
    """Unknowns of single patterns: current values and priors.

    Attributes
    ----------
    offsets_px
        Displacements ``(n, 2)`` of the sources as (dy, dx) (pixels on the sensor).
    stage_px
        Prior rms of the displacements (pixels); 0: sources are exactly at their positions.
    lamp
        Relative rms fluctuation of the lamp; 0: it is stable.
    response
        Variation of the response between pixels, which acts as noise proportional to the light.
    """

    offsets_px: F8
    stage_px: float = 0.0
    lamp: float = 0.0
    response: Response = Response()  # noqa: RUF009

    @property
    def count(self) -> int:
        """Number of unknowns of each pattern."""
        return 2 * (self.stage_px > 0) + (self.lamp > 0)

    def precision(self) -> F8:
        """Return the prior precision (1/sigma²) of each unknown of a pattern ``(count,)``: displacements, then lamp."""
        parts = ([self.stage_px**-2.0] * 2 if self.stage_px > 0 else []) + ([self.lamp**-2.0] if self.lamp > 0 else [])
        return np.array(parts)


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations N d = g for the shared unknowns, followed by the gains and then the backgrounds of all planes.

    Attributes
    ----------
    matrix, gradient
        N ``(k, k)`` and g ``(k,)`` for all k shared unknowns, gains and backgrounds, after elimination of the unknowns
        of single patterns.
    chi2
        Sum of squared residuals with unchanged shared unknowns, and with the unknowns of single patterns at their best
        values.
    solved
        C^-1 B^T and C^-1 h of each pattern. Before the elimination, C is the block for the unknowns of the pattern, and
        h their part of the gradient. B is the block that couples them to the k others. For a step d of the others, the
        step of the unknowns of the pattern is ``C^-1 h - C^-1 B^T d``.
    """

    matrix: F8
    gradient: F8
    chi2: float
    solved: tuple[tuple[F8, F8], ...]

    def change(self, step: F8, which: NDArray[np.intp] | slice = slice(None)) -> float:
        """Return the decrease of the sum of squares that the equations predict for ``step``.

        ``step`` contains the changes of the unknowns with the indices ``which``, by default of all. The other unknowns
        of the equations do not change.
        """
        inner = self.matrix[which][:, which] if isinstance(which, slice) else self.matrix[np.ix_(which, which)]
        return float(2 * self.gradient[which] @ step - step @ inner @ step)


def normal_equations(
    columns: Columns,
    model: F4,
    seen: Weighed,
    levels: PatternLevels,
    planes: NDArray[np.intp],
    local: Local,
) -> Normal:
    """Return the normal equations of n patterns.

    ``columns`` contains the derivatives of the predictions ``model`` ``(n, m)`` at unit gain, and ``seen`` the weighted
    residuals. The index of the depth plane of each pattern is in ``planes`` ``(n,)``. The equations include the priors
    of the unknowns of each pattern, ``local``, but not those of the shared unknowns.
    """
    k, nz = len(columns.shared), len(levels.gains)
    size = k + 2 * nz
    matrix, gradient, left = np.zeros((size, size)), np.zeros(size), 0.0
    factors, solved = levels.factors(planes), list[tuple[F8, F8]]()
    precision = local.precision()
    for p, z in enumerate(planes.tolist()):
        weight = seen.inverse[p] * seen.robust[p]
        r = (seen.residual[p] * seen.robust[p]).astype(np.float64)
        light = np.float32(factors[p]) * weight
        x = np.zeros((size, r.size), np.float32)
        x[:k] = columns.shared[:, p] * light
        x[k + z] = model[p] * np.float32(1.0 + levels.lamps[p]) * weight
        x[k + nz + z] = weight
        own = []
        if local.stage_px > 0 and columns.displacements is not None:
            own += [columns.displacements[0, p] * light, columns.displacements[1, p] * light]
        if local.lamp > 0:
            own.append(model[p] * np.float32(levels.gains[z]) * weight)
        used = np.r_[0:k, k + z, k + nz + z]
        part = x[used].astype(np.float64)
        matrix[np.ix_(used, used)] += part @ part.T
        gradient[used] += part @ r
        left += float(r @ r)
        if not own:
            solved.append((np.zeros((0, size)), np.zeros(0)))
            continue
        y = np.stack(own).astype(np.float64)
        now = np.r_[local.offsets_px[p] if local.stage_px > 0 else [], [levels.lamps[p]] if local.lamp > 0 else []]
        c, h = y @ y.T + np.diag(precision), y @ r - precision * now
        b = np.zeros((size, len(y)))
        b[used] = part @ y.T
        cb, ch = np.linalg.solve(c, b.T).astype(np.float64), np.linalg.solve(c, h).astype(np.float64)
        matrix -= b @ cb
        gradient -= b @ ch
        left += float(precision @ now**2 - h @ ch)
        solved.append((cb, ch))
    return Normal(matrix, gradient, left, tuple(solved))
