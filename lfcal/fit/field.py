"""Retrieve one camera, with its wavefront over the field, from patterns of several regions of the field."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, Work, drained
from lfcal.camera import Camera, NoLatticeError, ScanPlan
from lfcal.fit.fit import check_stage, groups_of, iter_retrieved, iter_summarised, problem_of
from lfcal.fit.measured import Measured
from lfcal.fit.parameters import ScanScales, Vector, check_groups, field_of
from lfcal.fit.problem import Problem
from lfcal.fit.questions import as_described, check_described, check_light
from lfcal.fit.result import Fit
from lfcal.fit.setup import Setup, starting_effects
from lfcal.simulate.effects import Effect, FieldAberrations, Zernike

__all__ = [
    "OVER_THE_FIELD",
    "FieldFit",
    "FieldRegion",
    "Regional",
    "Term",
    "fit_field",
    "iter_fit_field",
    "regional_of",
]

APART = 2.0
"""Smallest distance between the middles of two regions (cutouts); closer ones show the same part of the field."""


@dataclass(frozen=True, slots=True)
class FieldRegion:
    """A region of the field that was scanned.

    Attributes
    ----------
    name
        Name of the region.
    period, anchor
        Number of positions (rows, columns) of the scan of the region, and sensor position of its first image, as in
        `ScanPlan`.
    """

    name: str
    period: tuple[int, int]
    anchor: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Regional(Measured):
    """Measured patterns of several regions; ``plan`` is that of the first region.

    Attributes
    ----------
    regions
        The regions, in the order of their indices.
    region
        Index of the region of each pattern ``(n,)``.
    """

    regions: tuple[FieldRegion, ...] = ()
    region: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, np.intp))

    def __post_init__(self) -> None:
        """Check that each pattern has one region, and all that `Measured` checks."""
        if self.region.shape != (len(self.index),):
            wanted = f"shape {(len(self.index),)}"
            raise InputError.expected(
                "region of each pattern", wanted, f"shape {self.region.shape}", "give one region for each pattern"
            )
        Measured.__post_init__(self)

    @property
    def level(self) -> NDArray[np.intp]:
        """Index ``(n,)`` of the gain and background of each pattern; every plane of every region has its own."""
        found: NDArray[np.intp] = self.region * self.plan.shape[0] + self.index[:, 0]
        return found

    @property
    def levels(self) -> int:
        """Number of separate gains and backgrounds."""
        return len(self.regions) * self.plan.shape[0]

    @property
    def plans(self) -> tuple[ScanPlan, ...]:
        """The plan of each region."""
        return tuple(replace(self.plan, period=one.period, anchor=one.anchor) for one in self.regions)

    def parts(self) -> Iterator[tuple[ScanPlan, NDArray[np.intp], int]]:
        """Yield the plan, the indices of the patterns, and the index of each region that has patterns."""
        plans = self.plans
        for k in np.unique(self.region).tolist():
            yield plans[k], np.flatnonzero(self.region == k), k

    def of(self, keep: NDArray[np.bool_]) -> Regional:
        """Return the patterns that the mask ``keep`` ``(n,)`` selects."""
        return replace(self, **self._some(keep), region=self.region[keep])

    def of_region(self, k: int) -> Measured:
        """Return the patterns of the region with index ``k``, as if from a separate scan."""
        own = self.region == k
        return Measured(self.plans[k], **self._some(own))


def regional_of(patterns: Mapping[str, Measured], camera: Camera | None = None) -> Regional:
    """Return the patterns of several regions in one object.

    Parameters
    ----------
    patterns
        Patterns of each region, by name.
    camera
        Description of the camera from which a fit starts. None: that of the first region.

    Raises
    ------
    InputError
        If there are fewer than two regions, or they are closer to each other than two cutouts. Also if they differ in
        depths, cutout, shape of the sensor, pixel size or pitch of the lenslets.
    """
    parts = list(patterns.values())
    if len(parts) < 2:
        raise InputError.expected("regions of the field", "at least two", len(parts), "give the H of each region")
    first = parts[0].plan if camera is None else replace(parts[0].plan, camera=camera)
    regions: list[FieldRegion] = []
    for name, own in patterns.items():
        _check_alike(name, own.plan, first)
        middle = np.array(own.plan.anchor) + np.array(own.plan.period) / 2
        for other in regions:
            apart = float(np.hypot(*(middle - np.array(other.anchor) - np.array(other.period) / 2)))
            if apart < APART * max(first.cutout):
                wanted = f"a distance of at least {APART * max(first.cutout):.0f} px from region {other.name!r}"
                raise InputError.expected(f"region {name!r}", wanted, f"{apart:.0f} px", "scan a region farther away")
        regions.append(FieldRegion(name, own.plan.period, own.plan.anchor))
    joined: dict[str, Any] = {
        key: np.concatenate([getattr(own, key) for own in parts])
        for key in ("index", "patterns", "noise", "places_px", "valid", "held_out")
    }
    number = np.concatenate([np.full(len(own), k) for k, own in enumerate(parts)])
    return Regional(first, **joined, regions=tuple(regions), region=number)


def _check_alike(name: str, plan: ScanPlan, first: ScanPlan) -> None:
    """Raise `InputError` if the scan of a region differs from the first in camera, depths or cutout."""
    have: dict[str, tuple[Any, Any]] = {
        "depths (µm)": (plan.depths_um, first.depths_um),
        "pixels of a pattern": (plan.cutout, first.cutout),
        "pixels of the sensor": (plan.camera.sensor.shape, first.camera.sensor.shape),
        "pixel (µm)": (plan.camera.sensor.pixel_um, first.camera.sensor.pixel_um),
        "pitch of the lenslets (µm)": (plan.camera.lattice.pitch_um, first.camera.lattice.pitch_um),
    }
    for what, (own, wanted) in have.items():
        if np.shape(own) != np.shape(wanted) or not np.allclose(own, wanted, rtol=1e-6, atol=1e-6):
            raise InputError.expected(
                f"region {name!r}, {what}", wanted, own, "use regions with the same camera and depths"
            )


# -- the fit -----------------------------------------------------------------------------------------------------------
OVER_THE_FIELD = ("pitch", "region_places")
"""Groups always fitted to several regions; over the field, small pitch errors displace lenslets by pixels."""

F8 = NDArray[np.float64]


ALONE = ("geometry", "focal_lengths", "iris")
"""Groups that are first fitted in each region separately, as a start."""


@dataclass(frozen=True, slots=True)
class Term:
    """Zernike term of the wavefront at a position in the field.

    ``n`` is its radial and ``m`` its azimuthal order. ``waves`` is the coefficient of a term whose radial polynomial is
    1 at the rim of the pupil, and ``sigma`` its standard deviation (both in waves).
    """

    n: int
    m: int
    waves: float
    sigma: float


@dataclass(frozen=True, eq=False)
class FieldFit:
    """One camera fitted to several regions of the field.

    Attributes
    ----------
    fits
        Result for each region by name. Camera, effects, parameters and chi² are shared; patterns, light and positions
        of sources are those of the region.
    """

    fits: Mapping[str, Fit]

    @property
    def first(self) -> Fit:
        """Fit of the first region."""
        return next(iter(self.fits.values()))

    @property
    def camera(self) -> Camera:
        """The fitted camera."""
        return self.first.camera

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The fitted effects, including the variation of the wavefront over the field, if it was fitted."""
        return self.first.effects

    def setup_at(self, plan: ScanPlan) -> Setup:
        """Return the setup for a scan elsewhere in the field.

        Sources are at their planned positions. Depth errors are interpolated from the planes of the first region.
        """
        first = self.first.setup
        depths = np.interp(plan.depths_um, *_rising(self.first.planned.depths_um, first.depth_errors_um))
        return replace(first, depth_errors_um=tuple(map(float, depths)), aside_px=(0.0, 0.0), stage_scale=0.0)

    def fit_at(self, plan: ScanPlan) -> Fit:
        """Return the fit for a scan elsewhere in the field, without residuals and outliers.

        Its `Fit.model` is H in that part of the field, with the mean light of all regions. The camera of ``plan`` is
        not used.
        """
        gains = np.mean([fit.levels.gains for fit in self.fits.values()], axis=0)
        light = np.interp(plan.depths_um, *_rising(self.first.planned.depths_um, gains))
        levels = replace(self.first.levels, gains=light, backgrounds=np.zeros(len(light)), lamps=np.zeros(0))
        planned = replace(plan, camera=self.first.planned.camera)
        setup = self.setup_at(plan)
        return replace(self.first, setup=setup, planned=planned, levels=levels, residuals={}, outliers=())

    def wavefront_at(self, field_um: tuple[float, float]) -> tuple[Term, ...]:
        """Return the Zernike terms of the wavefront at the sensor point ``field_um``, (x, y) from the axis (µm)."""
        x, y = field_um
        names = list(self.first.parameters)
        sigmas = np.array([one.sigma for one in self.first.parameters.values()])
        spread = np.outer(sigmas, sigmas) * self.first.correlations
        own = next((e for e in self.effects if isinstance(e, FieldAberrations)), None)
        axis = next((e for e in self.effects if isinstance(e, Zernike)), Zernike())
        total: dict[tuple[int, int], float] = {}
        for n, m, waves in (*axis.terms, *(own.terms_at((y, x)) if own is not None else ())):
            total[n, m] = total.get((n, m), 0.0) + waves
        found = []
        for (n, m), waves in sorted(total.items()):
            by = np.array([_rate(name, n, m, own, (y, x)) for name in names])
            found.append(Term(n, m, waves, float(np.sqrt(max(0.0, by @ spread @ by)))))
        return tuple(found)


