"""Fits of one camera over months: what has moved, how fast, and what has jumped."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lfcal.base import COLOURS, LINES, InputError, check_number
from lfcal.judge.dated import Dated
from lfcal.judge.quality import SHORTEST_S, TOO_SHORT, months_since_first, panels_over_time

__all__ = ["Jump", "ParameterDrift", "Trend", "TrendPoint", "draw_trend", "trend"]

SIGMAS = 5.0
"""Standard deviations by which a parameter must have changed to have moved."""

AS_DISTANCE = ("gap_um", "f_number", "focal_0_um", "focal_1_um", "focal_2_um")
"""What a source that is nearer or farther than described looks like."""

SHIFTS = {"offset_y_um": 1, "offset_x_um": 0}
"""Parameters that are told from the description of each fit; what is compared are places of the array."""

PLANNED = ("distance", "depths")
"""Groups of unknowns that are told from the planned depths."""


@dataclass(frozen=True, slots=True)
class TrendPoint:
    """A parameter at one time; ``compared`` says whether its value means the same as that of the newest fit."""

    fit: str
    when: datetime
    value: float
    sigma: float
    compared: bool


@dataclass(frozen=True, slots=True)
class Jump:
    """A change between two fits, one after the other, and how many standard deviations of both it is."""

    before: str
    after: str
    change: float
    sigmas: float


@dataclass(frozen=True, slots=True)
class ParameterDrift:
    """One parameter over time.

    Attributes
    ----------
    name, unit, group
        Of the parameter.
    points
        Its values, oldest first.
    span_s
        Time from the first that is compared to the last (s); NaN where fewer than two are.
    per_month, per_month_sigma
        Slope of the line through them; NaN where they are fewer than two, or lie within less than a week.
    change, change_sigmas
        Of the newest against the oldest, and in standard deviations of both.
    jumps
        Changes from one fit to the next beyond the limit.
    moved
        Whether it jumped, or the slope or the change as a whole is beyond the limit.
    """

    name: str
    unit: str
    group: str
    points: tuple[TrendPoint, ...]
    span_s: float
    per_month: float
    per_month_sigma: float
    change: float
    change_sigmas: float
    jumps: tuple[Jump, ...]
    moved: bool


@dataclass(frozen=True, eq=False)
class Trend:
    """All parameters of a camera over time.

    Attributes
    ----------
    fits
        Oldest first.
    drifts
        Of every parameter.
    limit
        Standard deviations beyond which a parameter has moved.
    notes
        What the numbers do not say.
    """

    fits: tuple[Dated, ...]
    drifts: tuple[ParameterDrift, ...]
    limit: float
    notes: tuple[str, ...]

    @property
    def moved(self) -> tuple[ParameterDrift, ...]:
        """The parameters that have moved."""
        return tuple(one for one in self.drifts if one.moved)


def trend(fits: Sequence[Dated], sigmas: float = SIGMAS) -> Trend:
    """Return how the parameters of a camera changed from fit to fit.

    Values are compared where they mean the same: found beside the same groups of unknowns as the newest fit's, and from
    the same planned depths where they are told from these. Offsets are told from each fit's own description; what is
    compared is where the array lies about the scanned region's middle.

    Parameters
    ----------
    fits
        Two or more of one camera, in any order.
    sigmas
        Standard deviations of both values beyond which a change is none of noise.

    Raises
    ------
    InputError
        If there are fewer than two, of several cameras, or two of the same time.
    """
    check_number("standard deviations of an alarm", sigmas, above=0)
    if len(fits) < 2:
        raise InputError.expected("fits", "two or more", len(fits), "name fits of several days")
    ordered = tuple(sorted(fits, key=lambda one: one.when))
    _check_one_camera(ordered)
    newest = ordered[-1]
    names = list(dict.fromkeys(name for one in reversed(ordered) for name in one.values))
    drifts = tuple(_drift(name, ordered, sigmas) for name in names)
    notes = []
    other = [one.label for one in ordered if one.groups != newest.groups]
    if other:
        notes.append(f"{', '.join(other)}: other unknowns than the newest fit's; not compared, fit with the same ones")
    unknown = [one.label for one in ordered if one.recorded is None]
    if unknown:
        notes.append(f"{', '.join(unknown)}: no date; the file's own time is taken")
    late = [one.label for one in ordered if one.recorded is False]
    if late:
        notes.append(f"{', '.join(late)}: dated by the fit; when the frames were recorded is not known")
    poor = [one.label for one in ordered if not one.complete]
    if poor:
        notes.append(f"{', '.join(poor)}: the model was incomplete; values may be off by more than their sigmas")
    if any(drift.span_s < SHORTEST_S for drift in drifts):
        notes.append(TOO_SHORT)
    if "distance" not in newest.groups and any(drift.moved and drift.name in AS_DISTANCE for drift in drifts):
        notes.append(
            "distance was held in these fits: a point source that is not always as far away looks alike; fit it, too "
            "(--unknowns with distance)"
        )
    return Trend(ordered, drifts, sigmas, tuple(notes))


def _check_one_camera(fits: Sequence[Dated]) -> None:
    first = fits[0].camera
    for one in fits[1:]:
        camera = one.camera
        same = camera.name == first.name and camera.sensor.shape == first.sensor.shape
        same = same and camera.sensor.pixel_um == first.sensor.pixel_um
        if not (same and len(camera.lattice.types) == len(first.lattice.types)):
            names = " and ".join(f"{c.name} {c.sensor.shape}" for c in (first, camera))
            raise InputError.expected("fits", "of one camera", names, f"leave out {one.label}")
        if any(abs(one.when - other.when).total_seconds() < 1 and one is not other for other in fits):
            raise InputError.expected("fits", "one at a time", f"{one.label} as old as another", "name each fit once")


def _drift(name: str, fits: Sequence[Dated], sigmas: float) -> ParameterDrift:
    own = [one for one in fits if name in one.values]
    newest = fits[-1]
    points = tuple(
        TrendPoint(one.label, one.when, _value(name, one, newest), one.values[name][1], _same(name, one, newest))
        for one in own
    )
    used = [point for point in points if point.compared]
    unit, group = own[-1].units[name], own[-1].groups_of[name]
    if len(used) < 2:
        return ParameterDrift(name, unit, group, points, math.nan, math.nan, math.nan, math.nan, math.nan, (), False)
    pairs = [(a, b, _apart(a, b)) for a, b in pairwise(used)]
    jumps = tuple(Jump(a.fit, b.fit, b.value - a.value, far) for a, b, far in pairs if abs(far) > sigmas)
    whole = _apart(used[0], used[-1])
    slope, error = _slope(used)
    moved = bool(jumps) or abs(whole) > sigmas or (len(used) > 2 and error > 0 and abs(slope) > sigmas * error)
    span = (used[-1].when - used[0].when).total_seconds()
    rate = (slope, error) if span >= SHORTEST_S else (math.nan, math.nan)
    return ParameterDrift(name, unit, group, points, span, *rate, used[-1].value - used[0].value, whole, jumps, moved)


def _same(name: str, one: Dated, newest: Dated) -> bool:
    """Return whether a value means the same as the newest fit's."""
    if one.groups != newest.groups or name not in newest.values:
        return False
    return one.groups_of[name] not in PLANNED or one.depths_um == newest.depths_um


