"""Hybrid H: a model plus measured deviations from it, with less noise than the recorded patterns.

Effects on single patterns, such as the lamp's brightness and the displacement of the source, are first removed if
they matter, because H contains neither. Where residuals are only noise, the hybrid equals the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Work, for_each_chunk, worker_count
from lfcal.camera import ScanPlan
from lfcal.fit._residual_field import PlaneResiduals, ResidualEstimate, iter_residual_estimate
from lfcal.fit._weighing import PatternLevels, unlike_others
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness, ModelPlanes, PlaneModel
from lfcal.fit.model_error import ModelError
from lfcal.fit.nuisance import Spread
from lfcal.fit.problem import ERRORS
from lfcal.fit.setup import Setup
from lfcal.psf import Facts, Header, Origin, Plane, PlaneSource, PSFMatrix, Stored, Zeros

__all__ = [
    "Fitted",
    "FittedPlace",
    "HybridPlanes",
    "HybridSummary",
    "RecordedPatterns",
    "hybrid_note",
    "iter_plane_data",
    "model_uncertainty",
]


class FittedPlace(Protocol):
    """Protocol for the position (z, y, x) of a pattern."""

    @property
    def z(self) -> int:
        """Index of the depth plane."""
        ...

    @property
    def y(self) -> int:
        """Row of the position."""
        ...

    @property
    def x(self) -> int:
        """Column of the position."""
        ...


class Fitted(Protocol):
    """Protocol for the attributes and methods of `lfcal.fit.Fit` that a hybrid H needs."""

    @property
    def planned(self) -> ScanPlan:
        """The scan as planned, with the camera before the fit."""
        ...

    @property
    def ideal_places(self) -> Setup:
        """The setup with sources at the positions of H."""
        ...

    @property
    def levels(self) -> PatternLevels:
        """Gain and background of each plane."""
        ...

    @property
    def spread(self) -> Spread:
        """Scatter of the source positions, of the brightness of the lamp, and of the response of the pixels."""
        ...

    @property
    def outliers(self) -> Sequence[FittedPlace]:
        """Patterns that were excluded from the fit."""
        ...

    @property
    def held_out_error(self) -> ModelError:
        """Relative error (L2) of the patterns of the model."""
        ...

    def planes(self) -> ModelPlanes:
        """Return an object that computes the planes of the model."""
        ...


# -- recorded patterns as residuals of the model -----------------------------------------------------------------------
F4 = NDArray[np.float32]

PATTERNS_SAMPLED = 20
"""Number of patterns with which the effect of a displacement is measured."""

NUISANCE_SHARE = 0.5
"""Smallest effect of the lamp or of displacements, as a fraction of the model's error, that is removed."""

STEP_PX = 0.05
"""Step of the finite differences with respect to the displacement of a source (pixels)."""

NEIGHBOURS = 6
"""Number of nearest recorded positions with which a position is compared."""


def model_uncertainty(model: F4, share: float) -> F4:
    """Return the standard deviation of each entry of a model ``(ny, nx, nt, ns)`` with relative L2 error ``share``.

    The standard deviation is proportional to the light around each pixel, because errors displace and blur light.
    """
    from scipy.ndimage import gaussian_filter  # slow to import

    near = np.sqrt(gaussian_filter(np.square(model), (0, 0, 0.6, 0.6)).clip(min=0))
    power = float(np.square(near).sum(dtype=np.float64))
    size = math.sqrt(float(np.square(model).sum(dtype=np.float64)) / power) if power > 0 else 0.0
    found: F4 = np.float32(share * size) * near
    return found


