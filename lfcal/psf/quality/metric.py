"""A metric: what it measures, when it is good or bad, what it costs and what to do about it."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

__all__ = ["Merit", "Metric", "Spec", "judge"]

Merit = Literal["good", "fair", "bad", "unknown"]
Plot = Literal["map", "planes", "sum", "table"]


@dataclass(frozen=True, slots=True)
class Spec:
    """One line of the catalogue.

    Attributes
    ----------
    key, title, unit
        Name in JSON, name for people, unit of the value (empty: a number).
    good, bad
        Up to ``good`` a value is good, beyond ``bad`` it is bad, fair between; the other way round where
        ``higher_is_better``.
    cost
        Error that a value at ``bad`` makes in a reconstruction: NRMSE against the ideal H.
    worst
        Cost it cannot exceed.
    plot
        What shows it: a map over positions, a curve over planes, the depth-plane sum, or the table alone.
    meaning, advice
        What it says, and what to do when it is bad.
    overall
        How planes make the overall value: the ``worst`` of them, or their ``sum``.
    higher_is_better
        Whether larger values are better.
    redo
        Whether the positions it names should be recorded again.
    per_frame
        The value counts frames; the cost grows with the root of their share and is ``cost`` where all are.
    """

    key: str
    title: str
    unit: str
    good: float
    bad: float
    cost: float
    worst: float
    plot: Plot
    meaning: str
    advice: str
    overall: Literal["worst", "sum"] = "worst"
    higher_is_better: bool = False
    redo: bool = False
    per_frame: bool = False

    def merit(self, value: float) -> Merit:
        """Return what ``value`` is worth; NaN is unknown."""
        if math.isnan(value):
            return "unknown"
        sign = -1.0 if self.higher_is_better else 1.0
        if sign * value <= sign * self.good:
            return "good"
        return "bad" if sign * value > sign * self.bad else "fair"

    def expense(self, value: float, frames: int = 1) -> float:
        """Return the reconstruction error estimated for ``value`` of H with so many frames, up to ``worst``."""
        if math.isnan(value) or self.merit(value) == "good":
            return 0.0
        if self.per_frame:
            return min(self.worst, self.cost * math.sqrt(value / max(1, frames)))
        if self.higher_is_better:
            share = self.bad / value if value > 0 else math.inf
        else:
            share = abs(value) / self.bad if self.bad > 0 else abs(value)
        return min(self.worst, self.cost * share)


@dataclass(frozen=True, slots=True, eq=False)
class Metric:
    """A measured `Spec`.

    Attributes
    ----------
    spec
        What was measured.
    value, merit
        Overall value (NaN: could not be measured) and what it is worth.
    cost
        Estimated reconstruction error (NRMSE).
    per_plane
        Value of each plane ``(nz,)``; NaN where not measured, empty where planes have none.
    map
        Value per position ``(nz, ny, nx)``, or None.
    positions
        Positions it names, ``(n, 3)`` as (z, y, x).
    detail
        What was found, in words; may be empty.
    """

    spec: Spec
    value: float
    merit: Merit
    cost: float
    per_plane: NDArray[np.float64]
    map: NDArray[np.float32] | None = None
    positions: NDArray[np.intp] = field(default_factory=lambda: np.empty((0, 3), np.intp))
    detail: str = ""

    @property
    def key(self) -> str:
        """Name in JSON."""
        return self.spec.key

    @property
    def text(self) -> str:
        """Value with its unit, for people."""
        if math.isnan(self.value):
            return "not measured"
        digits = (
            f"{self.value:.0f}" if self.value == round(self.value) and abs(self.value) < 1e6 else f"{self.value:.3g}"
        )
        return f"{digits} {self.spec.unit}".strip()

    @property
    def limits(self) -> str:
        """Thresholds, for people."""
        better, worse = ("≥", "<") if self.spec.higher_is_better else ("≤", ">")
        unit = f" {self.spec.unit}" if self.spec.unit else ""
        return f"{better} {self.spec.good:g}{unit} good, {worse} {self.spec.bad:g}{unit} bad"

    def to_dict(self) -> dict[str, object]:
        """Return the metric as plain values, positions included and maps left out."""
        return {
            "key": self.key,
            "title": self.spec.title,
            "value": self.value,
            "unit": self.spec.unit,
            "merit": self.merit,
            "good": self.spec.good,
            "bad": self.spec.bad,
            "higher_is_better": self.spec.higher_is_better,
            "cost": self.cost,
            "plot": self.spec.plot,
            "per_plane": self.per_plane.tolist(),
            "positions": self.positions.tolist(),
            "detail": self.detail,
            "meaning": self.spec.meaning,
            "advice": self.spec.advice if self.merit != "good" else "",
        }


def judge(
    spec: Spec,
    per_plane: NDArray[np.float64],
    frames: int,
    *,
    map: NDArray[np.float32] | None = None,
    positions: NDArray[np.intp] | None = None,
    detail: str = "",
) -> Metric:
    """Return the metric of values per plane ``(nz,)``, of which NaN were not measured, of an H with so many frames."""
    known = per_plane[~np.isnan(per_plane)]
    if not known.size:
        value = math.nan
    elif spec.overall == "sum":
        value = float(known.sum())
    else:
        value = float(known.min() if spec.higher_is_better else known.max())
    at = np.empty((0, 3), np.intp) if positions is None else positions
    return Metric(spec, value, spec.merit(value), spec.expense(value, frames), per_plane, map, at, detail)
