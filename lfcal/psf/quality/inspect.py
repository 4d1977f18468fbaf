"""The inspection: every plane read once, every metric judged."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.errors import InputError
from lfcal.progress import Clock, Work, drain
from lfcal.psf.aperture import FNumber, working_f_number
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.quality.across import Across, compare_planes, shadow_sizes
from lfcal.psf.quality.catalogue import SPECS
from lfcal.psf.quality.frames import PlaneMeasures
from lfcal.psf.quality.lattice import wave_vectors
from lfcal.psf.quality.measure import STAGES, PlaneContext, iter_measure
from lfcal.psf.quality.metric import Metric, Spec, judge
from lfcal.psf.quality.periodicity import periodicity
from lfcal.psf.quality.report import QualityReport

__all__ = ["inspect", "iter_inspect"]

SAMPLED_SLICES = 2


Controls = Mapping[int, tuple[ArrayLike, ArrayLike]]
"""Control frames ``(n, nt, ns)`` and their positions ``(n, 2)`` by depth plane, as `periodicity` takes them."""


def inspect(
    matrix: PSFMatrix | ArrayLike, *, controls: Controls | None = None, workers: int | None = None
) -> QualityReport:
    """Return the quality of H: see `iter_inspect`."""
    return drain(iter_inspect(matrix, controls=controls, workers=workers))


def iter_inspect(
    matrix: PSFMatrix | ArrayLike, *, controls: Controls | None = None, workers: int | None = None
) -> Work[QualityReport]:
    """Measure every metric of `lfcal.psf.quality.catalogue` on H.

    Each plane is read once and let go; memory is that of two planes at most.

    Parameters
    ----------
    matrix
        H; of a transposed view, the H behind it is inspected. Values of other types are taken as float32.
    controls
        Control frames by depth plane, where there are some: how true the tiling is over the field.
    workers
        Threads; every processor by default.

    Raises
    ------
    InputError
        If H holds complex numbers.
    """
    start = time.perf_counter()
    H = matrix if isinstance(matrix, PSFMatrix) else PSFMatrix(matrix)
    if H.is_transposed:
        H = H.T
    if H.dtype.kind == "c":
        raise InputError("PSF matrix: expected real numbers, got complex ones; give intensities")
    waves = wave_vectors(H.camera, H.period)
    clock = Clock("inspecting planes", STAGES * len(H))
    planes: list[PlaneMeasures] = []
    yield clock.at(0)
    for z in range(len(H)):
        planes.append((yield from _iter_plane(H, z, waves, (controls or {}).get(z), clock, workers)))
    across = compare_planes(planes, H.depths, H.camera)
    metrics = sorted((_metric(s, H, planes, across) for s in SPECS), key=_rank)
    return QualityReport(
        shape=H.shape,
        depths=H.depths,
        metrics=tuple(metrics),
        apertures=tuple(p.aperture for p in planes),
        virtual_depths=_virtual_depths(H, planes),
        f_number=_f_number(H, planes),
        noise=np.array([p.dark.noise for p in planes]),
        peak=np.array([p.peak for p in planes]),
        energy=np.array([p.energy for p in planes]),
        tilings=tuple(p.tiling for p in planes),
        seconds=time.perf_counter() - start,
    )


def _iter_plane(
    H: PSFMatrix,
    z: int,
    waves: NDArray[np.float64],
    controls: tuple[ArrayLike, ArrayLike] | None,
    clock: Clock,
    workers: int | None,
) -> Work[PlaneMeasures]:
    values = np.ascontiguousarray(H.plane(z), np.float32)
    total = H.depth_sum(z)
    context = PlaneContext(
        np.where(np.isfinite(total), total, 0.0),
        H.aperture(z),
        waves,
        H.recorded[z],
        None if H.saturated is None else H.saturated[z],
    )
    measures = yield from iter_measure(values, context, clock, STAGES * z, workers)
    if "identities" in measures.values:
        wrong = max(measures.values["identities"], _transposition(H, z, values, measures.peak))
        measures.values["identities"] = wrong if np.isfinite(total).all() else math.nan
    if controls is not None and len(np.asarray(controls[1])):
        measures.tiling = periodicity(*controls, values, anchor=H.anchor)
        measures.values["tiling"] = 100 * float(measures.tiling.difference.max())
        y, x = measures.tiling.fitting_period
        measures.details["tiling"] = f"plane {z}: a period of {y:.2f} x {x:.2f} px fits best"
    return measures


def _transposition(H: PSFMatrix, z: int, plane: NDArray[np.float32], peak: float) -> float:
    """Return the largest difference of sampled slices of HT from the entries of H they must equal, over the peak."""
    ny, nx, nt, ns = plane.shape
    t, s = np.meshgrid(np.arange(nt), np.arange(ns), indexing="ij")
    rng = np.random.default_rng(2)
    worst = 0.0
    for _ in range(SAMPLED_SLICES):
        y, x = int(rng.integers(ny)), int(rng.integers(nx))
        entries = plane[(y + t - (nt - 1) // 2) % ny, (x + s - (ns - 1) // 2) % nx, nt - 1 - t, ns - 1 - s]
        difference = np.abs(np.asarray(H.T[z, y, x], np.float64) - entries)
        if np.isfinite(difference).any():
            worst = max(worst, float(np.nanmax(difference)))
    return worst / max(abs(peak), 1e-300)


def _metric(s: Spec, H: PSFMatrix, planes: list[PlaneMeasures], across: Across) -> Metric:
    """Return one metric of all planes."""
    if s.key in across.values:
        per_plane = across.values[s.key]
    elif s.key == "period":
        per_plane = np.array([_period_error(H)])
    else:
        per_plane = np.array([p.values.get(s.key, math.nan) for p in planes])
    shown = None
    if any(s.key in p.maps for p in planes):
        blank = np.full(H.shape[1:3], np.nan)
        shown = np.stack([p.maps.get(s.key, blank) for p in planes]).astype(np.float32)
    named = np.zeros(H.shape[:3], bool)
    for z, p in enumerate(planes):
        if s.key in p.named:
            named[z] = p.named[s.key]
        if s.key in ("planes_lit", "plane_copies") and per_plane[z] == 1:
            named[z] = True
    words = {p.details[s.key] for p in planes if p.details.get(s.key)} | {across.details.get(s.key, "")}
    detail = "; ".join(sorted(words - {""}))
    return judge(s, per_plane, int(np.prod(H.shape[:3])), map=shown, positions=np.argwhere(named), detail=detail)


def _rank(metric: Metric) -> tuple[int, float]:
    return ({"bad": 0, "fair": 1, "good": 2, "unknown": 3}[metric.merit], -metric.cost)


def _period_error(H: PSFMatrix) -> float:
    """Return by how much the recorded period differs from whole periods of the camera's lattice (pixels)."""
    if H.camera is None:
        return math.nan
    errors = []
    for recorded, lattice in zip(H.period, H.camera.period_px, strict=True):
        errors.append(abs(recorded - max(1, round(recorded / lattice)) * lattice))
    return max(errors)


