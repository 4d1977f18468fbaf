"""Discrete questions about the description: order of lens types, mirrored axes, sign of depth, wrong camera."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work, format_share
from lfcal.camera import Camera, cutout_for
from lfcal.fit._weighing import flat
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness
from lfcal.fit.normal import Local
from lfcal.fit.problem import Point, Problem
from lfcal.fit.solver import RoundRecorder, descend
from lfcal.fit.spread import spread_out
from lfcal.simulate.engines import EnergyError

__all__ = [
    "PLAIN",
    "STRANGE",
    "as_described",
    "asked",
    "check_described",
    "check_explained",
    "check_light",
    "misfit",
    "order_of_types",
    "unexplained",
]

PLAIN = 0.12
"""Residual of the described camera (relative L2) above which questions are asked."""

STRANGE = 0.8
"""Limit instead of `PLAIN` before aberrations are fitted; wrong axes or depths leave such large residuals."""

UNEXPLAINED = 0.5
"""Residual beyond noise (relative L2) above which the patterns do not belong to the described camera."""

LIGHT = 10.0
"""Threshold of the light of the patterns, in standard deviations of the sum of the squared noise."""

BETTER = 0.6
"""Ratio of the residual of another answer to that of the description below which the answer is better."""

WIDE = 20.0
"""Largest ratio of the described size of the patterns to the size of the measured cutouts."""

FEW = 8
"""Number of patterns with which questions are answered."""


@dataclass(frozen=True, slots=True)
class Answer:
    """One possible difference between a recording and its description.

    Attributes
    ----------
    question, name
        Name of the question, and name of this answer to it.
    change
        Function that takes the patterns with their plan, and returns them changed according to this answer.
    remedy
        Remedy if this answer is correct.
    """

    question: str
    name: str
    change: Callable[[Measured], Measured]
    remedy: str


def unexplained(problem: Problem, point: Point, keep: NDArray[np.bool_]) -> tuple[float, float]:
    """Return the sum of squared residuals beyond the noise, and its standard deviation due to the noise.

    ``keep`` is a mask that selects patterns. Both results are fractions of the sum of the squares of these patterns
    without background.
    """
    data, valid = flat(problem.measured.of(keep))
    inverse = np.where(valid, point.seen.inverse[keep], 1.0)
    off = np.where(valid, point.seen.residual[keep] / inverse, 0.0)
    light = point.model[keep] * point.levels.factors(problem.planes)[keep, None]
    constant, slope = (problem.measured.noise[keep, k, None] for k in (0, 1))
    noise = np.where(valid, constant + slope * np.maximum(light, 0), 0.0)
    back = point.levels.backgrounds[problem.planes[keep], None]
    power = max(1e-300, float(np.square(np.where(valid, data - back, 0.0), dtype=np.float64).sum()))
    beside = float(np.square(off, dtype=np.float64).sum() - noise.sum())
    return beside / power, float(np.sqrt(2.0 * np.square(noise).sum())) / power


def misfit(problem: Problem, point: Point) -> float:
    """Return the rms residual of the fitted patterns beyond the noise, as a fraction of their rms (relative L2)."""
    share, _ = unexplained(problem, point, problem.fitted)
    return float(np.sqrt(max(0.0, share)))


def check_light(measured: Measured) -> None:
    """Raise `InputError` if the patterns that are not held out have no valid pixels, or no light beyond the noise."""
    keep = measured.of(~measured.held_out)
    data, valid = flat(keep)
    if not valid.any():
        raise InputError.expected(
            "patterns",
            "valid pixels (not saturated, masked or padded)",
            "none",
            "reduce the exposure, or correct the pixel mask",
        )
    # a constant background contains no information
    middle = np.array([np.median(one[good]) if good.any() else 0.0 for one, good in zip(data, valid, strict=True)])
    off = np.where(valid, data - middle[:, None], 0.0)
    noise = keep.noise[:, :1] + keep.noise[:, 1:] * np.maximum(np.where(valid, data, 0.0), 0)
    beyond = float(np.where(valid, np.square(off, dtype=np.float64) - noise, 0.0).sum())
    if beyond <= LIGHT * float(np.sqrt(2 * np.square(noise).sum())):
        remedy = "check the files and the background that was subtracted"
        raise InputError.expected("light of the patterns", "more light than noise", "no light above the noise", remedy)


def check_described(measured: Measured) -> None:
    """Raise `InputError` if the described camera would form patterns much larger than the measured cutouts.

    Without this check, a wrong description, such as a microscope described with the distances of a main lens, would be
    reported only after hours.
    """
    plan = measured.plan
    side = cutout_for(plan.camera, plan.depths_um)
    if side > WIDE * max(plan.cutout):
        raise InputError.expected(
            f"size of the patterns of the camera {plan.camera.name!r}",
            f"about the {max(plan.cutout)} px of the cutout",
            f"{side} px, computed from the description",
            "check the optics and the pitch of the camera, and the depths of the plan",
        )


def check_explained(problem: Problem, point: Point) -> None:
    """Raise `InputError` if the model at ``point`` does not explain the fitted patterns.

    This is the case if the gain of a plane is not positive, or if `misfit` exceeds 0.5. The patterns then probably
    belong to a different camera.
    """
    if (point.levels.gains[np.unique(problem.planes)] <= 0).any():
        remedy = "check what was subtracted from the frames"
        raise InputError.expected(
            "light of the patterns", "patterns brighter than the background", "darker ones", remedy
        )
    left = misfit(problem, point)
    if left > UNEXPLAINED:
        name = problem.measured.plan.camera.name
        raise InputError.expected(
            "measured patterns",
            f"patterns of a camera like {name!r}",
            f"patterns of which the model leaves {format_share(left)} of the light unexplained",
            "check the pitch, gap, pixels, depths and lens types of the description",
        )


def as_described(
    problem: Problem,
    core: Sequence[str],
    record_round: RoundRecorder | None = None,
    *,
    start: NDArray[np.float64] | None = None,
    local: Local | None = None,
    note: str = "as described",
) -> Work[Point]:
    """Return the point after at most four rounds of fitting the unknowns of the groups ``core``.

    ``start`` is the vector of unknowns from which the fit starts (None: the description). ``local`` contains the
    unknowns of single patterns (None: there are none). ``record_round`` creates a progress record of each round (None:
    no records), and ``note`` names the stage in the progress.
    """
    return (yield from _tried(problem, core, note, most=4, record_round=record_round, start=start, local=local))


def asked(problem: Problem, core: Sequence[str]) -> Work[None]:
    """Fit a few patterns under other assumptions about the description, such as mirrored axes or reversed depths.

    The unknowns of the groups ``core`` are fitted. Progress counts derivatives.

    Raises
    ------
    InputError
        If one of these assumptions explains the patterns much better than the description; the message states it and
        its remedy.
    """
    few = _few(problem)
    plain = yield from _tried(few, core, "as described", most=3)
    limit = BETTER * misfit(few, plain)
    winner: Answer | None = None
    for answer in _answers():
        try:
            changed = few.with_measured(answer.change(few.measured))
            trial = yield from _tried(changed, core, f"{answer.question}: {answer.name}", most=3)
        except (InputError, EnergyError):  # there is no such plane in front of the lens, or it cannot be computed
            continue
        share = misfit(changed, trial)
        if share < limit:
            limit, winner = share, answer
    if winner is not None:
        raise InputError.expected(winner.question, "as described", winner.name, winner.remedy)


def order_of_types(described: Camera, found: Camera) -> str:
    """Return the order in which the described lens types match the fitted ones, such as "1, 0, 2".

    The text is empty if the camera has no periodic array. It is also empty if no other order matches at least twice as
    well as that of the description. The focal lengths are compared: if the order is wrong, the fit finds the values of
    the description, but for other types.
    """
    if not described.has_lattice:
        return ""
    was, now = (np.log([kind.focal_length_um for kind in c.lattice.types]) for c in (described, found))
    far = {order: float(np.abs(now - was[list(order)]).sum()) for order in itertools.permutations(range(len(was)))}
    best, own = min(far, key=lambda order: far[order]), far[tuple(range(len(was)))]
    return ", ".join(map(str, best)) if far[best] < 0.5 * own else ""


def _tried(
    problem: Problem,
    core: Sequence[str],
    note: str,
    *,
    most: int,
    record_round: RoundRecorder | None = None,
    start: NDArray[np.float64] | None = None,
    local: Local | None = None,
) -> Work[Point]:
    which = problem.vector.of_groups(core).tolist()
    own = Local(np.zeros((len(problem.measured), 2))) if local is None else local
    u = np.zeros(len(problem.vector)) if start is None else start
    point = problem.point(u, own, Fineness.coarse, doubtful=True)
    if record_round is not None:
        yield record_round(problem, point, note)
    point, _ = yield from descend(problem, point, which, note, most=most, enough=5e-3, record_round=record_round)
    return point


def _few(problem: Problem) -> Problem:
    """Return the problem with only a few of its patterns."""
    measured = problem.measured.of(problem.fitted)
    keep = np.zeros(len(measured), np.bool_)
    keep[spread_out(measured.index, min(FEW, len(measured)), measured.plan.period)] = True
    return problem.with_measured(measured.of(keep))


# -- possible errors of the description ----------------------------------------------------------------------


def _answers() -> list[Answer]:
    found = []
    turn = "mirror the frames, or reverse the stage's axis in the plan, and assemble again"
    for name, axes in (("mirrored rows", (1,)), ("mirrored columns", (2,)), ("turned by 180°", (1, 2))):
        found.append(Answer("axes of the patterns", name, _mirrored(axes), turn))
    found.append(Answer("sign of the depths", "reversed depths", _nearer, "change the sign of the depths"))
    return found


def _mirrored(axes: tuple[int, ...]) -> Callable[[Measured], Measured]:
    def change(measured: Measured) -> Measured:
        patterns = np.ascontiguousarray(np.flip(measured.patterns, axes))
        return replace(measured, patterns=patterns, valid=np.ascontiguousarray(np.flip(measured.valid, axes)))

    return change


def _nearer(measured: Measured) -> Measured:
    depths = tuple(-z for z in measured.plan.depths_um)
    return replace(measured, plan=replace(measured.plan, depths_um=depths))