def _rate(name: str, n: int, m: int, own: FieldAberrations | None, field_um: tuple[float, float]) -> float:
    """Return the derivative of a term at a position with respect to a parameter; terms are linear in all parameters."""
    if name == (f"zernike_{n}_{m}" if m >= 0 else f"zernike_{n}_m{-m}"):
        return 1.0
    key = name.removeprefix("field_")
    if own is None or key == name or key not in ("coma", "astigmatism", "astigmatism_y", "astigmatism_x", "spherical"):
        return 0.0
    none = {"coma": 0.0, "astigmatism": 0.0, "astigmatism_y": 0.0, "astigmatism_x": 0.0, "spherical": 0.0}
    alone = FieldAberrations(**(none | {key: 1.0}), radius_um=own.radius_um)
    return next((waves for a, b, waves in alone.terms_at(field_um) if (a, b) == (n, m)), 0.0)


def _rising(depths: Sequence[float], values: ArrayLike) -> tuple[F8, F8]:
    order = np.argsort(depths)
    return np.asarray(depths, np.float64)[order], np.asarray(values, np.float64)[order]


def iter_fit_field(
    patterns: Mapping[str, Measured],
    camera: Camera | None = None,
    unknowns: str | Sequence[str] = "auto",
    *,
    effects: Sequence[Effect] | None = None,
    stage: str | float = "auto",
    workers: int | None = None,
) -> Work[FieldFit]:
    """Fit the single camera that best explains the patterns of several regions of the field.

    The parameters of the camera are the same in all regions. The groups ``field_wavefront`` and ``field_curvature``
    describe how the wavefront and the image distance vary between regions. Light, background and positions of the
    sources are separate for each region.

    Parameters
    ----------
    patterns
        Patterns of each region, by name; the anchor of their plan states the position of the region on the sensor.
    camera
        Camera from which the fit starts. None: that of the first region.
    unknowns, effects, stage, workers
        As in `fit_camera`; the pitch of the array and the positions of the sources are always fitted.

    Yields
    ------
    Progress
        As in `iter_fit_camera`. Closing the generator stops the fit.

    Raises
    ------
    InputError
        If the regions belong to different cameras, or the camera has no periodic array. Also if no camera of this kind
        explains the patterns, or there are too few patterns.
    """
    described = camera or next(iter(patterns.values())).plan.camera
    if not described.has_lattice:
        # its pattern is the same everywhere in the field
        raise NoLatticeError.of("fit of several regions of the field")
    measured = regional_of(patterns, camera)
    check_stage(stage)
    core, candidates = groups_of(unknowns)
    core = tuple(dict.fromkeys((*core, *OVER_THE_FIELD)))
    candidates = tuple(name for name in candidates if name not in core)
    setup = Setup(
        measured.plan.camera,
        starting_effects(measured.plan) if effects is None else tuple(effects),
        (0.0,) * measured.plan.shape[0],
    )
    check_groups(setup, measured.plan, core, ScanScales.over(measured.plans))
    for k in range(len(measured.regions)):
        check_light(measured.of_region(k))
    check_described(measured)
    problem = problem_of(measured, setup, (*core, *candidates), workers)
    start = yield from _nearby(measured, problem, setup, [name for name in core if name in ALONE], workers)
    finished = yield from iter_retrieved(problem, core, candidates, stage=stage, start=start)
    problem = finished[0]
    found = yield from iter_summarised(*finished, candidates)
    names = [measured.regions[k].name for _, _, k in problem.measured.parts()]
    return FieldFit(dict(zip(names, found, strict=True)))


