"""Subject of a measurement of accuracy: a scan plan or H, with samples of H that are fast to process."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, LfcalError, Work
from lfcal.camera import ScanPlan
from lfcal.psf import PSFMatrix
from lfcal.simulate import PlaneResponse, iter_simulate_psf, outlook_of, plan_effects, resolve_level, scene_for
from lfcal.simulate.accuracy import few_seconds, step_for

__all__ = ["Patterns", "Sample", "Subject", "reference_seconds"]

SAMPLE_BYTES = 48 << 20
"""Approximate size to which a sample of H over whole periods is cropped (bytes)."""

PATTERN_BYTES = 16 << 20
"""Largest size of the sample of single patterns with their whole cutout (bytes)."""

TOLERANCE, EFFECTS_TOLERANCE = 0.1, 0.02
"""Tolerances of the computation of samples and of their effects.

Samples need not be accurate to the last per cent, but rays instead of waves would leave their dark pixels empty.
"""

LONGEST_WAVES = 6.0
"""Predicted processor time of a sample (s) up to which it may be simulated by waves; above, by rays."""

REFERENCE = 20.0
"""Duration of the reference relative to its estimate for the planner, fitted to the presets."""


@dataclass(frozen=True, eq=False)
class Sample:
    """A sample of H: all positions of some of its planes, with the middle part of each cutout.

    Attributes
    ----------
    matrix
        H of the sample, in memory.
    scale
        Ratio of the number of entries of the whole H to that of the sample.
    notes
        Description of the sample, one line each.
    """

    matrix: PSFMatrix
    scale: float
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Patterns:
    """Some patterns of one plane, with their complete cutouts.

    Attributes
    ----------
    values
        Patterns at a grid of positions, ``(rows, columns, nt, ns)``.
    scale
        Ratio of the number of patterns of the whole H to the number of patterns in ``values``.
    notes
        Description of the patterns, one line each.
    """

    values: NDArray[np.float32]
    scale: float
    notes: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Subject:
    """Subject of a measurement: a scan plan, H, or H with its plan.

    Attributes
    ----------
    name
        Name for titles.
    plan
        The scan plan; None if unknown.
    matrix
        H. None: samples of H are simulated from the plan.
    no_plan
        Reason why there is no plan; empty if there is one.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    InputError
        If there is neither a plan nor an H.

    Examples
    --------
    >>> from lfcal.accuracy import Subject
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     subject = Subject.of_matrix(H, "H of the sample session")
    ...     print(subject.planned.period, subject.matrix.shape)
    (19, 33) (2, 19, 33, 55, 55)
    """

    name: str
    plan: ScanPlan | None = None
    matrix: PSFMatrix | None = None
    no_plan: str = ""
    workers: int | None = None
    _samples: dict[int, Sample] = field(default_factory=dict, repr=False)
    _patterns: list[Patterns] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        """Check that there is something to measure."""
        if self.plan is None and self.matrix is None:
            raise InputError.expected(
                "subject of the accuracy measurement", "a scan plan or H", "neither", "make a plan, or open an H"
            )

    @classmethod
    def of_matrix(cls, matrix: PSFMatrix, name: str, workers: int | None = None) -> Subject:
        """Return the subject for ``matrix``; if it is a transposed H, the H itself is measured.

        The plan is read from the provenance of H, or else derived from its camera. If neither is possible, the subject
        has no plan. ``name`` is used in titles, and ``workers`` is the number of threads (None: all processors).
        """
        H = matrix.T if matrix.is_transposed else matrix
        plan, reason = _plan_of(H)
        return cls(name, plan, H, reason, workers)

    @property
    def planned(self) -> ScanPlan:
        """The scan plan; raises `InputError` with the reason if there is none."""
        if self.plan is None:
            raise InputError.expected(
                "scan of the measurement",
                "a scan plan with its camera",
                self.no_plan or "none",
                "measure the accuracy of a scan plan or a camera instead of H",
            )
        return self.plan

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Shape ``(nz, ny, nx, nt, ns)`` of H, or of the H that the plan describes."""
        return self.planned.shape if self.matrix is None else self.matrix.shape

    @property
    def middle(self) -> int:
        """Index of the middle plane, ``nz // 2``."""
        return self.shape[0] // 2

    # -- samples ---------------------------------------------------------------------------------------
    def iter_sample(self, planes: int) -> Work[Sample]:
        """Return a sample of at most ``planes`` planes from the middle of H.

        Repeated calls with the same number return the same object. Raises `InputError` if the sample contains no light.
        """
        count = min(planes, self.shape[0])
        if count not in self._samples:
            made = self._read(count) if self.matrix is not None else self._simulated(count)
            sample = yield from made
            _check_light(np.asarray(sample.matrix), self.name)
            self._samples[count] = sample
        return self._samples[count]

    def iter_patterns(self) -> Work[Patterns]:
        """Return at most 8 x 8 patterns of the middle plane, spread over the period.

        Repeated calls return the same object. Raises `InputError` if the patterns contain no light.
        """
        if not self._patterns:
            yield Clock("patterns", 1).at(0)
            _, ny, nx, nt, ns = self.shape
            room = max(1, PATTERN_BYTES // (4 * nt * ns))
            side = max(1, math.isqrt(min(room, 64)))
            ys, xs = (np.unique(np.linspace(0, n - 1, min(side, n)).round().astype(int)) for n in (ny, nx))
            values, how = self._chosen(ys, xs)
            _check_light(values, f"plane {self.middle} of {self.name}")
            whole = self.shape[0] * ny * nx
            note = f"{ys.size * xs.size} patterns of plane {self.middle}, {nt} x {ns} px, {how}"
            self._patterns.append(Patterns(values, whole / (ys.size * xs.size), (note,)))
        return self._patterns[0]

    def _chosen(self, ys: NDArray[np.intp], xs: NDArray[np.intp]) -> tuple[NDArray[np.float32], str]:
        """Return the patterns at positions ys x xs of the middle plane, and how they were obtained."""
        z = self.middle
        if self.matrix is not None:
            H = self.matrix
            return np.array([[H[z, int(y), int(x)] for x in xs] for y in ys], np.float32), f"of {self.name}"
        plan = self.planned
        effects = plan_effects(plan, EFFECTS_TOLERANCE).at(plan.depths_um[z])
        response = PlaneResponse(plan, z, effects, tolerance=TOLERANCE)
        return response.rows(ys, xs, self.workers), f"simulated at level {response.level}"

    def _read(self, count: int) -> Work[Sample]:
        """Read planes around the middle one, cropped, row by row."""
        assert self.matrix is not None
        H, (nz, ny, nx, nt, ns) = self.matrix, self.matrix.shape
        first = (nz - count) // 2
        rows, columns = _window(self.shape, count)
        crop = (slice((nt - rows) // 2, (nt + rows) // 2), slice((ns - columns) // 2, (ns + columns) // 2))
        values = np.empty((count, ny, nx, rows, columns), np.float32)
        clock = Clock("sample of H", count * ny)
        for k in range(count):
            for y in range(ny):
                yield clock.at(k * ny + y)
                for x in range(nx):
                    values[k, y, x] = H[first + k, y, x, crop[0], crop[1]]
        depths = H.known_depths[first : first + count]
        made = PSFMatrix(values, depths=depths, camera=H.camera, anchor=H.anchor)
        return Sample(made, math.prod(H.shape) / values.size, (_sample_note(made, H.shape, f"of {self.name}"),))

    def _simulated(self, count: int) -> Work[Sample]:
        """Simulate planes around the middle one, cropped."""
        plan = self.planned
        first = (plan.shape[0] - count) // 2
        exposures = plan.exposures[first : first + count]
        part = replace(
            plan,
            depths_um=plan.depths_um[first : first + count],
            exposure_s=exposures,
            cutout=_window(plan.shape, count),
        )
        yield Clock("sample of H", 1).at(0)
        found = plan_effects(part, EFFECTS_TOLERANCE)
        waves = found.seconds <= LONGEST_WAVES
        scene, level = resolve_level(scene_for(part, 0, found.effects), "auto" if waves else "geometric")
        # the sampling expected to be sufficient, without a test in every plane
        step = step_for(scene, level, TOLERANCE) if level != "geometric" else None
        sampling, level = (None, level) if step is None else (step.sampling, step.level)
        made = yield from iter_simulate_psf(
            part, found, level, tolerance=TOLERANCE, sampling=sampling, workers=self.workers
        )
        how = f"simulated at level {level}" + ("" if waves else ", because wave optics takes longer")
        return Sample(made, math.prod(plan.shape) / math.prod(part.shape), (_sample_note(made, plan.shape, how),))


def reference_seconds(plan: ScanPlan, z: int, tolerance: float) -> float:
    """Return the estimated time (s) to simulate one position of plane ``z`` at the reference level.

    ``tolerance`` is the largest relative error of the simulation. The estimate may be wrong by up to a factor of 3.
    """
    return REFERENCE * few_seconds(outlook_of(plan, z), "reference", tolerance, 1)


def _check_light(values: NDArray[np.float32], what: str) -> None:
    if not values.max() > 0:
        raise InputError.expected(what, "light in the middle planes", "none", "check H, or its plan")


def _window(shape: tuple[int, int, int, int, int], planes: int) -> tuple[int, int]:
    """Return the odd rows and columns of a cutout with which ``planes`` planes of H do not exceed `SAMPLE_BYTES`."""
    _, ny, nx, nt, ns = shape
    side = math.isqrt(max(1, SAMPLE_BYTES // (4 * planes * ny * nx)))
    odd = max(3, side - 1 + side % 2)
    return min(nt, odd), min(ns, odd)


def _sample_note(made: PSFMatrix, whole: tuple[int, ...], how: str) -> str:
    nz, ny, nx, nt, ns = made.shape
    cropped = "" if (nt, ns) == whole[3:] else f" of the cutout's {whole[3]} x {whole[4]}"
    return f"{nz} of {whole[0]} planes, {nx} x {ny} positions, {nt} x {ns} px{cropped}, {how}"


def _plan_of(matrix: PSFMatrix) -> tuple[ScanPlan | None, str]:
    """Return the scan plan of H, and the reason if there is none."""
    reported = matrix.provenance.get("plan")
    if isinstance(reported, dict):
        try:
            plan = ScanPlan.from_dict(reported)
        except LfcalError:
            plan = None  # the entry may be invalid; the camera may still be usable
        if plan is not None and plan.shape == matrix.shape:
            return plan, ""
    if matrix.camera is None:
        return None, "H of an unknown camera"
    _, ny, nx, nt, ns = matrix.shape
    try:
        depths = tuple(float(z) for z in matrix.depths)
        resample = matrix.pixel_scale != (1.0, 1.0)
        return ScanPlan(matrix.camera, (ny, nx), (nt, ns), depths, matrix.anchor, resample=resample), ""
    except LfcalError as error:
        return None, f"a camera that does not fit H ({error})"
