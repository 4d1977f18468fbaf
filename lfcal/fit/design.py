"""Choose the positions to record next so that the expected error of H decreases most (I-optimal design)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import LINES, Clock, InputError, Work, check_number, drained, figure, save_figure
from lfcal.camera import Forecast, ScanPlan
from lfcal.fit.earlier import Earlier
from lfcal.fit.information import Expected, Information, iter_information
from lfcal.fit.parameters import GROUPS, check_groups
from lfcal.fit.setup import Setup, starting_effects
from lfcal.fit.spread import held_out_rows, spread_out

__all__ = [
    "Chosen",
    "CurvePoint",
    "PositionDesign",
    "choose",
    "draw_design",
    "iter_next_positions",
    "next_positions",
]

F8 = NDArray[np.float64]

PASSES = 4
"""Largest number of rounds in which each chosen position may be exchanged for a better one."""


class Chosen:
    """Information about the unknowns from a changing set of patterns; gain and background of each plane are eliminated.

    Parameters
    ----------
    information
        Information from each single pattern, and the weights of the error to minimise.
    """

    def __init__(self, information: Information) -> None:
        self._information = information
        self._planes = information.index[:, 0]
        k = len(information.unknowns)
        self._rows: list[int] = []
        self._sums = np.zeros((int(self._planes.max(initial=0)) + 1, k + 2, k + 2))
        self.matrix = information.prior

    @property
    def error(self) -> float:
        """Expected relative error (L2) of H."""
        return float(np.sqrt(self._squares(self.matrix[None])[0]))

    @property
    def covariance(self) -> F8:
        """Covariance ``(k, k)`` of the unknowns, each in units of its scale."""
        found: F8 = _inverse(self.matrix[None])[0]
        return found

    def add(self, *rows: int) -> None:
        """Add the patterns with the indices ``rows``, as in `Information.index`, to the set."""
        self._rows += rows
        self._summed({int(self._planes[row]) for row in rows})

    def remove(self, row: int) -> None:
        """Remove the pattern with the index ``row``, as in `Information.index`, from the set."""
        self._rows.remove(row)
        self._summed({int(self._planes[row])})

    def _summed(self, planes: set[int]) -> None:
        # sums are computed again: subtraction would leave rounding errors in an empty plane, which would then count
        # fully
        for z in planes:
            self._sums[z] = self._information.patterns[[row for row in self._rows if self._planes[row] == z]].sum(0)
        self.matrix = self._information.prior + _eliminated(self._sums).sum(0)

    def trials(self, rows: NDArray[np.intp]) -> F8:
        """Return the expected squared error of H ``(n,)`` after adding each of the ``n`` patterns ``rows`` alone."""
        z = self._planes[rows]
        before = _eliminated(self._sums)[z]
        after = _eliminated(self._sums[z] + self._information.patterns[rows])
        return self._squares(self.matrix + after - before)

    def _squares(self, matrices: F8) -> F8:
        found: F8 = np.einsum("nij,ji->n", _inverse(matrices), self._information.wanted)
        return np.maximum(found, 0.0)


def _eliminated(matrices: F8) -> F8:
    """Return matrices ``(..., k, k)`` with gain and background, the last two of ``k + 2`` unknowns, eliminated."""
    k = matrices.shape[-1] - 2
    cross, level = matrices[..., :k, k:], matrices[..., k:, k:]
    size = np.sqrt(np.maximum(np.diagonal(level, axis1=-2, axis2=-1), 1e-300))
    scaled = level / (size[..., :, None] * size[..., None, :])
    scaled = np.where(np.isfinite(scaled), scaled, 0.0)
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    part = cross / size[..., None, :]
    found: F8 = matrices[..., :k, :k] - part @ inverse @ np.swapaxes(part, -1, -2)
    return found


def _inverse(matrices: F8) -> F8:
    """Return the inverses of positive definite matrices ``(n, k, k)`` whose unknowns differ in scale."""
    size = np.sqrt(np.diagonal(matrices, axis1=-2, axis2=-1))
    both = size[:, :, None] * size[:, None, :]
    found: F8 = np.linalg.inv(matrices / both) / both
    return found


def choose(information: Information, count: int, allowed: NDArray[np.intp]) -> list[int]:
    """Return the indices of ``count`` patterns, chosen to lower the expected error of H, the most useful first.

    ``allowed`` contains the indices of the candidates; all are returned if they are fewer than ``count``. Patterns are
    first added greedily. Each is then exchanged for a better one, in at most `PASSES` rounds, until no exchange lowers
    the error. The result may be a local optimum.
    """
    chosen, free = Chosen(information), np.asarray(allowed, np.intp)
    taken = _greedy(chosen, free, count)
    for _ in range(PASSES):
        if not _exchanged(chosen, free, taken):
            break
    for row in taken:
        chosen.remove(row)
    return _greedy(chosen, np.array(taken, np.intp), len(taken))


def _greedy(chosen: Chosen, free: NDArray[np.intp], count: int) -> list[int]:
    taken: list[int] = []
    for _ in range(min(count, len(free))):
        left = np.setdiff1d(free, taken)
        best = int(left[int(np.argmin(chosen.trials(left)))])
        chosen.add(best)
        taken.append(best)
    return taken


def _exchanged(chosen: Chosen, free: NDArray[np.intp], taken: list[int]) -> bool:
    """Exchange patterns for better ones in place, and return whether any was exchanged."""
    any_better = False
    for k, row in enumerate(taken):
        before = chosen.error**2
        chosen.remove(row)
        left = np.setdiff1d(free, taken)
        squares = chosen.trials(left) if len(left) else np.array([np.inf])
        best = int(np.argmin(squares))
        if squares[best] < before * (1 - 1e-6):
            taken[k], any_better = int(left[best]), True
        chosen.add(taken[k])
    return any_better


HELD_OUT_SHARE = 0.2
"""Fraction of the positions that are spread evenly and held out to measure the quality of the fit."""

CANDIDATES = 300
"""Number of candidate positions, spread evenly over a larger scan; it determines most of the computing time."""

FEWEST = 3
"""Smallest number of positions for which a design is computed."""

POINTS = 12
"""Number of points of the curve of errors."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """Expected result for a number of recorded positions.

    Attributes
    ----------
    positions
        Number of recorded positions, including held-out ones.
    error
        Expected relative error (L2) of H from this number of chosen positions.
    spread_error
        Expected relative error (L2) of H from the same number of evenly spread positions.
    hours
        Recording time of the chosen positions (h).
    """

    positions: int
    error: float
    spread_error: float
    hours: float


@dataclass(frozen=True, eq=False)
class PositionDesign:
    """Positions to record, with the expected error of H.

    Attributes
    ----------
    fitted
        Positions ``(n, 3)`` as (z, y, x) chosen to lower the error, the most useful first.
    held_out
        Held-out positions ``(m, 3)``, spread evenly.
    curve
        Expected error as a function of the number of positions; the last point is for all positions of this design.
    pattern_error
        Relative error (L2) of an H in which every position was recorded once, due to the noise of each pattern.
    start_error
        Expected relative error (L2) of H before any of these positions is recorded; None without an earlier fit.
    sigmas
        Expected standard deviation of each unknown after a fit to ``fitted``, in its unit, by name.
    candidates
        Number of candidate positions.
    """

    fitted: NDArray[np.intp]
    held_out: NDArray[np.intp]
    curve: tuple[CurvePoint, ...]
    pattern_error: float
    start_error: float | None
    sigmas: dict[str, float]
    candidates: int

    @property
    def positions(self) -> NDArray[np.intp]:
        """All positions to record ``(n + m, 3)`` as (z, y, x)."""
        return np.concatenate([self.fitted, self.held_out])

    def enough_for(self, error: float) -> CurvePoint | None:
        """Return the first point of the curve whose relative error is at most ``error``; None if there is none."""
        return next((point for point in self.curve if point.error <= error), None)


def iter_next_positions(
    plan: ScanPlan,
    count: int,
    *,
    setup: Setup | None = None,
    groups: Sequence[str] | None = None,
    earlier: Earlier | None = None,
    recorded: NDArray[np.intp] | None = None,
    expected: Expected | None = None,
    candidates: int = CANDIDATES,
    stage_um_per_s: float = 1000.0,
    frames_per_s: float | None = None,
    workers: int | None = None,
) -> Work[PositionDesign]:
    """Return the positions to record next, chosen by their effect on the error of H.

    This is an I-optimal design. The squared relative error of H is trace(C M). C is the covariance of the unknowns from
    the patterns. M sums the outer products of the derivatives of the model with respect to the unknowns over all
    candidate positions. It is divided by the summed squares of the model.

    Parameters
    ----------
    plan
        The plan of the scan.
    count
        Number of positions; a fifth of them is evenly spread and held out.
    setup
        Assumed camera, effects, depths and stage. None: those of ``earlier``, or else as planned.
    groups
        Names of the groups of unknowns. None: those of ``earlier``, or else those with which ``"auto"`` starts in
        `fit_camera`.
    earlier
        An earlier fit whose covariance is used as a prior; its positions are not chosen again.
    recorded
        Further positions ``(n, 3)`` as (z, y, x) that have already been recorded and are not chosen again.
    expected
        Expected light and stability. None: the brightest pixel at 80 % of the full well, and sources exactly at their
        positions.
    candidates
        Number of evenly spread candidate positions; 0: all.
    stage_um_per_s, frames_per_s
        Speed of the stage (µm/s) and frame rate of the camera (1/s), which determine the recording time. Without a
        frame rate, readout is not counted.
    workers
        Number of threads. None: all processors.

    Yields
    ------
    Progress
        Counted in patterns, then in steps of the choice.

    Raises
    ------
    InputError
        If ``count`` is below 3 or above the number of remaining positions, a group is unknown, or ``earlier`` belongs
        to another scan.
    """
    expected = expected or Expected()
    check_number("number of positions to record", count, at_least=FEWEST, integer=True)
    check_number("number of candidate positions", candidates, at_least=0, integer=True)
    setup, groups = _start(plan, setup, groups, earlier)
    there = _there(earlier, recorded)
    every = plan.in_scan_order(np.argwhere(np.ones(plan.shape[:3], np.bool_)))
    if len(there):
        flat = [np.ravel_multi_index(tuple(index.T), plan.shape[:3]) for index in (every, plan.in_scan_order(there))]
        every = every[~np.isin(*flat)]
    if count > len(every):
        raise InputError.expected(
            "positions to record", f"at most the {len(every)} remaining positions", count, "choose fewer positions"
        )
    looked = max(candidates or len(every), count)
    index = every[spread_out(every, looked, plan.period)] if looked < len(every) else every
    information = yield from iter_information(plan, index, setup, groups, expected, workers=workers)
    if earlier is not None:
        information = replace(information, prior=information.prior + earlier.information(information.unknowns))
    clock = Clock("choose positions", 3)
    yield clock.at(0)
    start = Chosen(information).error
    aside = held_out_rows(index, _aside(count), plan, there)
    rows = choose(information, count - len(aside), np.setdiff1d(np.arange(len(index)), aside))
    yield clock.at(1)
    rates = {"stage_um_per_s": stage_um_per_s, "frames_per_s": frames_per_s}
    curve = tuple(
        _point(information, plan, rows, aside, int(n), rates)
        for n in np.unique(np.geomspace(FEWEST, count, POINTS).round())
    )
    yield clock.at(2)
    whole = Chosen(information)
    whole.add(*rows)
    spread = np.sqrt(np.diag(whole.covariance))
    sigmas = {one.name: one.sigma_of(0.0, float(s)) for one, s in zip(information.unknowns, spread, strict=True)}
    yield clock.at(3)
    before = start if earlier is not None else None
    return PositionDesign(index[rows], index[aside], curve, information.pattern_error, before, sigmas, len(index))


next_positions = drained(iter_next_positions)


def _start(
    plan: ScanPlan, setup: Setup | None, groups: Sequence[str] | None, earlier: Earlier | None
) -> tuple[Setup, tuple[str, ...]]:
    core = tuple(group.name for group in GROUPS if group.core)
    own = setup
    if earlier is not None:
        earlier.check_plan(plan)
        own, core = setup or earlier.setup, earlier.groups
    own = own or Setup(plan.camera, starting_effects(plan), (0.0,) * plan.shape[0])
    check_groups(own, plan, groups or ())
    return own, tuple(groups or core)


def _there(earlier: Earlier | None, recorded: NDArray[np.intp] | None) -> NDArray[np.intp]:
    empty = np.zeros((0, 3), np.intp)
    return np.concatenate([empty if earlier is None else earlier.positions, empty if recorded is None else recorded])


def _aside(count: int) -> int:
    return max(1, round(HELD_OUT_SHARE * count))


def _point(
    information: Information,
    plan: ScanPlan,
    rows: list[int],
    aside: NDArray[np.intp],
    count: int,
    rates: dict[str, Any],
) -> CurvePoint:
    """Return the expected result of the first ``count`` positions, and of the same number spread evenly."""
    apart = min(_aside(count), len(aside))
    own = rows[: count - apart]
    spread = spread_out(information.index, count, plan.period)
    kept = held_out_rows(information.index[spread], apart, plan)
    errors = []
    for used in (own, np.delete(spread, kept).tolist()):
        chosen = Chosen(information)
        chosen.add(*used)
        errors.append(chosen.error)
    places = plan.in_scan_order(np.concatenate([information.index[own], information.index[aside[:apart]]]))
    hours = Forecast.of(plan, **rates, positions=places).hours
    return CurvePoint(count, errors[0], errors[1], hours)


def draw_design(design: PositionDesign, path: str | os.PathLike[str], positions: int, hours: float) -> None:
    """Draw the expected error of H for the chosen positions, and for the same number spread evenly.

    Parameters
    ----------
    design
        The chosen positions.
    path
        Image file to write; the suffix determines the format.
    positions, hours
        Number of positions and recording time (h) of the complete scan, in which each pattern keeps its noise.
    """
    with figure(9.6, 4.0) as fig:
        left, right = fig.subplots(1, 2, sharey=True)
        counts = [point.positions for point in design.curve]
        minutes = [60 * point.hours for point in design.curve]
        chosen = [100 * point.error for point in design.curve]
        spread = [100 * point.spread_error for point in design.curve]
        left.plot(counts, chosen, "o-", color=LINES[0], label="chosen")
        left.plot(counts, spread, "s--", color=LINES[1], label="spread evenly")
        left.plot(
            [positions], [100 * design.pattern_error], "D", color=LINES[6], label="whole scan, noise of each pattern"
        )
        left.set(xlabel="positions recorded", ylabel="expected error of H (%, relative L2)")
        right.plot(minutes, chosen, "o-", color=LINES[0])
        right.plot([60 * hours], [100 * design.pattern_error], "D", color=LINES[6])
        right.set(xlabel="time on the stage (min)")
        if design.start_error is not None:
            for panel in (left, right):
                panel.axhline(100 * design.start_error, color=LINES[2], lw=1, ls=":", label="after the earlier fit")
        for panel in (left, right):
            panel.set(xscale="log", yscale="log")
            for axis in (panel.xaxis, panel.yaxis):
                for which in (axis.set_major_formatter, axis.set_minor_formatter):
                    which(lambda value, _: f"{value:g}" if f"{value:e}"[0] in "125" else "")
        left.legend()
        save_figure(fig, path)
