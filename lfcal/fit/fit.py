"""Retrieve a camera from measured patterns: from its description to a model that predicts every position."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Progress, Work, any_of, check_number, drained, format_share
from lfcal.camera import Camera, Microscope, PupilLenslets
from lfcal.fit._elemental import elemental_of
from lfcal.fit._summary import Degeneracies, iter_degeneracies, summarised
from lfcal.fit._weighing import unlike_others
from lfcal.fit.measured import Measured, measured_of
from lfcal.fit.model import Fineness
from lfcal.fit.model_error import chi_square
from lfcal.fit.normal import Columns, Local
from lfcal.fit.nuisance import Spread, nuisance_steps, response_of, spread_of
from lfcal.fit.parameters import GROUPS, ScanScales, Vector, check_groups
from lfcal.fit.problem import Point, Problem
from lfcal.fit.questions import (
    PLAIN,
    STRANGE,
    as_described,
    asked,
    check_described,
    check_explained,
    check_light,
    misfit,
    unexplained,
)
from lfcal.fit.result import Fit, Outlier
from lfcal.fit.select import choose, prune
from lfcal.fit.setup import Setup, starting_effects
from lfcal.fit.solver import RoundRecorder, descend
from lfcal.psf import PSFMatrix
from lfcal.simulate.effects import Effect

__all__ = [
    "Finished",
    "FitProgress",
    "addable",
    "check_stage",
    "fit_camera",
    "groups_of",
    "iter_fit_camera",
    "iter_retrieved",
    "iter_summarised",
    "outliers_of",
    "problem_of",
    "rounds",
]

DETECTION_SIGMAS = 2.0
"""Standard deviations of the squared noise above which an excess is significant."""


@dataclass(frozen=True, slots=True)
class FitProgress(Progress):
    """Progress at the start or the end of a round of derivatives; the number of rounds is not known in advance.

    The other attributes are those of `lfcal.base.Progress`.

    Attributes
    ----------
    chi2
        Mean square of the residuals of the fitted patterns, weighted by the light. Residuals are divided by their
        standard deviation, which includes the error of a coarsely sampled model. For a correct model, the value
        approaches 1 from round to round, but it may rise when the fit continues with finer sampling.
    held_out, below_noise
        Error of the prediction of the held-out patterns in addition to noise, as a fraction of their rms (relative L2),
        and whether it is too small to be detected. ``held_out`` is then an upper limit at two standard deviations. It
        is NaN without held-out patterns.
    """

    chi2: float = math.nan
    held_out: float = math.nan
    below_noise: bool = False


def rounds() -> Callable[[Problem, Point, str], FitProgress]:
    """Return a function that creates the progress record of a round from problem, point and name of the stage."""
    start = time.perf_counter()

    def record(problem: Problem, point: Point, stage: str) -> FitProgress:
        aside = problem.measured.held_out
        chi2 = chi_square(point, problem.fitted, 0).lit
        left, below_noise, note = math.nan, False, f"χ² {chi2:.3g}"
        if aside.any():
            share, sigma = unexplained(problem, point, aside)
            below_noise = share < DETECTION_SIGMAS * sigma
            left = math.sqrt(max(share, DETECTION_SIGMAS * sigma))
            note += f", error of held-out patterns {'below ' if below_noise else ''}{format_share(left)}"
        seconds = time.perf_counter() - start
        return FitProgress(1, 1, stage, seconds, note, chi2=chi2, held_out=left, below_noise=below_noise)

    return record


def outliers_of(problem: Problem, point: Point) -> tuple[NDArray[np.bool_], tuple[Outlier, ...]]:
    """Return a mask ``(n,)`` of the patterns that are outliers, and each outlier with its reason."""
    pixels = np.maximum(1, (point.seen.inverse > 0).sum(1))
    # without the robust loss, which would hide outliers
    chi2 = np.square(point.seen.residual, dtype=np.float64).sum(1) / pixels
    far = unlike_others(chi2, pixels)
    measured = problem.measured
    regions = measured.level // measured.plan.shape[0]
    found = [
        Outlier(int(z), int(y), int(x), f"chi² {own:.3g}, but {np.median(chi2):.3g} for the others", int(region))
        for (z, y, x), own, region in zip(measured.index[far], chi2[far], regions[far], strict=True)
    ]
    return far, tuple(found)


ROUNDS = 4
"""Number of rounds in which groups are selected."""

LEAST_GAIN = 0.1
"""Fraction of the held-out residual that a group must remove in the first round."""

Finished = tuple[Problem, Point, tuple[str, ...], Columns, tuple[Outlier, ...]]


def iter_fit_camera(
    source: PSFMatrix | Measured,
    camera: Camera | None = None,
    unknowns: str | Sequence[str] = "auto",
    *,
    effects: Sequence[Effect] | None = None,
    stage: str | float = "auto",
    workers: int | None = None,
    **reading: Any,
) -> Work[Fit]:
    """Fit the camera that best explains measured patterns.

    Parameters
    ----------
    source
        H, whose recorded positions are used, or measured patterns.
    camera
        Camera from which the fit starts. None: the camera of the source.
    unknowns
        Groups of unknowns by name; or ``"auto"``: gap, rotation and offset of the array, focal lengths and iris, and
        all other groups that lower the error of held-out patterns. Instead of rotation and offset, a Fourier
        light-field microscope has the positions of lenslets and optical axis, the focal length of the Fourier lens, and
        the tilt of the source's travel.
    effects
        Effects simulated at the start. None: those in the camera's description, and the vector field if its effect is
        noticeable (`starting_effects`).
    stage
        Rms position error of the sources along each axis of the sensor (px); 0: none; ``"auto"``: estimated from the
        patterns.
    workers
        Number of threads that compute derivatives. None: all processors.
    reading
        Further keyword arguments for `measured_of`, if the source is an H.

    Yields
    ------
    Progress
        Within a round, counted in derivatives; a `FitProgress` at the start and the end of each round. Closing the
        generator stops the fit.

    Raises
    ------
    InputError
        If no camera of this kind explains the patterns, there are too few patterns, or their noise is unknown.

    Examples
    --------
    >>> from lfcal.fit import FitProgress, iter_fit_camera, measured_of
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     work = iter_fit_camera(measured_of(H, most=8, cutout=21), unknowns=["geometry"])
    >>> step: FitProgress = next(work)
    >>> print(step.stage)
    as described
    >>> work.close()  # the rest is not wanted
    """
    if isinstance(source, Measured) and reading:
        # these options say how H is read, but patterns have already been read
        name = next(iter(reading))
        raise InputError.expected(
            "options of a fit of given patterns",
            "no options for reading H",
            name,
            "leave this option out, or correct its name",
        )
    measured = source if isinstance(source, Measured) else measured_of(source, camera, **reading)
    if isinstance(source, Measured) and camera is not None:
        measured = replace(measured, plan=replace(measured.plan, camera=camera))
    check_light(measured)
    check_described(measured)
    core, candidates = groups_of(unknowns)
    setup = Setup(
        measured.plan.camera,
        starting_effects(measured.plan) if effects is None else tuple(effects),
        (0.0,) * measured.plan.shape[0],
    )
    check_stage(stage)
    if not isinstance(unknowns, str):
        check_groups(setup, measured.plan, core)
    changes: dict[str, float] | None = None
    if not measured.plan.camera.has_lattice:
        measured, changes = elemental_of(measured)
    problem = problem_of(measured, setup, (*core, *candidates), workers)
    start = None if changes is None else problem.vector.at(changes)
    finished = yield from iter_retrieved(problem, core, candidates, stage=stage, start=start)
    return (yield from iter_summarised(*finished, candidates))[0]


fit_camera = drained(
    iter_fit_camera,
    """
    Examples
    --------
    >>> from lfcal.fit import Fit, fit_camera, measured_of
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     found: Fit = fit_camera(measured_of(H, most=8, cutout=21), unknowns=["geometry"])
    >>> gap = found.parameters["gap_um"]
    >>> print(f"gap between lenslets and sensor: {gap.value:.0f} um, known to {gap.sigma:.2f} um")
    gap between lenslets and sensor: 290 um, known to 0.2... um
    """,
)


def iter_summarised(
    problem: Problem,
    point: Point,
    groups: tuple[str, ...],
    columns: Columns,
    outliers: tuple[Outlier, ...],
    candidates: Sequence[str],
) -> Work[tuple[Fit, ...]]:
    """Return the fit of each region.

    The first five arguments are the result of `iter_retrieved`; ``candidates`` are names of groups that were tried.
    """
    untried: Degeneracies | None = None
    if not candidates:
        untried = yield from iter_degeneracies(problem, point, columns, groups)
    return summarised(problem, point, columns, groups=groups, tried=candidates, outliers=outliers, untried=untried)


def iter_retrieved(
    problem: Problem,
    core: Sequence[str],
    candidates: Sequence[str],
    *,
    stage: str | float,
    start: NDArray[np.float64] | None = None,
    local: Local | None = None,
) -> Work[Finished]:
    """Find the best-fit point of a problem.

    Return the problem without outliers, the point, the names of the fitted groups, the derivatives, and the outliers.

    Parameters
    ----------
    problem
        Problem with the unknowns of all groups.
    core, candidates
        Names of the groups that are always fitted, and of those that are added if they lower the held-out error.
    stage
        As in `fit_camera`.
    start
        Vector to start from. None: start from the description.
    local
        Unknowns of single patterns at the start. None: there are none until the patterns show that they are needed.

    Raises
    ------
    InputError
        If no camera of this kind explains the patterns.
    """
    core = tuple(group.name for group in problem.vector.groups if group.name in core)
    record_round = rounds()
    point = yield from as_described(problem, core, record_round, start=start, local=local)
    # centroids of elemental images show mirrored axes and the sign of depth at once
    questions = problem.measured.plan.camera.has_lattice
    if questions and misfit(problem, point) > STRANGE:
        yield from asked(problem, core)
    point = with_cut_pupil(problem, point, core)
    point, groups = yield from _approached(problem, point, core, candidates, record_round=record_round)
    if questions and misfit(problem, point) > PLAIN:
        # a large residual that no unknown explains: the description may be wrong in other ways
        yield from asked(problem, core)
    check_explained(problem, point)
    return (yield from _finished(problem, point, groups, core, candidates, stage=stage, record_round=record_round))


CUT_PUPIL = (0.98, 0.96, 0.93, 0.9)
"""Numerical apertures to try, as fractions of the aperture at which the edge of the pupil touches the lenslets."""


def with_cut_pupil(problem: Problem, point: Point, core: Sequence[str]) -> Point:
    """Return ``point``, or a better point at which the edge of the pupil cuts lenslets of a Fourier microscope.

    If the pupil is described as too large, its edge cuts no lenslet. The derivatives with respect to the aperture are
    then zero. ``core`` are names of fitted groups; without ``"iris"``, ``point`` is returned.
    """
    camera = problem.vector.setup_at(point.u).camera
    which = problem.vector.of_groups(["iris"])
    if not isinstance(camera.lattice, PupilLenslets) or not isinstance(camera.optics, Microscope):
        return point
    if "iris" not in core or not which.size:
        return point
    lenslets, aperture = camera.lattice, camera.optics.numerical_aperture
    reach = max(math.hypot(*one) for one in lenslets.lens_centres_um) + lenslets.clear_um / 2
    touching = aperture * reach / (lenslets.pupil_um(camera.optics) / 2)
    best, unknown = point, problem.vector.unknowns[which[0]]
    for share in CUT_PUPIL if touching < aperture else ():
        u = point.u.copy()
        u[which[0]] = (share * touching - unknown.start) / unknown.scale
        trial = problem.point(problem.vector.clipped(u), point.local, point.sampling, doubtful=point.doubtful)
        best = trial if problem.cost(trial, point) < problem.cost(best, point) else best
    return best


def problem_of(measured: Measured, setup: Setup, groups: Sequence[str], workers: int | None = None) -> Problem:
    """Return the problem of fitting the unknowns of ``groups`` (names) to ``measured``, starting from ``setup``."""
    frame = ScanScales.over(measured.plans) if len(measured.plans) > 1 else ScanScales.of(measured.plan)
    return Problem(measured, Vector(setup, frame, groups), workers)


def groups_of(unknowns: str | Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the groups to fit, and of those to try in addition; ``unknowns`` is as in `fit_camera`."""
    if isinstance(unknowns, str):
        if unknowns != "auto":
            names = any_of(GROUPS.names())
            raise InputError.expected(
                "unknowns", "'auto' or a list of groups", repr(unknowns), f"choose auto, or some of the groups {names}"
            )
        core = tuple(group.name for group in GROUPS if group.core)
        return core, tuple(group.name for group in GROUPS if not group.core)
    found = tuple(GROUPS.get(name).name for name in unknowns)
    if not found:
        raise InputError.expected("unknowns", "at least one group", "none", f"choose from {', '.join(GROUPS.names())}")
    return found, ()