@dataclass(frozen=True, eq=False)
class RecordedPatterns:
    """The recorded patterns of a scan, read when they are needed.

    ``counts`` is the number of recorded frames at each position, ``(nz, ny, nx)``. ``noise`` contains the constant and
    the slope of the variance of a sample, ``(nz, ny, nx, 2)``. ``read`` is a function that returns the pattern at a
    position (z, y, x), ``(nt, ns)``, and the mask of its valid samples.
    """

    counts: NDArray[np.uint16]
    noise: NDArray[np.float64]
    read: Callable[[int, int, int], tuple[F4, NDArray[np.bool_]]]

    @classmethod
    def of(cls, source: PSFMatrix | Measured, planned: ScanPlan, given: tuple[float, float] | None) -> RecordedPatterns:
        """Return the patterns of ``source``.

        ``given`` is the constant and the slope of the variance of a sample. It replaces the noise that an H states
        (None: as stated). For `Measured`, it is ignored. Raise `InputError` if the shape, depths or anchor of the
        patterns differ from ``planned``, or if their noise is unknown.
        """
        shape = planned.shape
        if isinstance(source, Measured):
            _check_scan(planned, source.plan.shape, source.plan.depths_um, source.plan.anchor)
            counts = np.zeros(shape[:3], np.uint16)
            noise = np.full((*shape[:3], 2), np.nan)
            places = {(z, y, x): k for k, (z, y, x) in enumerate(source.index.tolist())}
            for at, k in places.items():
                counts[at], noise[at] = 1, source.noise[k]

            def one(z: int, y: int, x: int) -> tuple[F4, NDArray[np.bool_]]:
                k = places[z, y, x]
                return source.patterns[k], source.valid[k]

            return cls(counts, noise, one)
        if source.is_transposed:
            raise InputError.expected("patterns", "those of H", "those of HT", "give H")
        _check_scan(planned, source.shape, source.depths, source.anchor)
        counts = source.recorded
        known = source.facts.noise
        if given is not None:
            known = np.broadcast_to(np.asarray(given, np.float32), (*shape[:3], 2))
        if known is None or not np.isfinite(known[counts > 0]).all():
            raise InputError.expected(
                "noise of H", "a variance model", "none", "state the constant and the slope (noise=)"
            )

        def pattern(z: int, y: int, x: int) -> tuple[F4, NDArray[np.bool_]]:
            return np.asarray(source[z, y, x], np.float32), source.valid(z, y, x)

        return cls(counts, known.astype(np.float64), pattern)


def _check_scan(planned: ScanPlan, shape: tuple[int, ...], depths: ArrayLike, anchor: tuple[float, float]) -> None:
    """Raise `InputError` unless a scan has the positions and pixels of the fitted one."""
    remedy = "give the H that was fitted"
    if tuple(shape) != tuple(planned.shape):
        raise InputError.expected(
            "shape of the patterns (z, y, x, t, s)", f"the fitted shape {planned.shape}", tuple(shape), remedy
        )
    for name, wanted, got in (("depths (µm)", planned.depths_um, depths), ("anchor (pixels)", planned.anchor, anchor)):
        if not np.allclose(wanted, got, rtol=1e-9, atol=1e-6):
            raise InputError.expected(f"patterns, {name}", f"{wanted}, as fitted", np.asarray(got).tolist(), remedy)


def iter_plane_data(
    fit: Fitted, recorded: RecordedPatterns, z: int, model: F4, workers: int | None
) -> Work[tuple[PlaneResiduals, Facts]]:
    """Return the residuals of plane ``z`` from its ``model`` ``(ny, nx, nt, ns)``, and facts on its positions.

    If the fit found the lamp or the source positions to be unstable, their effects are removed from the residuals. In
    the residuals, outliers count as not recorded. Progress counts patterns.
    """
    counts = recorded.counts[z]
    residual, precision = np.zeros_like(model), np.zeros_like(model)
    back = fit.levels.backgrounds[z]
    floor = 1e-12 * max(1e-30, float(model.max())) ** 2
    for y, x in np.argwhere(counts > 0).tolist():
        pattern, valid = recorded.read(z, y, x)
        constant, slope = recorded.noise[z, y, x]
        variance = constant + slope * np.maximum(model[y, x], 0) + floor
        residual[y, x] = np.where(valid, pattern - np.float32(back) - model[y, x], 0.0)
        precision[y, x] = np.where(valid, 1.0 / variance, 0.0)
    around = _whole_period(fit.planned)
    own = counts > 0
    data = PlaneResiduals(model, residual, precision, own, around)
    yield from _iter_remove_nuisance(fit, data, z, workers)
    far = _outliers(data)
    for one in fit.outliers:
        if one.z == z:
            far[one.y, one.x] = True
    origin = np.where(far & own, Origin.OUTLIER, Origin.MODEL)
    facts = Facts.of(counts.shape, fit.planned.cutout, recorded=counts, origin=origin)
    return data.without(far), facts


