"""Recorded patterns as residuals of a model: what belongs to single patterns taken out, outliers left out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from lfcal.camera import ScanPlan
from lfcal.errors import InputError
from lfcal.fit.leftover_size import PlaneData
from lfcal.fit.measured import Measured
from lfcal.psf import PSFMatrix
from lfcal.psf.facts import Facts, Origin

if TYPE_CHECKING:
    from lfcal.fit.result import Fit

__all__ = ["Recorded", "model_uncertainty", "plane_data"]

F4 = NDArray[np.float32]

FAR = 8.0
"""Robust standard deviations from the other patterns' chi² from which on a pattern is left to the model."""

LEAST = 1.3
"""How many times the others' chi² it must be."""


def model_uncertainty(model: F4, share: float) -> F4:
    """Return the standard deviation of each entry of a model ``(ny, nx, nt, ns)`` whose relative L2 error is ``share``.

    It is as the light about each pixel, for what is wrong displaces and blurs.
    """
    near = np.sqrt(gaussian_filter(np.square(model), (0, 0, 0.6, 0.6)).clip(min=0))
    power = float(np.square(near).sum(dtype=np.float64))
    size = math.sqrt(float(np.square(model).sum(dtype=np.float64)) / power) if power > 0 else 0.0
    found: F4 = np.float32(share * size) * near
    return found


@dataclass(frozen=True, eq=False)
class Recorded:
    """The recorded patterns of a scan, read as they are asked for."""

    counts: NDArray[np.uint16]
    noise: NDArray[np.float64]
    read: Callable[[int, int, int], tuple[F4, NDArray[np.bool_]]]

    @classmethod
    def of(cls, source: PSFMatrix | Measured, planned: ScanPlan, given: tuple[float, float] | None) -> Recorded:
        """Return those of an H or of patterns; raises `InputError` where they are of another scan."""
        shape = planned.shape
        if isinstance(source, Measured):
            _check_scan(source.plan, planned)
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
        depths = tuple(float(z) for z in source.depths)
        _check_scan(ScanPlan(planned.camera, source.period, source.cutout, depths, source.anchor), planned)
        counts = source.recorded
        known = source.facts.noise
        if given is not None:
            known = np.broadcast_to(np.asarray(given, np.float32), (*shape[:3], 2))
        if known is None or not np.isfinite(known[counts > 0]).all():
            raise InputError.expected("noise of H", "a variance model", "none", "give noise=(constant, slope)")

        def pattern(z: int, y: int, x: int) -> tuple[F4, NDArray[np.bool_]]:
            return np.asarray(source[z, y, x], np.float32), source.valid(z, y, x)

        return cls(counts, known.astype(np.float64), pattern)


def _check_scan(plan: ScanPlan, planned: ScanPlan) -> None:
    """Raise where a scan's positions and pixels are not those that were fitted."""
    for name in ("period", "cutout", "depths_um", "anchor"):
        wanted, got = getattr(planned, name), getattr(plan, name)
        if np.shape(wanted) != np.shape(got) or not np.allclose(wanted, got, rtol=1e-9, atol=1e-6):
            raise InputError.expected(f"patterns, {name}", f"those fitted, {wanted}", got, "give the H that was fitted")


def plane_data(fit: Fit, recorded: Recorded, z: int, model: F4) -> tuple[PlaneData, Facts]:
    """Return model and residuals of plane ``z``, and of which positions they are; outliers count as not recorded."""
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
    data = PlaneData(model, residual, precision, own, around)
    _take_own(fit, data)
    far = _outliers(data)
    for one in fit.outliers:
        if one.z == z:
            far[one.y, one.x] = True
    origin = np.where(far & own, Origin.OUTLIER, Origin.MODEL)
    facts = Facts.of(counts.shape, fit.planned.cutout, recorded=counts, origin=origin)
    return data.without(far), facts


def _whole_period(plan: ScanPlan) -> bool:
    """Return whether the positions are a whole period of the camera, to a pixel."""
    return min(plan.period) > 2 and max(abs(left) for left in plan.period_residual_px) < 1.0


