"""The patterns and unknowns of one fit: predictions for a vector, derivatives, and agreement with the data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, for_each_chunk, one_blas_thread, worker_count
from lfcal.fit._elemental import Elemental
from lfcal.fit._weighing import PatternLevels, Weighed, levels_of, weighed
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness, predict
from lfcal.fit.normal import Columns, Local, Normal, normal_equations
from lfcal.fit.parameters import Vector
from lfcal.simulate import Sampling
from lfcal.simulate.engines import EnergyError

__all__ = ["ERRORS", "STEP", "Point", "Problem"]

STEP = 0.1
"""Step of a finite difference, in scales of its unknown."""

STEP_PX = 0.05
"""Step of the finite differences with respect to the displacement of a source (pixels)."""

ERRORS = {Fineness.coarse: 4e-3, Fineness.fine: 1e-3, Fineness.finest: 6e-4}
"""Error of the computation at each sampling, as a fraction of the light (relative L2, for the bench camera)."""

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """A vector of unknowns, with the predictions and residuals computed for it.

    Attributes
    ----------
    u
        Differences of the unknowns from their start, in units of their scales.
    local
        Unknowns of single patterns.
    model
        Predictions at unit gain ``(n, m)``.
    levels, seen
        Gains and backgrounds of the planes, with the lamp's changes, and the weighted residuals of the patterns.
    sampling, doubtful
        Sampling of the computation, and whether the model is still doubtful. If so, the larger of model and data
        determines the variance of a sample.
    """

    u: F8
    local: Local
    model: F4
    levels: PatternLevels
    seen: Weighed
    sampling: Sampling
    doubtful: bool


class Problem:
    """Patterns and unknowns of a fit, with methods for predictions, derivatives and the loss.

    Parameters
    ----------
    measured
        The patterns, including those held out.
    vector
        All unknowns that the fit may change.
    workers
        Number of threads that compute derivatives. None: all processors.
    """

    def __init__(self, measured: Measured, vector: Vector, workers: int | None = None) -> None:
        self.measured, self.vector = measured, vector
        self.workers = worker_count(workers)
        self.planes = measured.level
        self.fitted = ~measured.held_out

    def with_measured(self, measured: Measured) -> Problem:
        """Return the problem with its patterns replaced by ``measured``."""
        return Problem(measured, self.vector, self.workers)

    # -- predictions -------------------------------------------------------------------------------------
    def model(self, u: F8, offsets_px: F8, sampling: Sampling) -> F4:
        """Return the predictions ``(n, m)`` at unit gain for the vector ``u``.

        ``offsets_px`` ``(n, 2)`` contains the displacements (dy, dx) of the sources (pixels).

        Raises
        ------
        InputError, EnergyError
            If the vector describes an impossible camera, or one that cannot be computed at ``sampling``.
        """
        measured = self.measured
        offsets = offsets_px + measured.places_px
        setup = self.vector.setup_at(u)
        if isinstance(measured, Elemental):
            return measured.predicted(setup, offsets, sampling)
        found = np.empty((len(measured), *measured.plan.cutout), np.float32)
        for plan, own, k in measured.parts():
            found[own] = predict(setup.of_region(k), plan, measured.index[own], offsets[own], sampling)
        more = measured.more_light(setup.hole_um)
        if more is not None:
            found += more
        return found.reshape(len(measured), -1)

    def point(
        self, u: F8, local: Local, sampling: Sampling, *, lamps: F8 | None = None, doubtful: bool = False
    ) -> Point:
        """Return the point at the vector ``u``, after computing its predictions.

        ``lamps`` ``(n,)`` is the relative change of the lamp's brightness at each pattern. None: no change. The other
        arguments are those of `Point`.
        """
        model = self.model(u, local.offsets_px, sampling)
        return self.weigh(u, local, model, sampling, lamps=lamps, doubtful=doubtful)

    def weigh(
        self, u: F8, local: Local, model: F4, sampling: Sampling, *, lamps: F8 | None = None, doubtful: bool = False
    ) -> Point:
        """Return the point at the vector ``u`` for predictions ``model`` ``(n, m)`` that are already known.

        ``lamps`` ``(n,)`` is the relative change of the lamp's brightness at each pattern. None: no change. The other
        arguments are those of `Point`.
        """
        own = np.zeros(len(self.measured)) if lamps is None else lamps
        error = _error(sampling, local)
        levels = levels_of(self.measured, model, own, doubtful=doubtful, error=error)
        seen = weighed(self.measured, model, levels, doubtful=doubtful, error=error)
        return Point(u, local, model, levels, seen, sampling, doubtful)

    def cost(self, point: Point, by: Point | None = None) -> float:
        """Return the loss of the fitted patterns and priors, with the noise at ``by`` (None: at ``point``)."""
        seen = point.seen
        if by is not None and by is not point:
            seen = weighed(
                self.measured,
                point.model,
                point.levels,
                doubtful=point.doubtful,
                error=_error(point.sampling, point.local),
                inverse=by.seen.inverse,
            )
        precision, _ = self.vector.prior()
        own = self._own(point)
        return float(seen.cost[self.fitted].sum() + precision @ point.u**2 + own)

    def _own(self, point: Point) -> float:
        local, lamps = point.local, point.levels.lamps
        total = 0.0
        if local.stage_px > 0:
            total += float((local.offsets_px[self.fitted] ** 2).sum()) / local.stage_px**2
        if local.lamp > 0:
            total += float((lamps[self.fitted] ** 2).sum()) / local.lamp**2
        return total

    # -- derivatives -------------------------------------------------------------------------------------
    def columns(
        self, point: Point, which: Sequence[int], note: str, *, displaced: bool, both: bool | None = None
    ) -> Work[Columns]:
        """Compute the derivatives of the patterns with respect to the unknowns with the indices ``which``.

        If ``displaced``, derivatives with respect to the displacements of the sources are computed as well. All are
        finite differences at the coarse sampling; those with respect to unknowns not in ``which`` are 0.
        Progress counts derivatives and shows ``note``. With ``both``, differences for unknowns are central. None: they
        are central unless the sampling of ``point`` is coarse. One-sided differences contain a curvature of a few
        percent, which makes degenerate unknowns appear distinguishable. Differences for displacements are one-sided.
        """
        central = point.sampling != Fineness.coarse if both is None else both
        tasks: list[tuple[str, int]] = [("shared", int(k)) for k in which]
        tasks += [("displacement", axis) for axis in (0, 1)] if displaced else []
        clock = Clock(note, len(tasks) + 1)
        yield clock.at(0)
        base = point.model if point.sampling == Fineness.coarse else self._coarse(point)
        shared = np.zeros((len(self.vector), *base.shape), np.float32)
        moved = np.zeros((2, *base.shape), np.float32) if displaced else None

        def some(start: int, stop: int) -> None:
            for kind, k in tasks[start:stop]:
                if kind == "shared":
                    shared[k] = self._derivative(point, base, k, both=central)
                elif moved is not None:
                    by = np.zeros(2)
                    by[k] = STEP_PX
                    further = self.model(point.u, point.local.offsets_px + by, Fineness.coarse)
                    moved[k] = (further - base) / np.float32(STEP_PX)

        with one_blas_thread():
            for first in range(0, len(tasks), self.workers):
                last = min(len(tasks), first + self.workers)
                for_each_chunk(lambda a, b, at=first: some(at + a, at + b), last - first, self.workers)  # type: ignore[misc]
                yield clock.at(1 + last)
        return Columns(shared, moved)

    def _coarse(self, point: Point) -> F4:
        return self.model(point.u, point.local.offsets_px, Fineness.coarse)

    def _derivative(self, point: Point, base: F4, k: int, *, both: bool) -> F4:
        """Return the derivative with respect to unknown ``k``; with ``both``, as a central difference if possible."""
        found: list[F4] = []
        for step in (STEP, -STEP):
            u = point.u.copy()
            u[k] += step
            if not np.isclose(self.vector.clipped(u)[k], u[k]):
                continue
            try:
                found.append((self.model(u, point.local.offsets_px, Fineness.coarse) - base) / np.float32(step))
            except (InputError, EnergyError):
                continue
            if not both:
                break
        if not found:
            return np.zeros_like(base)
        return found[0] if len(found) == 1 else (found[0] + found[1]) / np.float32(2)

    def normal(self, columns: Columns, point: Point, keep: NDArray[np.bool_]) -> Normal:
        """Return the normal equations of the patterns selected by the mask ``keep``.

        ``columns`` contains the derivatives of all patterns. The priors of the shared unknowns are not included.
        """
        part = Columns(
            columns.shared[:, keep], None if columns.displacements is None else columns.displacements[:, keep]
        )
        local = replace(point.local, offsets_px=point.local.offsets_px[keep])
        levels = replace(point.levels, lamps=point.levels.lamps[keep])
        return normal_equations(part, point.model[keep], point.seen.of(keep), levels, self.planes[keep], local)


def _error(sampling: Sampling, local: Local) -> float:
    """Return the error of predictions due to the computation and to uneven pixels, as a fraction of the light."""
    return math.hypot(ERRORS[sampling], local.response.rms)