fit_field = drained(iter_fit_field)


# -- start of a fit of all regions ---------------------------------------------------------------------------


def _nearby(measured: Regional, problem: Problem, setup: Setup, groups: Sequence[str], workers: int | None) -> Work[F8]:
    """Return a starting vector from which the fit of all regions converges.

    A small rotation of the array, or an error of its pitch, displaces it by pixels over the field, more than a fit can
    recover. Each region is therefore fitted separately, the nearest to the first one first, starting from the array in
    the previous ones. The start is the rotation, scale and displacement that explain the position of the array in all
    regions.
    """
    if "geometry" not in groups:
        return np.zeros(len(problem.vector))
    fields = np.array([field_of(plan) for plan in measured.plans])
    order = np.argsort(np.hypot(*(fields - fields[0]).T), kind="stable")
    seen: list[_Laid] = []
    found: list[dict[str, float]] = []
    for k in order.tolist():
        own = measured.of_region(k)
        alone = Problem(own, Vector(setup, ScanScales.of(own.plan), groups), workers)
        start = alone.vector.at(_changes(seen, fields[k], setup)) if seen else None
        note = f"region {measured.regions[k].name}"
        point = yield from as_described(alone, groups, start=start, note=note)
        changes = alone.vector.changes(point.u)
        found.append(changes)
        aside = np.array([changes["offset_x_um"], changes["offset_y_um"]])
        seen.append(_Laid(fields[k], aside, changes["rotation_rad"]))
    mean = {name: float(np.mean([one[name] for one in found])) for name in found[0]}
    return problem.vector.at(mean | _changes(seen, np.array(problem.vector.frame.middle_um), setup))