def _take_own(fit: Fit, data: PlaneData) -> None:
    """Take out of each residual what lamp and displaced source make of it, where the fit found that they are unsteady.

    A pattern's own is what its neighbours do not share: what they share the model lacks. The derivative by the source's
    place is that between neighbouring positions, on the sensor.
    """
    spread = fit.spread
    used = np.flatnonzero([spread.lamp, spread.stage_px, spread.stage_px])
    places = np.argwhere(data.recorded)
    if not used.size or len(places) <= NEIGHBOURS:
        return
    beyond = np.square(model_uncertainty(data.model, max(fit.left_out_error.value, 1e-3)))
    values, errors, shapes = np.empty((len(places), used.size)), np.empty((len(places), used.size)), []
    for k, (y, x) in enumerate(places.tolist()):
        rows = np.stack([data.model[y, x], *(_slope(data, y, x, axis) for axis in (0, 1))])[used]
        rows = rows.reshape(len(used), -1).astype(np.float64)
        precision = data.precision[y, x].astype(np.float64)
        weight = (precision / (1.0 + precision * beyond[y, x])).ravel()
        inverse = np.linalg.pinv((rows * weight) @ rows.T, hermitian=True)
        values[k] = inverse @ ((rows * weight) @ data.residual[y, x].ravel().astype(np.float64))
        errors[k] = np.diag(inverse)
        shapes.append(rows)
    steps = _not_shared(values, errors, places, data)
    for (y, x), step, rows in zip(places.tolist(), steps, shapes, strict=True):
        made = (step @ rows).reshape(data.model.shape[2:])
        data.residual[y, x] -= np.where(data.precision[y, x] > 0, made, 0.0).astype(np.float32)


NEIGHBOURS = 6
"""Nearest recorded positions whose mean is what a position shares with them."""


def _not_shared(
    values: NDArray[np.float64], errors: NDArray[np.float64], places: NDArray[np.intp], data: PlaneData
) -> NDArray[np.float64]:
    """Return what of each position's values ``(n, k)`` its neighbours do not share, shrunk by its error."""
    apart = np.abs(places[:, None] - places)
    if data.around:
        apart = np.minimum(apart, np.array(data.recorded.shape) - apart)
    near = np.argsort(np.square(apart).sum(2), axis=1, kind="stable")[:, 1 : 1 + NEIGHBOURS]
    left, error = values - values[near].mean(1), errors + errors[near].sum(1) / NEIGHBOURS**2
    own = np.maximum(0.0, np.mean(np.square(left) - error, axis=0)) / (1.0 + 1.0 / NEIGHBOURS)
    found: NDArray[np.float64] = left * (own / np.maximum(own + error, 1e-30))
    return found


def _slope(data: PlaneData, y: int, x: int, axis: int) -> F4:
    """Return the derivative of a pattern by its source's place along an axis, pixels held on the sensor."""
    n, at = data.model.shape[axis], (y, x)[axis]
    sides: list[F4] = []
    for step in (1, -1):
        other = (at + step) % n if data.around else at + step
        here = data.model[y, x]
        if not 0 <= other < n:
            sides.append(here)
            continue
        there = data.model[other, x] if axis == 0 else data.model[y, other]
        # the cutout went along with the source
        moved = np.roll(there, step, axis)
        edge = [slice(None), slice(None)]
        edge[axis] = slice(0, 1) if step == 1 else slice(-1, None)
        moved[tuple(edge)] = here[tuple(edge)]
        sides.append(moved)
    found: F4 = np.float32(0.5) * (sides[0] - sides[1])
    return found


def _outliers(data: PlaneData) -> NDArray[np.bool_]:
    """Return which positions ``(ny, nx)`` are not like the others, by chi² against median and spread of all."""
    far = np.zeros(data.recorded.shape, np.bool_)
    own = data.recorded
    pixels = np.maximum(1, (data.precision[own] > 0).sum((1, 2)))
    if len(pixels) < 4:
        return far
    chi2 = (np.square(data.residual[own]) * data.precision[own]).sum((1, 2), dtype=np.float64) / pixels
    middle = float(np.median(chi2))
    noise = middle * float(np.median(np.sqrt(2.0 / pixels)))
    spread = max(1.4826 * float(np.median(np.abs(chi2 - middle))), noise)
    found = (chi2 > middle + FAR * spread) & (chi2 > LEAST * middle)
    # a quarter of the patterns are no outliers: then the model is wrong
    far[own] = found & (found.mean() <= 0.25)
    return far