def _whole_period(plan: ScanPlan) -> bool:
    """Return whether the positions are a full period of the camera, to within a pixel."""
    return min(plan.period) > 2 and max(abs(left) for left in plan.period_residual_px) < 1.0


def _iter_remove_nuisance(fit: Fitted, data: PlaneResiduals, z: int, workers: int | None) -> Work[None]:
    """Remove from each residual the effects of lamp and displaced source, if the fit found them to be unstable.

    Only the part that neighbours do not share is removed; the shared part is an error of the model. Progress counts
    patterns.
    """
    places = np.argwhere(data.recorded)
    if len(places) <= NEIGHBOURS:
        return
    lamp, stage = _significant_nuisance(fit, data, places)
    used = np.flatnonzero([lamp, stage, stage])
    if not used.size:
        return
    plane = PlaneModel(fit.ideal_places, fit.planned, z, Fineness.finest) if stage else None
    gain, count = np.float32(fit.levels.gains[z]), worker_count(workers)
    beyond = np.square(model_uncertainty(data.model, max(fit.held_out_error.value, 1e-3)))
    values, errors = np.empty((len(places), used.size)), np.empty((len(places), used.size))
    clock = Clock(f"lamp and stage, plane {z}", 2 * len(places))
    yield clock.at(0)

    def displaced(at: NDArray[np.intp], by: NDArray[np.float64]) -> F4:
        assert plane is not None
        return gain * plane.patterns(at, by)

    def look(start: int, stop: int) -> None:
        at = places[start:stop]
        here = data.model[at[:, 0], at[:, 1]]
        rows = [here]
        for axis in (0, 1) if plane is not None else ():
            by = np.zeros((len(at), 2))
            by[:, axis] = STEP_PX
            rows.append((displaced(at, by) - displaced(at, -by)) / np.float32(2 * STEP_PX))
        part = rows if 0 in used else rows[1:]
        for k, (y, x) in enumerate(at.tolist(), start):
            shape = np.stack([one[k - start].ravel() for one in part]).astype(np.float64)
            precision = data.precision[y, x].astype(np.float64)
            weight = (precision / (1.0 + precision * beyond[y, x])).ravel()
            inverse = np.linalg.pinv((shape * weight) @ shape.T, hermitian=True)
            values[k] = inverse @ ((shape * weight) @ data.residual[y, x].ravel().astype(np.float64))
            errors[k] = np.diag(inverse)

    def take(start: int, stop: int) -> None:
        at = places[start:stop]
        here = data.model[at[:, 0], at[:, 1]]
        lamps = steps[start:stop, 0].astype(np.float32) if 0 in used else np.zeros(len(at), np.float32)
        there = here if plane is None else displaced(at, steps[start:stop, -2:])
        made = (1 + lamps[:, None, None]) * there - here
        measured = data.precision[at[:, 0], at[:, 1]] > 0
        data.residual[at[:, 0], at[:, 1]] -= np.where(measured, made, np.float32(0))

    for turn, work in enumerate((look, take)):
        steps = _nuisance_of(values, errors, places, data) if turn else np.zeros_like(values)
        for first in range(0, len(places), 8 * count):
            last = min(len(places), first + 8 * count)
            for_each_chunk(lambda a, b, at=first, go=work: go(at + a, at + b), last - first, count)  # type: ignore[misc]
            yield clock.at(turn * len(places) + last)