@dataclass(frozen=True, eq=False)
class _Laid:
    """Displacement (µm) and rotation of the array in a region at a position (x, y), relative to the description."""

    place: F8
    aside: F8
    turn: float


TURN_RAD, GROWTH, ASIDE_UM = 5e-4, 2e-3, 1.0
"""Uncertainties: rotation (rad) from one region, pitch (relative), and displacement (µm) from one region."""


def _changes(seen: Sequence[_Laid], place: F8, setup: Setup) -> dict[str, float]:
    """Return the changes of offset, rotation and pitch at ``place`` (x, y), by name, from regions already fitted."""
    rows, wanted = [[0.0, 0.0, 0.0, 1 / GROWTH]], [0.0]
    for one in seen:
        x, y = one.place / ASIDE_UM
        rows += [[1 / ASIDE_UM, 0.0, -y, x], [0.0, 1 / ASIDE_UM, x, y], [0.0, 0.0, 1 / TURN_RAD, 0.0]]
        wanted += [*(one.aside / ASIDE_UM), one.turn / TURN_RAD]
    scale = np.array([1.0, 1.0, TURN_RAD, GROWTH])
    right, down, turn, grow = np.linalg.lstsq(np.array(rows) * scale, np.array(wanted), rcond=None)[0] * scale
    x, y = place
    return {
        "offset_x_um": float(right - turn * y + grow * x),
        "offset_y_um": float(down + turn * x + grow * y),
        "rotation_rad": float(turn),
        "pitch_um": float(grow * setup.camera.lattice.pitch_um),
    }
