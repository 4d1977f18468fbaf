"""Which positions to record next: those that lower the expected error of H most (I-optimal design)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, check_number, drained
from lfcal.camera import Forecast, ScanPlan
from lfcal.fit._chosen import Chosen, choose
from lfcal.fit._lacking import check_groups
from lfcal.fit.earlier import Earlier
from lfcal.fit.information import Expected, Information, iter_information
from lfcal.fit.parameters import GROUPS
from lfcal.fit.setup import Setup, called_for
from lfcal.fit.spread import kept_aside, spread_out

__all__ = ["CurvePoint", "PositionDesign", "iter_next_positions", "next_positions"]

KEPT_ASIDE = 0.2
"""Share of the positions that are spread evenly and never fitted: they tell how good the fit is."""

CANDIDATES = 300
"""Positions that are looked at, spread evenly over a larger scan: their number is most of the time."""

FEWEST = 3
"""Fewest positions from which anything is told."""

POINTS = 12
"""Points of the curve of errors."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """What some frames are expected to come to.

    Attributes
    ----------
    positions
        Positions recorded, those kept aside among them.
    error
        Expected relative error (L2) of H from the positions chosen.
    spread_error
        The same from as many positions spread evenly.
    hours
        Time on the stage (h).
    """

    positions: int
    error: float
    spread_error: float
    hours: float


@dataclass(frozen=True, eq=False)
class PositionDesign:
    """Positions to record, and what to expect of them.

    Attributes
    ----------
    fitted
        Positions ``(n, 3)`` as (z, y, x) that lower the error, the most useful first.
    kept_aside
        Positions ``(m, 3)`` that are never fitted, spread evenly.
    curve
        Expected errors against positions; the last point is all of them.
    pattern_error
        Relative error (L2) of an H whose every position was recorded once: the noise of a pattern.
    start_error
        Expected error before any of them is recorded; None where nothing was fitted yet.
    sigmas
        Expected standard deviation of each unknown by name, in its unit.
    candidates
        How many positions were looked at.
    """

    fitted: NDArray[np.intp]
    kept_aside: NDArray[np.intp]
    curve: tuple[CurvePoint, ...]
    pattern_error: float
    start_error: float | None
    sigmas: dict[str, float]
    candidates: int

    @property
    def positions(self) -> NDArray[np.intp]:
        """All positions to record ``(n + m, 3)``."""
        return np.concatenate([self.fitted, self.kept_aside])

    def enough_for(self, error: float) -> CurvePoint | None:
        """Return the first point of the curve whose expected error is at most ``error``, or None."""
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
    workers: int | None = None,
) -> Work[PositionDesign]:
    """Return the positions to record next by what they do to the error of H.

    I-optimal design: with the covariance C of the unknowns that the patterns give, and the mean M of the outer
    products of the model's derivatives over all positions and depths, the squared error of H is trace(C M).

    Parameters
    ----------
    plan
        The scan.
    count
        How many, a fifth of them spread evenly and kept aside.
    setup
        The camera as supposed; None takes that of ``earlier``, or the plan's.
    groups
        Groups of unknowns; None takes those of ``earlier``, or gap, rotation and offset, focal lengths and iris.
    earlier
        A fit whose covariance is known beforehand; its positions are not chosen again.
    recorded
        Further positions ``(n, 3)`` that are there already.
    expected
        Light and steadiness; None: the brightest pixel at 80 % of the full well, sources at their places.
    candidates
        How many positions are looked at, spread evenly; 0: all.
    stage_um_per_s
        Speed of the stage, for the hours.
    workers
        Threads; None takes every processor.

    Yields
    ------
    Progress
        In patterns, then in positions.

    Raises
    ------
    InputError
        If there are not so many positions left, or ``earlier`` is of another scan.
    """
    expected = expected or Expected()
    check_number("positions to record", count, at_least=FEWEST, integer=True)
    check_number("positions that are looked at", candidates, at_least=0, integer=True)
    setup, groups = _start(plan, setup, groups, earlier)
    there = _there(earlier, recorded)
    every = plan.in_scan_order(np.argwhere(np.ones(plan.shape[:3], np.bool_)))
    if len(there):
        flat = [np.ravel_multi_index(tuple(index.T), plan.shape[:3]) for index in (every, plan.in_scan_order(there))]
        every = every[~np.isin(*flat)]
    if count > len(every):
        raise InputError.expected("positions to record", f"at most the {len(every)} left", count, "take fewer")
    looked = max(candidates or len(every), count)
    index = every[spread_out(every, looked, plan.period)] if looked < len(every) else every
    told = yield from iter_information(plan, index, setup, groups, expected, workers=workers)
    if earlier is not None:
        told = replace(told, prior=told.prior + earlier.information(told.unknowns))
    clock = Clock("choose positions", 3)
    yield clock.at(0)
    start = Chosen(told).error
    aside = kept_aside(index, _aside(count), plan, there)
    rows = choose(told, count - len(aside), np.setdiff1d(np.arange(len(index)), aside))
    yield clock.at(1)
    curve = tuple(
        _point(told, plan, rows, aside, int(n), stage_um_per_s)
        for n in np.unique(np.geomspace(FEWEST, count, POINTS).round())
    )
    yield clock.at(2)
    whole = Chosen(told)
    whole.add(*rows)
    spread = np.sqrt(np.diag(whole.covariance))
    sigmas = {one.name: one.sigma_of(0.0, float(s)) for one, s in zip(told.unknowns, spread, strict=True)}
    yield clock.at(3)
    before = start if earlier is not None else None
    return PositionDesign(index[rows], index[aside], curve, told.pattern_error, before, sigmas, len(index))


next_positions = drained(iter_next_positions)


def _start(
    plan: ScanPlan, setup: Setup | None, groups: Sequence[str] | None, earlier: Earlier | None
) -> tuple[Setup, tuple[str, ...]]:
    core = tuple(group.name for group in GROUPS if group.core)
    own = setup
    if earlier is not None:
        earlier.check_plan(plan)
        own, core = setup or earlier.setup, earlier.groups
    own = own or Setup(plan.camera, called_for(plan), (0.0,) * plan.shape[0])
    check_groups(own, plan, groups or ())
    return own, tuple(groups or core)


def _there(earlier: Earlier | None, recorded: NDArray[np.intp] | None) -> NDArray[np.intp]:
    empty = np.zeros((0, 3), np.intp)
    return np.concatenate([empty if earlier is None else earlier.positions, empty if recorded is None else recorded])


def _aside(count: int) -> int:
    return max(1, round(KEPT_ASIDE * count))


def _point(
    told: Information, plan: ScanPlan, rows: list[int], aside: NDArray[np.intp], count: int, speed: float
) -> CurvePoint:
    """Return what the first ``count`` positions are expected to come to, and as many spread evenly."""
    apart = min(_aside(count), len(aside))
    own = rows[: count - apart]
    spread = spread_out(told.index, count, plan.period)
    kept = kept_aside(told.index[spread], apart, plan)
    errors = []
    for used in (own, np.delete(spread, kept).tolist()):
        chosen = Chosen(told)
        chosen.add(*used)
        errors.append(chosen.error)
    places = plan.in_scan_order(np.concatenate([told.index[own], told.index[aside[:apart]]]))
    hours = Forecast.of(plan, stage_um_per_s=speed, positions=places).hours
    return CurvePoint(count, errors[0], errors[1], hours)