def addable(candidates: Sequence[str]) -> list[str]:
    """Return the ``candidates`` that a fit may add, without those that always stay fixed."""
    return [name for name in candidates if not GROUPS.get(name).held]


def check_stage(stage: str | float) -> None:
    """Raise `InputError` unless ``stage`` is a source position error from 0 to 5 px rms, or ``"auto"``."""
    if stage != "auto":
        check_number("source position error (px rms)", stage, at_least=0, at_most=5, remedy="or 'auto'")


def _approached(
    problem: Problem, point: Point, core: Sequence[str], candidates: Sequence[str], *, record_round: RoundRecorder
) -> Work[tuple[Point, tuple[str, ...]]]:
    """Return a point near the best one, computed at coarse sampling, and the groups that lower the error."""
    vector, groups = problem.vector, tuple(core)
    for turn in range(ROUNDS):
        columns: Columns | None = None
        before = groups
        if candidates:
            tried = [name for name in addable(candidates) if turn or not GROUPS.get(name).late]
            every = vector.of_groups([*groups, *tried]).tolist()
            displaced = point.local.stage_px > 0
            columns = yield from problem.columns(point, every, f"groups, round {turn + 1}", displaced=displaced)
            groups = choose(problem, point, columns, groups, tried, least=0.0 if turn else LEAST_GAIN)
        if turn and groups == before:
            break
        which = vector.of_groups(groups).tolist()
        point, _ = yield from descend(
            problem, point, which, "approach", most=4, enough=2e-3, columns=columns, record_round=record_round
        )
        point = problem.weigh(point.u, point.local, point.model, point.sampling, lamps=point.levels.lamps)
        if not candidates:
            break
    return point, groups


