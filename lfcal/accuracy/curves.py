"""Points of error and cost, and the curve of all points for one part of the processing."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from lfcal.base import check_choice, check_number, format_bytes, format_seconds, format_share

__all__ = ["UNITS", "CostPoint", "Curve", "cost_axis", "format_cost", "marked", "marks_of"]

UNITS = ("seconds", "bytes", "frames")
"""Units in which the cost of accuracy is measured."""

SHOWN = {"seconds": ("s", 1.0), "bytes": ("MB", 1e6), "frames": ("", 1.0)}
"""By unit of the cost: the unit on the axis of a chart, and its size in units of the cost."""


@dataclass(frozen=True, slots=True)
class CostPoint:
    """One point of a curve: a setting with its error and cost.

    Attributes
    ----------
    label
        Display name.
    settings
        Values of the settings by name, as plain JSON types.
    error
        Relative error, at least 0 (0.01 is 1 %); the curve states its meaning and reference.
    cost, unit
        Cost, and its unit, one of `UNITS`.
    others
        Further measured values by name, with the unit in the name: ``{"read (s)": 0.2}``.
    note
        Remark; may be empty.
    efficient
        Whether the point is on the Pareto front of its curve: all points that cost less or the same have larger errors.
        It is set by `marked`.
    in_use
        Whether the measured scan plan has these settings.

    Raises
    ------
    InputError
        If the error or the cost is negative or not finite, or the unit is not one of `UNITS`.

    Examples
    --------
    >>> from lfcal.accuracy import CostPoint
    >>> point = CostPoint("rounded to 16 bits", {"dtype": "rounded"}, error=0.001, cost=4e6, unit="bytes")
    >>> print(f"{point.label}: error {point.error:.1%}, {point.cost / 1e6:g} MB")
    rounded to 16 bits: error 0.1%, 4 MB
    """

    label: str
    settings: Mapping[str, Any]
    error: float
    cost: float
    unit: str
    others: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    efficient: bool = False
    in_use: bool = False

    def __post_init__(self) -> None:
        """Check that error and cost are finite and not negative."""
        check_choice("unit of cost", self.unit, UNITS)
        check_number(f"error of {self.label}", self.error, at_least=0)
        check_number(f"cost of {self.label}", self.cost, at_least=0)


@dataclass(frozen=True, slots=True)
class Curve:
    """Curve of error against cost for one part of the processing.

    Attributes
    ----------
    part, title
        Name of the part of the processing, and its display name.
    error, cost
        Meanings of the error and the cost, with units.
    unit
        Unit of the cost, one of `UNITS`.
    truth
        Description of the reference with which results are compared.
    points
        Measured points, cheapest first, with ``efficient`` set as by `marked`.
    notes
        Conditions of the measurement, one line each.
    stopped
        Reason why there are no further points; empty if all were measured.

    Examples
    --------
    >>> from lfcal.accuracy import Curve, CostPoint
    >>> curve = Curve("averaging", "Frames averaged", "noise over the signal", "frames at each position", "frames")
    >>> for n in (1, 4, 16, 64):
    ...     curve = curve.with_point(CostPoint(f"mean of {n}", {"frames": n}, 0.08 / n**0.5, n, "frames"))
    >>> print(curve.answer(0.02))
    An error of 2 % costs 16 frames: mean of 16 (2 %)
    >>> print(curve.answer(0.005))
    No measured setting reaches an error of 0.5 %; the best one has 1 % for 64 frames: mean of 64
    """

    part: str
    title: str
    error: str
    cost: str
    unit: str
    truth: str = ""
    points: tuple[CostPoint, ...] = ()
    notes: tuple[str, ...] = ()
    stopped: str = ""

    def with_point(self, point: CostPoint) -> Curve:
        """Return a copy of the curve with ``point`` added and the Pareto front updated."""
        return replace(self, points=marked((*self.points, point)))

    @property
    def front(self) -> tuple[CostPoint, ...]:
        """The points on the Pareto front, cheapest first: each costs more than the previous one for a smaller error."""
        return tuple(point for point in self.points if point.efficient)

    @property
    def in_use(self) -> CostPoint | None:
        """The first point with the settings of the scan plan (`CostPoint.in_use`); None if there is none."""
        return next((point for point in self.points if point.in_use), None)

    @property
    def best(self) -> CostPoint | None:
        """The most accurate point; of equally accurate points, the cheapest. None if there are no points."""
        return min(self.points, key=lambda point: (point.error, point.cost), default=None)

    def cheapest(self, error: float) -> CostPoint | None:
        """Return the cheapest point with a relative error of at most ``error``; None if there is none.

        Raises `InputError` unless ``error`` is above 0.
        """
        check_number("requested error (a fraction)", error, above=0, remedy="0.01 is 1 %")
        good = (point for point in self.points if point.error <= error)
        return min(good, key=lambda point: (point.cost, point.error), default=None)

    def error_text(self, error: float, *others: float) -> str:
        """Return a relative error as text in per cent.

        It has two digits, or up to six where these distinguish it from the errors of the points and from the relative
        errors ``others``.
        """
        return format_share(error, (*others, *(point.error for point in self.points)))

    def answer(self, error: float) -> str:
        """Return a sentence that states the lowest cost of a relative error of at most ``error``.

        If no point reaches this error, the sentence states the smallest error and its cost instead.
        """
        found, best, asked = self.cheapest(error), self.best, self.error_text(error)
        if found is not None:
            return (
                f"An error of {asked} costs {format_cost(found.cost, self.unit)}: {found.label} "
                f"({self.error_text(found.error, error)})"
            )
        if best is None:
            return f"Error of {asked}: nothing was measured" + (f" ({self.stopped})" if self.stopped else "")
        return (
            f"No measured setting reaches an error of {asked}; the best one has "
            f"{self.error_text(best.error, error)} "
            f"for {format_cost(best.cost, self.unit)}: {best.label}"
        )


def marked(points: Iterable[CostPoint]) -> tuple[CostPoint, ...]:
    """Return copies of the points, cheapest first, with ``efficient`` True for those on the Pareto front.

    A point is on the front if its error is smaller than that of all points before it in this order. Of equally
    expensive points, the most accurate comes first.

    Examples
    --------
    >>> from lfcal.accuracy import CostPoint, marked
    >>> measured = (("quick", 0.1, 1), ("slow", 0.2, 2), ("best", 0.05, 3))
    >>> points = marked(CostPoint(label, {}, error, seconds, "seconds") for label, error, seconds in measured)
    >>> print([point.label for point in points if point.efficient])
    ['quick', 'best']
    """
    lowest, out = math.inf, []
    for point in sorted(points, key=lambda r: (r.cost, r.error)):
        out.append(replace(point, efficient=point.error < lowest))
        lowest = min(lowest, point.error)
    return tuple(out)


def marks_of(point: CostPoint, chosen: CostPoint | None) -> tuple[str, ...]:
    """Return which of the marks "chosen", "in use" and "efficient" apply to ``point``.

    ``chosen`` is the chosen point, which must be the same object to match; None: no point is chosen.
    """
    marks = {"chosen": point is chosen, "in use": point.in_use, "efficient": point.efficient}
    return tuple(word for word, true in marks.items() if true)


def cost_axis(curve: Curve) -> tuple[str, float]:
    """Return the label of the cost axis of a chart, and the divisor that converts costs to the unit in the label."""
    unit, scale = SHOWN[curve.unit]
    name = curve.cost.split(",")[0]  # the whole text does not fit along an axis
    return f"{name} ({unit})" if unit else name, scale


def format_cost(cost: float, unit: str) -> str:
    """Return ``cost``, measured in ``unit`` (one of `UNITS`), as text such as ``'4.0 MB'``."""
    if unit == "seconds":
        return format_seconds(cost)
    return format_bytes(cost) if unit == "bytes" else f"{cost:.0f} frames"