def _value(name: str, one: Dated, newest: Dated) -> float:
    """Return a parameter's value; of an offset, how far the array lies from where the newest fit has it."""
    if name not in SHIFTS:
        return one.values[name][0]
    middle = np.array(newest.middle_um)
    there, here = newest.camera.lattice, one.camera.lattice
    q, r = np.rint(there.lenslet_at(middle))
    at = there.centres_um(q, r)
    k = np.rint(here.lenslet_at(at))
    moved: NDArray[np.float64] = here.centres_um(k[0], k[1]) - at
    return float(moved[SHIFTS[name]])


def _apart(a: TrendPoint, b: TrendPoint) -> float:
    """Return the change from one value to another in standard deviations of both."""
    spread = math.hypot(a.sigma, b.sigma)
    change = b.value - a.value
    return change / spread if spread > 0 else math.copysign(math.inf, change) if change else 0.0


def _slope(points: Sequence[TrendPoint]) -> tuple[float, float]:
    """Return slope per month and its standard deviation, by weighted least squares.

    Where values scatter about the line by more than their own standard deviations, the scatter counts.
    """
    months = months_since_first([point.when for point in points])
    values = np.array([point.value for point in points])
    weight = 1.0 / np.maximum([point.sigma for point in points], 1e-300)
    a = np.stack([np.ones(len(months)), months], axis=1) * weight[:, None]
    inverse = np.linalg.pinv(a.T @ a, rcond=1e-15, hermitian=True)
    found = inverse @ (a.T @ (values * weight))
    left = float(np.square(values * weight - a @ found).sum()) / max(1, len(points) - 2)
    grown = math.sqrt(max(1.0, left)) if len(points) > 2 else 1.0
    slope, sigma = float(found[1]), grown * math.sqrt(max(0.0, float(inverse[1, 1])))
    # what rounding leaves of values that are the same
    return (slope if abs(slope) > 1e-9 * sigma else 0.0), sigma


def draw_trend(found: Trend, path: str | os.PathLike[str]) -> None:
    """Draw every parameter over time with its standard deviation; values that are not compared are grey."""
    with panels_over_time(len(found.drifts), path) as panels:
        for panel, drift in zip(panels, found.drifts, strict=True):
            for compared, colour in ((False, COLOURS["muted"]), (True, COLOURS["bad"] if drift.moved else LINES[0])):
                own = [point for point in drift.points if point.compared is compared]
                if own:
                    panel.errorbar(
                        [point.when for point in own],
                        [point.value for point in own],
                        yerr=[point.sigma for point in own],
                        fmt="o-" if compared else "o",
                        color=colour,
                        markersize=3,
                        linewidth=0.8,
                        capsize=2,
                    )
            panel.set_title(drift.name + (": moved" if drift.moved else ""))
            panel.set_ylabel(drift.unit)
