"""One camera from the points of a target, each at its real place on the sensor and in its own part of the field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Work, drained
from lfcal.campaign._point_optics import OwnOptics, iter_with_own_light
from lfcal.campaign._point_parts import measured_points
from lfcal.campaign.point_hole import HOLE, is_told, iter_called_for, moved_far, not_told, without_hole
from lfcal.campaign.points import Points
from lfcal.fit import (
    FieldFit,
    Fineness,
    Finished,
    Local,
    Measured,
    Problem,
    Regional,
    Setup,
    called_for,
    check_described,
    check_light,
    check_stage,
    descend,
    groups_of,
    iter_retrieved,
    iter_summarised,
    own_steps,
    problem_of,
)
from lfcal.frames import FrameSource
from lfcal.simulate.effects import Effect, FiniteSource

__all__ = ["MOST", "fit_points", "iter_fit_points"]

MOST = 72
"""Points that are fitted: eight of each of nine parts of the field; what is left of the error is the computation's."""

OTHERS = ("region_places", "region_depths", "stage_scale", "stage_zero", "source")
"""Groups of scans: a target's points have one lattice and one plane, each its own displacement, sources are holes."""

OWN = ("pitch", "plane_tilt")
"""Groups that are always found: over the field a small error of either shows."""

BESIDE_PX, BRIGHTNESS = 0.5, 0.05
"""How far a chief ray lies beside what light alone tells, and how well that tells a hole's brightness, beforehand."""

ROUNDS = 4
"""Of the fit that places the points."""

RESIZED = 2
"""How often the light of holes is computed anew at most, where another size was found than it was computed for."""


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
    """Return the one camera that explains the points of a target's frames, each where it really is.

    Nothing is taken modulo the array's period: patterns are computed at their own pixels, with what is left of their
    positions, under the array as it lies there. The field falls into parts, each with the optics of its middle.

    Parameters
    ----------
    source, points
        The frames, with their dark level subtracted, and what was found in them.
    unknowns, effects, stage, workers
        As of `lfcal.fit.fit_camera`; the array's pitch is always found. ``hole`` is the diameter of the target's
        holes, which is also found where chi² requires it.
    parts
        Parts of the sensor (rows, columns).
    most
        No more points than this, spread evenly over the parts; None: all.

    Yields
    ------
    Progress
        In derivatives; closing it stops the fit.

    Raises
    ------
    InputError
        If the points are not of such a camera, or too few.
    """
    check_stage(stage)
    measured = measured_points(source, points, parts, most=most)
    core, candidates = groups_of(unknowns)
    # the source is a hole
    asked = not isinstance(unknowns, str) and (HOLE in core or "source" in core)
    core = tuple(name for name in dict.fromkeys((*core, *OWN, *((HOLE,) if asked else ()))) if name not in OTHERS)
    candidates = tuple(name for name in candidates if name not in (*core, *OTHERS))
    check_light(measured)
    check_described(measured)
    scan = points.plan.scan
    began = tuple(called_for(scan) if effects is None else effects)
    points, began = _with_hole(points, began)
    own = OwnOptics.of(points, measured)
    hole = points.plan.target.hole_um
    setup = Setup(scan.camera, began, (0.0,) * scan.shape[0], regions=own.regions, hole_um=hole)
    problem = problem_of(measured, setup, tuple(dict.fromkeys((*core, *candidates, HOLE))), workers)
    problem, start = yield from _placed(problem, own, core, workers)
    local = Local(np.zeros((len(measured), 2)), BESIDE_PX, BRIGHTNESS)
    finished = yield from iter_retrieved(problem, core, candidates, stage=stage, start=start, local=local)
    finished = yield from _settled(finished, points, asked=asked or bool(candidates))
    problem, point, groups = finished[:3]
    fits = yield from iter_summarised(*finished, candidates)
    if asked and HOLE not in groups:
        fits = tuple(not_told(fit) for fit in fits)
    names = [measured.regions[k].name for _, _, k in problem.measured.parts()]
    # planes of H are where they were planned, however the target is tilted
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
    problem: Problem, own: OwnOptics, core: Sequence[str], workers: int | None
) -> Work[tuple[Problem, NDArray[np.float64]]]:
    """Return the problem with points where a first fit has them, and the vector it ended at.

    A cat's eye moves the middle of the light beside the chief ray by most of a pixel. A fit that holds the places takes
    that for focal lengths; so each point has a displacement of its own from the start.
    """
    count = len(problem.measured)
    still = np.zeros((count, 2))
    begin = np.zeros(len(problem.vector))
    problem = yield from iter_with_own_light(problem, own, begin, still, Fineness.coarse, "points as described")
    point = problem.point(begin, Local(still, BESIDE_PX, BRIGHTNESS), Fineness.coarse)
    which = problem.vector.of_groups(core).tolist()
    point, columns = yield from descend(problem, point, which, "places of the points", most=ROUNDS, enough=5e-3)
    point = own_steps(problem, point, columns, np.ones(count, np.bool_))
    old: Measured = problem.measured
    lamps = point.levels.lamps[:, None, None].astype(np.float32)
    measured = replace(
        old,
        places_px=old.places_px + point.local.offsets_px,
        patterns=old.patterns / (1 + lamps),
        noise=old.noise / np.c_[(1 + lamps[:, 0, 0]) ** 2, 1 + lamps[:, 0, 0]],
    )
    placed = Problem(measured, problem.vector, workers)
    placed = yield from iter_with_own_light(placed, own, point.u, still, Fineness.coarse, "points where they are")
    return placed, point.u


def _settled(finished: Finished, points: Points, *, asked: bool) -> Work[Finished]:
    """Return the best point where what each pattern has to itself is that of the camera as found.

    Whether the size of the holes is among it was ``asked``; else the points may call for it.
    """
    assert isinstance(finished[0].measured, Regional)
    own = OwnOptics.of(points, finished[0].measured)
    finished = yield from _with_own_as_found(finished, own)
    if HOLE in finished[2] and not is_told(finished):
        return (yield from _with_own_as_found(without_hole(finished), own))
    if not asked and (yield from iter_called_for(finished)):
        problem, point, groups, columns, outliers = finished
        finished = yield from _with_own_as_found((problem, point, (*groups, HOLE), columns, outliers), own)
    # their light changes with the square of the diameter only nearly
    for _ in range(RESIZED):
        if not moved_far(finished):
            break
        finished = yield from _with_own_as_found(finished, own)
    return finished


def _with_own_as_found(finished: Finished, own: OwnOptics) -> Work[Finished]:
    """Return the best point near another, what each pattern has to itself computed there."""
    problem, point, groups, columns, outliers = finished
    local, lamps = point.local, point.levels.lamps
    problem = yield from iter_with_own_light(
        problem, own, point.u, local.offsets_px, Fineness.fine, "points of the camera as found"
    )
    point = problem.point(point.u, local, Fineness.finest, lamps=lamps)
    which = problem.vector.of_groups(groups).tolist()
    known = columns if columns.shared[which].any((1, 2)).all() else None
    point, found = yield from descend(problem, point, which, "settled", most=2, columns=known, enough=1e-4)
    columns = found.beside(columns, which)
    return problem, own_steps(problem, point, columns, problem.measured.left_out), groups, columns, outliers