def _virtual_depths(H: PSFMatrix, planes: list[PlaneMeasures]) -> NDArray[np.float64]:
    """Return the virtual depth of each plane: from the shadow's size (v - 1) B / N, else from the spots' spacing."""
    found = np.array([p.spots.virtual_depth if p.spots is not None else math.nan for p in planes])
    if H.camera is not None:
        unit = H.camera.lattice.gap_um / H.camera.optics.working_f_number / H.camera.sensor.pixel_um
        beyond = np.array([1.0 if p.spots is None or p.spots.scale > 1 else -1.0 for p in planes])
        sized = 1 + beyond * shadow_sizes(planes, H.camera) / unit
        told = np.isfinite(found) & np.isfinite(sized)
        found = np.where(told, sized, found)
    return found


def _f_number(H: PSFMatrix, planes: list[PlaneMeasures]) -> FNumber | None:
    """Return the working f-number from the shadow's sizes over depth, or None where they do not tell."""
    if H.camera is None:
        return None
    sizes = shadow_sizes(planes, H.camera)
    chosen = np.flatnonzero(np.isfinite(sizes))
    try:
        shifts = [H.camera.image_shift_um(float(H.depths[z])) - H.camera.lattice.gap_um for z in chosen]
        return working_f_number(sizes[chosen], shifts, H.camera.sensor.pixel_um)
    except InputError:
        return None
