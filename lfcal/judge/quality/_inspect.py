"""Inspect an H: read every plane once and evaluate every metric."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import RANK, Clock, InputError, Work, drained
from lfcal.camera import Camera, Microscope
from lfcal.judge.quality._expected import expected_sum
from lfcal.judge.quality._lattice import wave_vectors
from lfcal.judge.quality._periodicity import Periodicity, periodicity
from lfcal.judge.quality.across import MatrixMeasures
from lfcal.judge.quality.catalogue import METRICS
from lfcal.judge.quality.measure import (
    PASSES,
    PlaneContext,
    PlaneMeasures,
    has_elemental_images,
    iter_measure,
    lattice_camera,
)
from lfcal.judge.quality.metric import UNKNOWN, Metric, MetricSpec, Reading, judge
from lfcal.judge.quality.report import QualityReport
from lfcal.psf import PSFMatrix
from lfcal.psf.aperture import Aperture, FNumber, Iris, joint_iris, working_f_number

__all__ = ["Controls", "InspectedPlane", "inspect", "iter_inspect", "iter_inspect_plane", "judged", "straight"]


STEEP = 0.7
"""Sine of the half angle at which the rim of a defocused shadow has a third of the light of its middle (cos³)."""

SIZE_ERROR = (0.02, 0.5)
"""Smallest error of a shadow size from its second moment, as a fraction of the size and in pixels."""

Controls = Mapping[int, tuple[ArrayLike, ArrayLike]]
"""Control frames ``(n, nt, ns)`` and their positions ``(n, 2)`` by depth plane, as `periodicity` needs them."""


@dataclass(frozen=True, slots=True, eq=False)
class InspectedPlane:
    """Results of one plane: its measurements, without patterns, and the readings of metrics by key."""

    measures: PlaneMeasures
    readings: Mapping[str, Reading]


def iter_inspect(
    matrix: PSFMatrix | ArrayLike, *, controls: Controls | None = None, workers: int | None = None
) -> Work[QualityReport]:
    """Measure every metric of `lfcal.judge.quality.catalogue` on H.

    Each plane is read once, and then released; at most two planes are in memory at once.

    Parameters
    ----------
    matrix
        H; for a transposed view, its H is inspected. Values of other types are converted to float32.
    controls
        Mapping from the index of a depth plane to its control frames ``(n, nt, ns)`` and their positions ``(n, 2)``, as
        for `periodicity`. None: the periodicity over the field is not measured.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    InputError
        If H contains complex numbers.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.base import drain
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.judge import iter_inspect
    >>> drain(iter_inspect(PSFMatrix(np.zeros((2, 3, 3, 9, 9))))).verdict.partition(". ")[0]
    'This H should not be used as it is: dark planes'
    """
    start = time.perf_counter()
    H = straight(matrix)
    clock = Clock("inspection steps", PASSES * len(H))
    planes: list[InspectedPlane] = []
    yield clock.at(0)
    for z in range(len(H)):
        plane = yield from iter_inspect_plane(H, z, clock, before=z, controls=controls, workers=workers)
        planes.append(plane)
    return judged(H, planes, time.perf_counter() - start)


inspect = drained(
    iter_inspect,
    """
    Examples
    --------
    >>> from lfcal.judge import inspect
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     quality = inspect(H)
    >>> print(quality.merit, quality["missing"].text, quality.iris.blades, "blades")
    good 0 frames 7 blades
    """,
)


def iter_inspect_plane(
    H: PSFMatrix,
    z: int,
    clock: Clock,
    *,
    before: int = 0,
    controls: Controls | None = None,
    workers: int | None = None,
) -> Work[InspectedPlane]:
    """Read plane ``z`` of H (not transposed), measure it, and evaluate all metrics of single planes.

    ``clock`` counts `PASSES` per plane, and ``before`` planes have been inspected. Other parameters are as in
    `iter_inspect`.
    """
    # with a distorted lattice, use the lattice at the scanned cell
    described = lattice_camera(H)
    camera = None if described is None else described.local(H.anchor)
    waves = wave_vectors(camera, H.period, H.pixel_scale)
    patterns = np.ascontiguousarray(H.plane(z), np.float32)
    context = _context(H, z, waves, _tiling(H, patterns, (controls or {}).get(z)))
    plane = yield from iter_measure(patterns, context, clock, PASSES * before, workers)
    readings = {spec.key: _ask(spec, plane) for spec in METRICS if spec.of_plane is not None}
    return InspectedPlane(plane.released(), readings)


def judged(H: PSFMatrix, planes: Sequence[InspectedPlane], seconds: float) -> QualityReport:
    """Return the quality of H (not transposed) from all of its planes, in order; ``seconds`` is the duration."""
    readings: dict[str, list[Reading]] = {spec.key: [] for spec in METRICS}
    measures = MatrixMeasures.of(H, [plane.measures for plane in planes])
    for spec in METRICS:
        if spec.of_plane is not None:
            readings[spec.key].extend(plane.readings[spec.key] for plane in planes)
        if spec.of_matrix is not None:
            readings[spec.key].extend(spec.of_matrix(measures))
    shape = (H.shape[0], H.shape[1], H.shape[2])
    metrics = sorted((judge(spec, readings[spec.key], shape) for spec in METRICS), key=_rank)
    return _report(measures, tuple(metrics), seconds)


def straight(matrix: PSFMatrix | ArrayLike) -> PSFMatrix:
    """Return the H to inspect; raises `InputError` if it contains complex numbers."""
    H = matrix if isinstance(matrix, PSFMatrix) else PSFMatrix(matrix)
    if H.dtype.kind == "c":
        raise InputError.expected("PSF matrix", "real numbers", "complex ones", "give intensities")
    return H.T if H.is_transposed else H


def _context(H: PSFMatrix, z: int, waves: NDArray[np.float64], tiling: Periodicity | None) -> PlaneContext:
    total = H.depth_sum(z)
    shown = np.where(np.isfinite(total), total, 0.0)
    return PlaneContext(H, z, shown, H.aperture(z), waves, tiling, _expected(H, z))


def _expected(H: PSFMatrix, z: int) -> NDArray[np.float64] | None:
    camera = lattice_camera(H)
    if camera is None:
        return None
    try:
        return expected_sum(camera, float(H.depths[z]), H.cutout, H.pixel_scale)
    except InputError:  # a depth that this camera cannot image: plane numbers, or depths of another camera
        return None


def _tiling(
    H: PSFMatrix, patterns: NDArray[np.float32], controls: tuple[ArrayLike, ArrayLike] | None
) -> Periodicity | None:
    if controls is None or not len(np.asarray(controls[1])):
        return None
    return periodicity(*controls, patterns, anchor=H.anchor)


def _ask(spec: MetricSpec, plane: PlaneMeasures) -> Reading:
    """Return the value of a metric for a plane."""
    if spec.of_plane is None or (spec.needs_light and not plane.lit):
        return UNKNOWN
    if spec.needs_centre and has_elemental_images(plane.about.matrix):
        return UNKNOWN
    return spec.of_plane(plane)


def _rank(metric: Metric) -> tuple[int, float]:
    return RANK[metric.merit], -metric.cost if metric.cost > 0 else 0.0


def _report(measures: MatrixMeasures, metrics: tuple[Metric, ...], seconds: float) -> QualityReport:
    H, planes = measures.matrix, measures.planes
    apertures = tuple(_reported(p, size) for p, size in zip(planes, measures.shadows_px, strict=True))
    return QualityReport(
        shape=H.shape,
        depths=H.known_depths,
        metrics=metrics,
        apertures=apertures,
        virtual_depths=_virtual_depths(measures),
        iris=_iris(H, apertures),
        f_number=_f_number(measures),
        noise=np.array([p.dark.noise for p in planes]),
        peak=np.array([p.table.peak for p in planes]),
        energy=np.array([p.energy for p in planes]),
        tilings=tuple(p.about.tiling for p in planes),
        seconds=seconds,
    )


def _reported(plane: PlaneMeasures, shadow_px: float) -> Aperture:
    """Return the aperture of a plane, which is rejected if its sum shows the lenslets instead of the shadow."""
    aperture, edges = plane.about.aperture, plane.edges
    known = lattice_camera(plane.about.matrix) is not None and math.isfinite(plane.spread) and plane.lit
    if not known or math.isfinite(shadow_px) or aperture.refusal or edges.cut_off:
        return aperture
    return aperture.refused("in focus")


def _iris(H: PSFMatrix, apertures: tuple[Aperture, ...]) -> Iris | None:
    return joint_iris(apertures, [_inverted(H, z) for z in range(len(H))])


def _inverted(H: PSFMatrix, z: int) -> bool | None:
    """Return whether the image is in front of the sensor and shows the iris inverted; None if unknown."""
    camera = lattice_camera(H)
    if camera is None:
        return None
    try:
        return camera.image_shift_um(float(H.depths[z])) < camera.lattice.gap_um
    except InputError:  # a depth that this camera cannot image: plane numbers, or depths of another camera
        return None


def _virtual_depths(measures: MatrixMeasures) -> NDArray[np.float64]:
    """Return the virtual depth of each plane from the shadow size (v - 1) B / N, or else from the spot spacing."""
    camera, spots = lattice_camera(measures.matrix), [p.positions.spots for p in measures.planes]
    found = np.array([math.nan if s is None else s.virtual_depth for s in spots])
    if camera is None:
        return found
    unit = camera.lattice.gap_um / camera.optics.working_f_number / camera.sensor.pixel_um
    unit *= math.sqrt(math.prod(measures.matrix.pixel_scale))
    beyond = np.array([1.0 if s is None or s.scale > 1 else -1.0 for s in spots])
    sized = 1 + beyond * measures.shadows_px / unit
    return np.where(np.isfinite(found) & np.isfinite(sized), sized, found)


def _steep(camera: Camera) -> bool:
    """Return whether the shadow of a defocused point has too little light at its rim for a well-defined size."""
    optics = camera.optics
    return isinstance(optics, Microscope) and optics.numerical_aperture > STEEP * optics.medium_index


def _f_number(measures: MatrixMeasures) -> FNumber | None:
    """Return the working f-number from the shadow sizes over depth, or None if it cannot be measured."""
    H, sizes = measures.matrix, measures.shadows_px
    camera = lattice_camera(H)
    if camera is None or _steep(camera):
        return None
    chosen = np.flatnonzero(np.isfinite(sizes))
    pixel = camera.sensor.pixel_um / math.sqrt(math.prod(H.pixel_scale))
    try:
        shifts = [camera.image_shift_um(float(H.depths[z])) - camera.lattice.gap_um for z in chosen]
        errors = np.hypot(SIZE_ERROR[0] * sizes[chosen], SIZE_ERROR[1])
        return working_f_number(sizes[chosen], shifts, pixel, errors)
    except InputError:
        return None