def _significant_nuisance(fit: Fitted, data: PlaneResiduals, places: NDArray[np.intp]) -> tuple[bool, bool]:
    """Return whether the lamp, and whether the stage, changes patterns by more than half the error of the model."""
    some = data.model[tuple(places[:: max(1, len(places) // PATTERNS_SAMPLED)].T)].astype(np.float64)
    slope = math.sqrt(sum(float(np.square(np.gradient(some, axis=axis)).sum()) for axis in (1, 2)) / 2)
    per_px = slope / max(math.sqrt(float(np.square(some).sum())), 1e-300)
    least = NUISANCE_SHARE * fit.held_out_error.value
    return fit.spread.lamp > least, fit.spread.stage_px * per_px > least


SHARED_POSITIONS = 3.0
"""Correlation length of the shared deviations, in positions."""


def _nuisance_of(
    values: NDArray[np.float64], errors: NDArray[np.float64], places: NDArray[np.intp], data: PlaneResiduals
) -> NDArray[np.float64]:
    """Return the part of the values ``(n, k)`` of each position that its neighbours do not share, shrunk by its error.

    A value is the sum of a shared part with Gaussian correlation, the position's own part, and its error. Differences
    between neighbours determine their sizes.
    """
    apart = np.abs(places[:, None] - places)
    if data.around:
        apart = np.minimum(apart, np.array(data.recorded.shape) - apart)
    square = np.square(apart).sum(2).astype(np.float64)
    near = np.argsort(square, axis=1, kind="stable")[:, 1 : 1 + NEIGHBOURS]
    correlation = 0.5 + 0.5 * np.exp(-0.5 * square / SHARED_POSITIONS**2)
    out = np.zeros_like(values)
    for k in range(values.shape[1]):
        value, error = values[:, k], errors[:, k]
        left = np.square(value - value[near].mean(1)) - error - error[near].sum(1) / NEIGHBOURS**2
        own = float(left.mean()) / (1.0 + 1.0 / NEIGHBOURS)
        if own <= 0.0:
            continue
        shared = max(0.0, float(np.mean(np.square(value) - error)) - own) * correlation
        smooth = shared @ np.linalg.solve(shared + np.diag(own + error), value)
        out[:, k] = (value - smooth) * (own / (own + error))
    return out


def _outliers(data: PlaneResiduals) -> NDArray[np.bool_]:
    """Return a mask ``(ny, nx)`` of the positions that differ from the others."""
    far, own = np.zeros(data.recorded.shape, np.bool_), data.recorded
    pixels = np.maximum(1, (data.precision[own] > 0).sum((1, 2)))
    chi2 = (np.square(data.residual[own]) * data.precision[own]).sum((1, 2), dtype=np.float64) / pixels
    far[own] = unlike_others(chi2, pixels)
    return far


# -- the planes of the hybrid H ----------------------------------------------------------------------------------------


INFORMED_SHARE = 0.95
"""Largest fraction of the variance that may remain for a position to be interpolated from its neighbours."""


@dataclass(frozen=True, slots=True)
class HybridSummary:
    """Summary of a hybrid H: the model, corrected where the recorded patterns deviate from it significantly.

    Attributes
    ----------
    hybrid, model, outliers
        Number of positions of each `Origin`.
    between
        Number of the positions in ``hybrid`` that were not recorded but interpolated from their neighbours.
    change, largest
        Root mean square and largest value, over the changed positions, of the relative difference (L2) from the model.
    """

    hybrid: int
    model: int
    outliers: int
    between: int
    change: float
    largest: float

    def __str__(self) -> str:
        """Return the summary as one line."""
        if not self.hybrid:
            return "hybrid H: no position deviates from the model by more than its noise, so it equals the model"
        said = f"{self.hybrid} positions changed by {100 * self.change:.2g} % (at most {100 * self.largest:.2g} %)"
        between = f", {self.between} of them between recorded ones" if self.between else ""
        outliers = f", {self.outliers} outliers use the model" if self.outliers else ""
        return f"hybrid H: {said}{between}; {self.model} positions use only the model{outliers}"

    @classmethod
    def of(cls, planes: Sequence[tuple[Facts, NDArray[np.float64]]]) -> HybridSummary:
        """Return the summary of ``planes``, each with its facts and relative changes (L2) by position ``(ny, nx)``."""
        origin = np.stack([facts.origin for facts, _ in planes if facts.origin is not None])
        recorded = np.stack([facts.recorded for facts, _ in planes if facts.recorded is not None])
        changed = np.stack([change for _, change in planes])[origin == Origin.HYBRID]
        count = [int((origin == one).sum()) for one in (Origin.HYBRID, Origin.MODEL, Origin.OUTLIER)]
        between = int(((origin == Origin.HYBRID) & (recorded == 0)).sum())
        size = math.sqrt(float(np.square(changed).mean())) if changed.size else 0.0
        return cls(count[0], count[1], count[2], between, size, float(changed.max(initial=0.0)))


class HybridPlanes(PlaneSource):
    """The planes of the hybrid H of a fit and recorded patterns.

    Parameters
    ----------
    header
        Header of H, without its values.
    fit
        The fit that contains the model.
    source
        Recorded patterns of the same scan, including those that were not fitted.
    noise
        Constant and slope of the variance of a sample, as in `lfcal.fit.NewFrame`. None: as stated by the H. For
        `Measured`, which states its own noise, ``noise`` is ignored.

    Raises
    ------
    InputError
        If the patterns belong to another scan, their noise is unknown, or the source is a transposed H.
    """

    def __init__(
        self, header: Header, fit: Fitted, source: PSFMatrix | Measured, noise: tuple[float, float] | None = None
    ) -> None:
        self.header, self._fit, self._model = header, fit, fit.planes()
        self._recorded = RecordedPatterns.of(source, fit.planned, noise)
        self._made: dict[int, tuple[Facts, NDArray[np.float64]]] = {}

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Compute plane ``z``; progress counts rows of the model, then patterns, then tiles."""
        model = yield from self._model.iter_plane(z, zeros, workers, alone=alone)
        data, facts = yield from iter_plane_data(self._fit, self._recorded, z, model.values, workers)
        left = yield from iter_residual_estimate(data, f"deviations from the model, plane {z}", seed=z, workers=workers)
        plane, changed = _joined(self._fit, data, facts, left)
        self._made[z] = plane.facts, changed
        return plane

    def reopening(self, z: int, stored: Stored) -> None:
        """Return None, because every plane must be computed in this process: the summary covers all of them."""
        return

    @property
    def summary(self) -> HybridSummary:
        """Summary of the planes computed so far."""
        return HybridSummary.of([self._made[z] for z in sorted(self._made)])

    def late_provenance(self) -> dict[str, Any]:
        """Return the summary as plain JSON types, to be added to the provenance."""
        return hybrid_note(self.summary)


def hybrid_note(summary: HybridSummary) -> dict[str, Any]:
    """Return what the provenance of a hybrid H contains in addition to that of the fit, as plain JSON types."""
    return {"hybrid": asdict(summary)}


def _joined(
    fit: Fitted, data: PlaneResiduals, facts: Facts, left: ResidualEstimate
) -> tuple[Plane, NDArray[np.float64]]:
    """Return the plane of model plus estimate, where the estimate is an improvement, and its relative change.

    The relative change ``(ny, nx)`` is the rms change of a pattern over the rms of its light.
    """
    assert facts.origin is not None
    own = data.recorded & (not left.kind.empty)
    changed = own | ((facts.origin != Origin.OUTLIER) & left.kind.supported)
    changed |= left.kind.supported & (facts.origin == Origin.OUTLIER)
    value = np.where(changed[:, :, None, None], left.value, np.float32(0.0))
    power = np.square(data.model).sum((2, 3), dtype=np.float64)
    size = np.sqrt(np.square(value).sum((2, 3), dtype=np.float64) / np.maximum(power, 1e-30))
    # without a recorded pattern nearby, the estimate is 0
    informed = left.variance.sum((2, 3), dtype=np.float64) < INFORMED_SHARE * left.prior.sum((2, 3), dtype=np.float64)
    changed &= own | informed
    origin = np.where(changed & (facts.origin != Origin.OUTLIER), Origin.HYBRID, facts.origin)
    value *= changed[:, :, None, None]
    error = fit.held_out_error
    share = error.value if left.kind.empty else error.statistical
    base = model_uncertainty(data.model, math.hypot(share, ERRORS[Fineness.finest]))
    beyond = np.where(changed[:, :, None, None], left.variance, left.prior)
    known = replace(facts, origin=origin.astype(np.uint8))
    return Plane(data.model + value, known, np.sqrt(np.square(base) + beyond)), np.where(changed, size, 0.0)