def _finished(
    problem: Problem,
    point: Point,
    groups: tuple[str, ...],
    core: Sequence[str],
    candidates: Sequence[str],
    *,
    stage: str | float,
    record_round: RoundRecorder,
) -> Work[Finished]:
    """Return the result as in `iter_retrieved`: the best point at the finest sampling, without the outliers."""
    vector = problem.vector
    point = problem.point(point.u, point.local, Fineness.fine, lamps=point.levels.lamps)
    every = vector.of_groups([*groups, *candidates]).tolist()
    columns = yield from problem.columns(point, every, "fine", displaced=True)
    which = vector.of_groups(groups).tolist()
    point, _ = yield from descend(
        problem, point, which, "fine", most=1, columns=columns, enough=1e-5, record_round=record_round
    )
    # steps of the shared unknowns do not determine the unknowns of single held-out patterns
    point = nuisance_steps(problem, point, columns, problem.measured.held_out)
    far, outliers = outliers_of(problem, point)
    if far.any():
        problem, point, columns = _without(problem, point, columns, ~far)
    point = _with_spread(problem, point, columns, stage)
    if candidates:
        groups = prune(problem, point, columns, choose(problem, point, columns, groups, addable(candidates)), core)
        left = np.setdiff1d(np.arange(len(vector)), vector.of_groups(groups))
        u = point.u.copy()
        u[left] = 0.0
        which = vector.of_groups(groups).tolist()
        point = problem.point(u, point.local, Fineness.finest, lamps=point.levels.lamps)
    else:
        point = problem.point(point.u, point.local, Fineness.finest, lamps=point.levels.lamps)
    point, found = yield from descend(
        problem, point, which, "finest", most=3, columns=columns, enough=1e-4, record_round=record_round
    )
    # derivatives by the groups that were tried are those of the previous round
    columns = found.with_others(columns, which)
    return problem, nuisance_steps(problem, point, columns, problem.measured.held_out), groups, columns, outliers


def _without(
    problem: Problem, point: Point, columns: Columns, keep: NDArray[np.bool_]
) -> tuple[Problem, Point, Columns]:
    """Return problem, point and derivatives with only the patterns ``keep``."""
    found = problem.with_measured(problem.measured.of(keep))
    local = replace(point.local, offsets_px=point.local.offsets_px[keep])
    own = None if columns.displacements is None else columns.displacements[:, keep]
    at = found.weigh(point.u, local, point.model[keep], point.sampling, lamps=point.levels.lamps[keep])
    return found, at, Columns(columns.shared[:, keep], own)


def _with_spread(problem: Problem, point: Point, columns: Columns, stage: str | float) -> Point:
    """Return the point with separate unknowns for each pattern, and with the scatter that the patterns show.

    The noise includes the uneven response of the pixels.
    """
    shown = spread_of(problem, point, columns)
    own = Spread(shown.stage_px if stage == "auto" else float(stage), shown.lamp)
    local = Local(point.local.offsets_px, own.stage_px, own.lamp, response_of(problem, point))
    at = problem.weigh(point.u, local, point.model, point.sampling, lamps=point.levels.lamps)
    return nuisance_steps(problem, at, columns, np.ones(len(problem.measured), np.bool_))
