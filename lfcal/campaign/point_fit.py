"""Fit one camera to the points of a target, each at its actual position on the sensor and in the field.

A part of the field is computed with the optics of its middle. Derivatives with respect to all unknowns then need only
one set of tables per part. The remaining difference of a point's pattern hardly changes with the unknowns. It is
therefore computed occasionally and constant in between (`Measured.extra_light`); its last values are those of the
fitted camera.

The diameter of the holes is an unknown shared by all points. The fit is written as a camera with its effects, H of
regions of the field, and the numbers.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, drained, for_each_chunk, one_blas_thread
from lfcal.camera import RegionPlan, ScanPlan
from lfcal.campaign.points import Points, measured_points
from lfcal.fit import (
    CAMERA,
    EFFECTS,
    MODEL,
    NUMBERS,
    Columns,
    FieldFit,
    Fineness,
    Finished,
    Fit,
    GroupSelection,
    Local,
    Measured,
    Problem,
    Regional,
    RegionPlace,
    Setup,
    check_described,
    check_light,
    check_stage,
    chi_square,
    covariance,
    descend,
    fit_dict,
    gain_of,
    groups_of,
    iter_retrieved,
    iter_summarised,
    iter_write_model,
    nuisance_steps,
    predict,
    problem_of,
    starting_effects,
    write_found,
)
from lfcal.frames import FrameSource
from lfcal.simulate import Sampling
from lfcal.simulate.effects import Effect, FiniteSource

__all__ = [
    "HOLE",
    "MOST",
    "PointOptics",
    "fit_points",
    "hole_is_determined",
    "hole_words",
    "iter_fit_points",
    "iter_hole_is_needed",
    "iter_with_point_light",
    "iter_write_points",
    "point_outputs",
    "without_hole",
]

F8 = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PointOptics:
    """Optics of individual points: cutouts, depths, and the size of the holes.

    Attributes
    ----------
    middles
        Sensor pixel (row, column) at the middle of each cutout, ``(n, 2)``.
    farther_um
        Distance of each hole beyond its depth plane, away from the camera, ``(n,)`` (µm).
    hole_um
        Diameter of the holes (µm) according to the target's description; used unless it is an unknown.
    parts_um
        Distance of the target beyond the depth plane at the centre of each part of the field, ``(parts,)`` (µm).
    """

    middles: NDArray[np.intp]
    farther_um: F8
    hole_um: float
    parts_um: F8

    @classmethod
    def of(cls, points: Points, measured: Regional) -> PointOptics:
        """Return the optics of the points in ``measured``, in the same order; all of them must be in ``points``."""
        scan, middles = points.plan.scan, np.zeros((len(measured), 2), np.intp)
        for plan, part, _ in measured.parts():
            middles[part] = np.floor(np.array(plan.anchor) + 0.5).astype(np.intp) + measured.index[part, 1:]
        depths = np.array(scan.depths_um)
        farther = points.away_um - depths[points.z]
        known = {
            (z, *at): away
            for z, at, away in zip(points.z.tolist(), points.middles.tolist(), farther.tolist(), strict=True)
        }
        found = np.array([known[z, *at] for z, at in zip(measured.index[:, 0].tolist(), middles.tolist(), strict=True)])
        return cls(middles, found, points.plan.target.hole_um, _plane(points.pixels, farther, _middles(measured)))

    def beyond(self, measured: Regional, setup: Setup) -> F8:
        """Return the additional distances ``(n,)`` (µm) of the points from the camera, in excess of `farther_um`.

        They are values of a plane. It is fitted to the distances of the parts of the field in ``setup``, minus
        `parts_um`. The ``setup`` may tilt the target relative to its pose. ``measured`` defines the parts.
        """
        parts = np.array([place.farther_um for place in setup.regions]) - self.parts_um
        return _plane(_middles(measured), parts, self.middles.astype(np.float64))

    @property
    def regions(self) -> tuple[RegionPlace, ...]:
        """The distances `parts_um` as the regions of a `Setup`."""
        return tuple(RegionPlace(farther_um=float(farther)) for farther in self.parts_um)


def _middles(measured: Regional) -> F8:
    """Return the middle pixel of each part of the field ``(parts, 2)``."""
    return np.array([np.array(plan.anchor) + (np.array(plan.period) - 1) / 2 for plan in measured.plans])


def _plane(pixels: F8, values: F8, at: F8) -> F8:
    """Return the values ``(m,)`` at pixels ``at`` ``(m, 2)`` of the plane fitted to ``values`` at ``pixels``."""
    found = np.linalg.lstsq(np.c_[pixels, np.ones(len(pixels))], values, rcond=None)[0]
    there: F8 = np.c_[at, np.ones(len(at))] @ found
    return there


def iter_with_point_light(
    problem: Problem, optics: PointOptics, u: F8, offsets_px: F8, sampling: Sampling, note: str
) -> Work[Problem]:
    """Return the problem with the light of each point computed for the unknowns ``u``; progress counts points.

    Parameters
    ----------
    problem
        Fit problem whose patterns are those of points in parts of the field.
    optics
        Optics of the individual points.
    u, offsets_px
        Vector of the unknowns, and the displacement (dy, dx) of each point on the sensor, ``(n, 2)`` (px).
    sampling
        Sampling of the computation.
    note
        Text that is shown with the progress.
    """
    measured = problem.measured
    assert isinstance(measured, Regional)  # points are those of parts of the field
    plain = replace(measured, extra_light=None)
    setup, offsets = problem.vector.setup_at(u), offsets_px + measured.places_px
    holes = _Holes.of(setup, optics)
    light = np.zeros(measured.patterns.shape, np.float32)
    blur = np.zeros_like(light) if holes.fitted else None
    farther: F8 = optics.farther_um + optics.beyond(measured, setup)
    places = [(plan, setup.of_region(k), setup.regions[k].farther_um, own_of) for plan, own_of, k in plain.parts()]
    tasks = [(plan, at, away, j) for plan, at, away, which in places for j in which.tolist()]
    clock = Clock(note, len(tasks))
    yield clock.at(0)

    def some(start: int, stop: int) -> None:
        for plan, at, away, j in tasks[start:stop]:
            place = np.array(plan.anchor) + measured.index[j, 1:]
            alone = replace(plan, period=(1, 1), anchor=(float(place[0]), float(place[1])))
            index = np.array([[measured.index[j, 0], 0, 0]])
            mine = _at_depth(at, float(farther[j]) - away)
            light[j] = predict(holes.put(mine), alone, index, offsets[j : j + 1], sampling)[0]
            if blur is not None:
                other = predict(holes.put(mine, holes.other_um), alone, index, offsets[j : j + 1], sampling)[0]
                blur[j] = (light[j] - other) / np.float32(holes.um**2 - holes.other_um**2)

    with one_blas_thread():
        for first in range(0, len(tasks), 4 * problem.workers):
            last = min(len(tasks), first + 4 * problem.workers)
            for_each_chunk(lambda a, b, at=first: some(at + a, at + b), last - first, problem.workers)  # type: ignore[misc]
            yield clock.at(last)
    base = problem.with_measured(plain).model(u, offsets_px, sampling).reshape(light.shape)
    return problem.with_measured(replace(measured, extra_light=light - base, blur=blur, blurred_um=holes.um))


def _at_depth(setup: Setup, farther_um: float) -> Setup:
    """Return the setup of a part of the field for a hole that is farther away by ``farther_um``."""
    return replace(setup, depth_errors_um=tuple(error + farther_um for error in setup.depth_errors_um))


@dataclass(frozen=True, slots=True)
class _Holes:
    """Diameter of the holes, a second diameter that provides the derivative, and whether the diameter is an unknown.

    To good approximation, light is linear in the square of the diameter, so one further diameter is sufficient.
    """

    um: float
    other_um: float
    fitted: bool

    @classmethod
    def of(cls, setup: Setup, optics: PointOptics) -> _Holes:
        if setup.hole_um is None:
            return cls(optics.hole_um, 0.0, fitted=False)
        least = setup.camera.step_um(0.0)
        # to a point source, which needs one run and hardly differs from a small hole
        return cls(setup.hole_um, 0.0 if setup.hole_um > 0.5 * least else least, fitted=True)

    def put(self, setup: Setup, um: float | None = None) -> Setup:
        """Return a setup with holes of diameter ``um`` (µm). None: the diameter `um` of this object."""
        size = self.um if um is None else um
        return setup.with_effect(FiniteSource(size)) if size > 0 else setup


HOLE = "hole"
"""Name of the group of unknowns for the diameter of the holes (`lfcal.fit.groups.light.Holes`)."""

NEEDED_SHARE = 0.1
"""Fraction of the residual beyond noise in held-out patterns that another size must explain."""

VAGUE = 0.5
"""Standard deviation of the squared diameter, relative to the described one, above which it is undetermined."""

SAME = 0.02
"""Relative change of the squared diameter below which the light of the holes is not computed again."""

SHOWN = 3.0
"""Standard deviations by which a squared diameter must differ from the described one to count as determined."""


def iter_hole_is_needed(finished: Finished) -> Work[bool]:
    """Return whether the size of the holes must be an unknown of the fit; progress counts derivatives.

    It must be one if chi² shows that the model is incomplete and another size lowers the residual of held-out patterns
    by more than a threshold.
    """
    problem, point, groups, columns, _ = finished
    hole = problem.vector.of_groups([HOLE]).tolist()
    if not hole or chi_square(point, problem.fitted, len(problem.vector.of_groups(groups))).complete:
        return False
    found = yield from problem.columns(point, hole, "size of the holes", displaced=False)
    shared = columns.shared.copy()
    shared[hole] = found.shared[hole]
    selection = GroupSelection(problem, point, Columns(shared, columns.displacements))
    gain, enough = gain_of(selection, groups, (HOLE,))
    beyond = max(0.0, selection.left(groups) - selection.samples)
    return gain > max(enough, NEEDED_SHARE * beyond)


def hole_is_determined(finished: Finished) -> bool:
    """Return whether the points determine the fitted size of the holes.

    A hole much smaller than the finest detail of a pattern causes no measurable blur.
    """
    problem, point, groups, columns, _ = finished
    which = problem.vector.of_groups(groups)
    (k,) = problem.vector.of_groups([HOLE]).tolist()
    spread, _ = covariance(problem, point, columns, which)
    chi2 = chi_square(point, problem.fitted, len(which))
    grown = math.sqrt(max(1.0, chi2.lit)) if not chi2.complete else 1.0
    at, one = int(np.flatnonzero(which == k)[0]), problem.vector.unknowns[k]
    sigma = grown * math.sqrt(max(0.0, float(spread[at, at]))) * one.scale**2
    moved = abs(one.value(float(point.u[k])) ** 2 - one.start**2)
    return bool(sigma < VAGUE * one.start**2 or moved > SHOWN * sigma)


def moved_far(finished: Finished) -> bool:
    """Return whether the fitted hole area differs by over 2 % from the area for which the light was computed."""
    problem, point, groups, _, _ = finished
    if HOLE not in groups:
        return False
    found = problem.vector.setup_at(point.u).hole_um or 0.0
    return bool(abs(found**2 - problem.measured.blurred_um**2) > SAME * found**2)


def without_hole(finished: Finished) -> Finished:
    """Return the fit with the size of the holes fixed at the described one, and all other unknowns unchanged."""
    problem, point, groups, columns, outliers = finished
    u = point.u.copy()
    u[problem.vector.of_groups([HOLE])] = 0.0
    point = problem.point(u, point.local, point.sampling, lamps=point.levels.lamps, doubtful=point.doubtful)
    return problem, point, tuple(name for name in groups if name != HOLE), columns, outliers


def hole_words(fit: Fit, *, asked: bool = True) -> str:
    """Return one line on the size of the holes found by a fit of points.

    The text is empty if the size was not fitted, or differs from the described size by at most one standard deviation.
    If the size was requested but is undetermined, the text states this.

    Parameters
    ----------
    fit
        Fit of points.
    asked
        Whether the size was requested by name. If not, an undetermined size is not mentioned.
    """
    if asked and HOLE in fit.unhelpful:
        stays = _described(fit.setup.hole_um or 0.0)
        return (
            "size of the holes: undetermined, because their images are too small; fixed at the described "
            f"size of {stays}"
        )
    found = fit.parameters.get("hole_um")
    if found is None or abs(found.value - found.start) <= found.sigma:
        return ""
    start = _described(found.start)
    return f"size of the holes: {found.value:.4g} ± {found.sigma:.2g} µm measured, {start} described"


def _described(hole_um: float) -> str:
    return f"{hole_um:.4g} µm" if hole_um else "points"


def with_undetermined_hole(fit: Fit) -> Fit:
    """Return the fit with the size of the holes listed among the requested unknowns that did not help."""
    return replace(fit, unhelpful=(*fit.unhelpful, HOLE))


MOST = 72
"""Number of fitted points: eight in each of nine parts of the field; the remaining error is that of the simulation."""

OTHERS = ("region_places", "region_depths", "stage_scale", "stage_zero", "source")
"""Groups fitted only to scans: points of a target share one lattice and one plane, and their sources are holes."""

ALWAYS_FITTED = ("pitch", "plane_tilt")
"""Groups that are always fitted, because small errors are visible over the field."""

DEVIATION_PX, BRIGHTNESS = 0.5, 0.05
"""Prior standard deviations: offset of a chief ray from the centroid of the light (pixels), relative brightness."""

ROUNDS = 4
"""Largest number of rounds of the fit that locates the points."""

RESIZED = 2
"""Largest number of times that the light of holes is computed again after a change of their size."""


def iter_fit_points(
    source: FrameSource,
    points: Points,
    unknowns: str | Sequence[str] = "auto",
    *,
    effects: Sequence[Effect] | None = None,
    parts: tuple[int, int] = (3, 3),
    most: int | None = MOST,
    stage: str | float = "auto",
    workers: int | None = None,
) -> Work[FieldFit]:
    """Fit one camera to the points in the frames of a target, each point at its actual sensor position.

    Positions are not reduced modulo the array's period: each pattern is computed at its actual subpixel position under
    the actual array. The field is divided into parts, each with the optics of its middle.

    Parameters
    ----------
    source, points
        The frames with their dark level subtracted, and the points found in them.
    unknowns, effects, stage, workers
        As in `lfcal.fit.fit_camera`; the array's pitch is always fitted. ``hole`` is the diameter of the target's
        holes, which is also fitted if chi² requires it.
    parts
        Number of parts of the sensor (rows, columns).
    most
        Largest number of points, spread evenly over the parts. None: all.

    Yields
    ------
    Progress
        Counted in derivatives. Closing the generator stops the fit.

    Raises
    ------
    InputError
        If no camera of this kind explains the points, or there are too few points.
    """
    check_stage(stage)
    measured = measured_points(source, points, parts, most=most)
    core, candidates = groups_of(unknowns)
    # the source is a hole, not a point
    asked = not isinstance(unknowns, str) and (HOLE in core or "source" in core)
    core = tuple(
        name for name in dict.fromkeys((*core, *ALWAYS_FITTED, *((HOLE,) if asked else ()))) if name not in OTHERS
    )
    candidates = tuple(name for name in candidates if name not in (*core, *OTHERS))
    check_light(measured)
    check_described(measured)
    scan = points.plan.scan
    began = tuple(starting_effects(scan) if effects is None else effects)
    points, began = _with_hole(points, began)
    optics = PointOptics.of(points, measured)
    hole = points.plan.target.hole_um
    setup = Setup(scan.camera, began, (0.0,) * scan.shape[0], regions=optics.regions, hole_um=hole)
    problem = problem_of(measured, setup, tuple(dict.fromkeys((*core, *candidates, HOLE))), workers)
    problem, start = yield from _placed(problem, optics, core, workers)
    local = Local(np.zeros((len(measured), 2)), DEVIATION_PX, BRIGHTNESS)
    finished = yield from iter_retrieved(problem, core, candidates, stage=stage, start=start, local=local)
    finished = yield from _settled(finished, points, asked=asked or bool(candidates))
    problem, point, groups = finished[:3]
    fits = yield from iter_summarised(*finished, candidates)
    if asked and HOLE not in groups:
        fits = tuple(with_undetermined_hole(fit) for fit in fits)
    names = [measured.regions[k].name for _, _, k in problem.measured.parts()]
    # planes of H are at their planned depths, for any tilt of the target
    depths = problem.vector.setup_at(point.u).depth_errors_um
    level = [replace(fit, setup=replace(fit.setup, depth_errors_um=depths)) for fit in fits]
    return FieldFit(dict(zip(names, level, strict=True)))


fit_points = drained(iter_fit_points)


def _with_hole(points: Points, effects: tuple[Effect, ...]) -> tuple[Points, tuple[Effect, ...]]:
    """Return points whose holes have the size of a source among ``effects``, and the other effects."""
    given = next((one for one in effects if isinstance(one, FiniteSource)), None)
    if given is None:
        return points, effects
    plan = points.plan
    target = replace(plan.target, hole_um=float(given.magnitude("diameter_um", plan.scan.camera)))
    return replace(points, plan=replace(plan, target=target)), tuple(one for one in effects if one is not given)


def _placed(
    problem: Problem, optics: PointOptics, core: Sequence[str], workers: int | None
) -> Work[tuple[Problem, NDArray[np.float64]]]:
    """Return the problem with points at the positions of a first fit, and the final vector of that fit.

    Mechanical vignetting displaces the centroid of the light from the chief ray by most of a pixel. A fit with fixed
    positions would attribute this to focal lengths, so each point has a free displacement from the start.
    """
    count = len(problem.measured)
    still = np.zeros((count, 2))
    begin = np.zeros(len(problem.vector))
    problem = yield from iter_with_point_light(problem, optics, begin, still, Fineness.coarse, "points as described")
    point = problem.point(begin, Local(still, DEVIATION_PX, BRIGHTNESS), Fineness.coarse)
    which = problem.vector.of_groups(core).tolist()
    point, columns = yield from descend(problem, point, which, "positions of the points", most=ROUNDS, enough=5e-3)
    point = nuisance_steps(problem, point, columns, np.ones(count, np.bool_))
    old: Measured = problem.measured
    lamps = point.levels.lamps[:, None, None].astype(np.float32)
    measured = replace(
        old,
        places_px=old.places_px + point.local.offsets_px,
        patterns=old.patterns / (1 + lamps),
        noise=old.noise / np.c_[(1 + lamps[:, 0, 0]) ** 2, 1 + lamps[:, 0, 0]],
    )
    placed = Problem(measured, problem.vector, workers)
    placed = yield from iter_with_point_light(
        placed, optics, point.u, still, Fineness.coarse, "points at their fitted positions"
    )
    return placed, point.u


def _settled(finished: Finished, points: Points, *, asked: bool) -> Work[Finished]:
    """Return the fit for which the light of each pattern is that of the fitted camera.

    ``asked`` says whether the size of the holes was requested; otherwise it is fitted if the points require it.
    """
    assert isinstance(finished[0].measured, Regional)
    optics = PointOptics.of(points, finished[0].measured)
    finished = yield from _with_light_as_found(finished, optics)
    if HOLE in finished[2] and not hole_is_determined(finished):
        return (yield from _with_light_as_found(without_hole(finished), optics))
    if not asked and (yield from iter_hole_is_needed(finished)):
        problem, point, groups, columns, outliers = finished
        finished = yield from _with_light_as_found((problem, point, (*groups, HOLE), columns, outliers), optics)
    # their light is only approximately proportional to the square of the diameter
    for _ in range(RESIZED):
        if not moved_far(finished):
            break
        finished = yield from _with_light_as_found(finished, optics)
    return finished


def _with_light_as_found(finished: Finished, optics: PointOptics) -> Work[Finished]:
    """Return a fit that starts from ``finished``, with the light of each point computed with its own optics there."""
    problem, point, groups, columns, outliers = finished
    local, lamps = point.local, point.levels.lamps
    problem = yield from iter_with_point_light(
        problem, optics, point.u, local.offsets_px, Fineness.fine, "points of the fitted camera"
    )
    point = problem.point(point.u, local, Fineness.finest, lamps=lamps)
    which = problem.vector.of_groups(groups).tolist()
    known = columns if columns.shared[which].any((1, 2)).all() else None
    point, found = yield from descend(problem, point, which, "settled", most=2, columns=known, enough=1e-4)
    columns = found.with_others(columns, which)
    return problem, nuisance_steps(problem, point, columns, problem.measured.held_out), groups, columns, outliers


def point_outputs(folder: Path) -> list[Path]:
    """Return the paths of all files of a fit of points in ``folder``."""
    return [folder / name for name in (MODEL, CAMERA, EFFECTS, NUMBERS)]


def iter_write_points(
    fit: FieldFit,
    scan: ScanPlan | RegionPlan,
    folder: Path,
    known: Mapping[str, Any],
    *,
    with_h: bool = True,
    workers: int | None = None,
) -> Work[list[Path]]:
    """Write a fit of points to ``folder``, ``fit.json`` last, and return the paths.

    H is computed from the fitted model.

    Parameters
    ----------
    fit
        Result of fitting one camera to the points of the whole field.
    scan
        The region of the field for H, or several regions, whose H are written to one file.
    folder
        Output folder, created if needed.
    known
        Facts about the frames, as plain JSON types.
    with_h
        Whether to compute and write H.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    if with_h:
        written.append((yield from _iter_h(fit, scan, folder / MODEL, known, workers)))
    parts = {
        name: {"chi2": one.here.chi_square.lit, "error": one.here.error.value, "points": len(one.residuals)}
        for name, one in fit.fits.items()
        if one.here is not None
    }
    return written + write_found(fit.first, folder, NUMBERS, fit_dict(fit.first) | {**known, "parts": parts})


def _iter_h(
    fit: FieldFit, scan: ScanPlan | RegionPlan, out: Path, known: Mapping[str, Any], workers: int | None
) -> Work[Path]:
    """Write H of a region, or of several."""
    if isinstance(scan, ScanPlan):
        return (yield from iter_write_model(fit.fit_at(scan), out, provenance=known, workers=workers))
    from lfcal.campaign.regions import (
        save_parts,
        temporary_parts,
    )  # imported here: it needs devices

    with temporary_parts(out, scan.names) as parts:
        for k, name in enumerate(scan.names):
            here = fit.fit_at(scan.plan(k))
            yield from iter_write_model(here, parts[name], provenance=known, workers=workers)
        return save_parts(parts, out)
