"""Definition of a quality metric: measurement, limits, cost and remedy."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfcal.base import SUBJECTS, Merit, format_number
from lfcal.judge.quality.across import MatrixMeasures
from lfcal.judge.quality.measure import PlaneMeasures

__all__ = ["UNKNOWN", "CostModel", "Limits", "Metric", "MetricSpec", "Reading", "judge"]

Plot = Literal["map", "planes", "sum", "table"]


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """Value of a metric for one plane.

    Attributes
    ----------
    value
        Value in the unit of the metric; NaN if unknown.
    map
        Value at each position, ``(ny, nx)``. None: not measured.
    positions
        Mask ``(ny, nx)``, True at affected positions. None: not determined.
    detail
        Details as text; may be empty.
    cost
        Resulting error of a reconstruction (NRMSE), if measured for this plane; NaN: `CostModel` determines it.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge.quality import UNKNOWN, Reading
    >>> weak = np.array([[False, True], [False, False]])
    >>> found = Reading(float(weak.sum()), positions=weak, detail="one dim frame")
    >>> print(found.value, found.detail, UNKNOWN.value)
    1.0 one dim frame nan
    """

    value: float = math.nan
    map: NDArray[np.float64] | None = None
    positions: NDArray[np.bool_] | None = None
    detail: str = ""
    cost: float = math.nan


FAIR, BAD = 0.03, 0.1
"""Thresholds of the cost of a fault (NRMSE): above the first, examine H; above the second, do not use it."""

LARGEST = 1.0
"""Error of a volume that has nothing in common with the true one, which is the largest possible error."""

COUNTED = ("frames", "pixels", "planes")
"""Units that are counted; for the value 1 they are written without the final s."""

UNKNOWN = Reading()
"""Value of a metric that could not be measured; zero would mean a good value."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits for the rating of a value: "good" up to ``good``, "bad" beyond ``bad``, and "fair" in between.

    If ``higher_is_better``, values are "good" from ``good`` upwards, and "bad" below ``bad``.

    Examples
    --------
    >>> from lfcal.judge.quality import Limits
    >>> limits = Limits(good=1.0, bad=3.0)
    >>> [limits.merit(value) for value in (0.5, 2.0, 4.0, float("nan"))]
    ['good', 'fair', 'bad', 'unknown']
    """

    good: float
    bad: float
    higher_is_better: bool = False

    def __post_init__(self) -> None:
        """Check the order of the limits."""
        sign = -1.0 if self.higher_is_better else 1.0
        if not sign * self.good <= sign * self.bad:
            raise ValueError(f"limits: good ({self.good}) must not be worse than bad ({self.bad}); exchange them")

    def merit(self, value: float) -> Merit:
        """Return the rating of ``value``: "good", "fair" or "bad"; "unknown" for NaN."""
        if math.isnan(value):
            return "unknown"
        sign = -1.0 if self.higher_is_better else 1.0
        if sign * value <= sign * self.good:
            return "good"
        return "bad" if sign * value > sign * self.bad else "fair"


@dataclass(frozen=True, slots=True)
class CostModel:
    """Model of the cost of a metric: the error (NRMSE) of a reconstruction, relative to one with an ideal H.

    Attributes
    ----------
    at_bad
        Cost of a value at the limit ``bad`` of `Limits`. A good value costs nothing. Otherwise, the cost is
        proportional to the value, or inversely proportional if higher values are better.
    worst
        Largest possible cost.
    per_frame
        Whether the value is a number of affected frames. The cost is then ``at_bad`` times the square root of their
        fraction.

    Examples
    --------
    >>> from lfcal.judge.quality import CostModel, Limits
    >>> cost, limits = CostModel(at_bad=0.1, worst=0.5), Limits(good=1.0, bad=2.0)
    >>> [cost.of(value, limits) for value in (0.5, 2.0, 4.0, 100.0)]  # in proportion, 0.5 at most
    [0.0, 0.1, 0.2, 0.5]
    """

    at_bad: float
    worst: float
    per_frame: bool = False

    def of(self, value: float, limits: Limits, frames: int = 1) -> float:
        """Return the cost of ``value`` for an H of ``frames`` frames: 0 for a good value, NaN for an unknown one.

        ``limits`` are the limits of good and bad values.
        """
        merit = limits.merit(value)
        if merit in ("good", "unknown"):
            return 0.0 if merit == "good" else math.nan
        if self.per_frame:
            return min(self.worst, self.at_bad * math.sqrt(value / max(1, frames)))
        if limits.higher_is_better:
            share = limits.bad / value if value > 0 else math.inf
        else:
            # a limit of 0 has no proportion, so the value itself is the share
            share = abs(value) / limits.bad if limits.bad > 0 else abs(value)
        return min(self.worst, self.at_bad * share)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MetricSpec:
    """Description of a metric, with the function that measures it.

    Attributes
    ----------
    key, title, unit
        Name used in JSON, display name, and unit of the value (empty: dimensionless).
    subject
        Part of the recording that the metric concerns, one of `lfcal.base.SUBJECTS`.
    meaning, advice
        Meaning of the value, and remedy if it is bad, as sentences.
    limits, cost
        Limits of good and bad values, and the model of the cost.
    of_plane
        Function that takes the measurements of one plane, and returns a `Reading`. It is called while the patterns of
        the plane are in memory.
    of_matrix
        Function that takes the measurements of all planes; it is called once at the end. It returns one `Reading` for
        each plane, or a single one for H. A metric has exactly one of the two functions.
    needs_light
        Whether the value of a plane without light is unknown, so that ``of_plane`` is not called.
    needs_centre
        Whether the metric requires a pattern around the middle of the cutout. It then does not apply to separate
        elemental images.
    needs_all
        Whether one unknown plane makes a good overall value unknown, as for counts that must be complete.
    plot
        Display of the metric: a map over positions, a curve over planes, the depth-plane sum, or only an entry in the
        table.
    map_unit
        Unit of the value of one position, if it differs from the unit of the overall value.
    always_shown
        Whether a report draws the map of the metric even if the value is good.
    overall
        Calculation of the overall value from the values of the planes: ``"worst"`` or ``"sum"``.
    redo
        Whether the affected positions should be recorded again.
    verdict_detail
        Whether the verdict states the details of the value instead of the title.
    if_unknown
        Reason why the value may be unknown although the metric applies. Empty: an unknown value means that the metric
        does not apply.

    Examples
    --------
    >>> from lfcal.judge.quality import CostModel, Limits, MetricSpec, Reading
    >>> spec = MetricSpec(
    ...     key="energy",
    ...     title="Light",
    ...     meaning="Median energy of a pattern.",
    ...     advice="Expose for longer.",
    ...     limits=Limits(1000, 100, higher_is_better=True),
    ...     cost=CostModel(at_bad=0.1, worst=0.5),
    ...     of_plane=lambda plane: Reading(plane.energy),
    ... )
    >>> print(spec.name, spec.limits.merit(500), spec.cost.of(50, spec.limits))  # half of the limit: twice the cost
    energy fair 0.2
    """

    key: str
    title: str
    subject: str = "other"
    unit: str = ""
    meaning: str
    advice: str
    limits: Limits
    cost: CostModel
    of_plane: Callable[[PlaneMeasures], Reading] | None = None
    of_matrix: Callable[[MatrixMeasures], Sequence[Reading]] | None = None
    needs_light: bool = True
    needs_centre: bool = False
    needs_all: bool = False
    plot: Plot = "table"
    map_unit: str = ""
    always_shown: bool = False
    overall: Literal["worst", "sum"] = "worst"
    redo: bool = False
    verdict_detail: bool = False
    if_unknown: str = ""

    def __post_init__(self) -> None:
        """Check that there is exactly one function, and that no text is empty."""
        if (self.of_plane is None) == (self.of_matrix is None):
            raise ValueError(f"metric {self.key!r}: give one function, of_plane or of_matrix")
        for name in ("key", "title", "meaning", "advice"):
            if not getattr(self, name):
                raise ValueError(f"metric {self.key!r}: {name} is empty")
        if self.subject not in SUBJECTS:
            raise ValueError(f"metric {self.key!r}: subject {self.subject!r} is none of {', '.join(SUBJECTS)}")

    @property
    def name(self) -> str:
        """Same as ``key``; the registry requires this attribute."""
        return self.key

    @property
    def by_cost(self) -> bool:
        """Whether values that are not good are rated by their cost, because single frames can be recorded again."""
        return self.redo and self.cost.per_frame


@dataclass(frozen=True, slots=True, eq=False)
class Metric:
    """Measured value of a metric.

    Attributes
    ----------
    spec
        The metric.
    value, merit
        Overall value in the unit of ``spec`` (NaN: unknown), and its rating: ``"good"``, ``"fair"``, ``"bad"`` or
        ``"unknown"``.
    cost
        Estimated error of a reconstruction due to this value (NRMSE); NaN if the value is unknown.
    measured
        Whether the cost was measured on this H; if not, it is the typical cost of such a value.
    per_plane
        Value of each plane ``(nz,)``; NaN if unknown; a single value if planes have no separate values.
    map
        Value at each position, ``(nz, ny, nx)``. None: not measured.
    positions
        Affected positions (z, y, x), ``(n, 3)``.
    detail
        Details as text; may be empty.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix
    >>> from lfcal.judge import inspect
    >>> from lfcal.judge.quality import Metric
    >>> H = PSFMatrix(np.ones((1, 2, 2, 9, 9)), recorded=[[[1, 0], [1, 1]]])
    >>> missing: Metric = inspect(H)["missing"]
    >>> print(missing.text, missing.merit, missing.positions.tolist())
    1 frame bad [[0, 0, 1]]
    """

    spec: MetricSpec
    value: float
    merit: Merit
    cost: float
    per_plane: NDArray[np.float64]
    map: NDArray[np.float32] | None = None
    positions: NDArray[np.intp] = field(default_factory=lambda: np.empty((0, 3), np.intp))
    detail: str = ""
    measured: bool = False

    @property
    def key(self) -> str:
        """Name of the metric in JSON."""
        return self.spec.key

    @property
    def applies(self) -> bool:
        """Whether the metric has a result for this H: a value, or a reason why there is none."""
        return self.merit != "unknown" or bool(self.detail)

    @property
    def text(self) -> str:
        """Text with the value and its unit; "unknown" for NaN.

        An infinite value is shown as "∞": there is no noise to divide by, as in a simulated H.
        """
        if math.isnan(self.value):
            return "unknown"
        whole = float(self.value).is_integer() and abs(self.value) < 1e6
        digits = f"{self.value:.0f}" if whole else format_number(self.value).replace("inf", "∞")
        unit = self.spec.unit
        if digits == "1" and unit in COUNTED:
            unit = unit[:-1]
        return f"{digits} {unit}".strip()

    @property
    def cost_text(self) -> str:
        """Cost as text. A cost that was not measured is marked "typical"; if it is zero or unknown, it is a dash."""
        if self.measured:
            return f"{self.cost:.3f}"
        return f"{self.cost:.2g} typical" if self.cost > 0 else "—"

    @property
    def limits(self) -> str:
        """Text with the limits of good and bad values."""
        limits = self.spec.limits
        better, worse = ("at least", "less") if limits.higher_is_better else ("at most", "more")
        good, bad = (f"{one:g} {self.spec.unit}".strip() for one in (limits.good, limits.bad))
        if limits.good or limits.higher_is_better:
            good = f"{better} {good}"
        if self.spec.by_cost:
            return f"{good} is good; larger values are rated by their cost: fair from {FAIR:g}, bad from {BAD:g}"
        return f"{good} is good, {worse if limits.good == limits.bad else f'{worse} than {bad}'} is bad"

    def to_dict(self) -> dict[str, object]:
        """Return the metric as plain JSON types, with positions but without maps; NaN means unknown."""
        return {
            "key": self.key,
            "title": self.spec.title,
            "subject": self.spec.subject,
            "value": self.value,
            "unit": self.spec.unit,
            "merit": self.merit,
            "good": self.spec.limits.good,
            "bad": self.spec.limits.bad,
            "higher_is_better": self.spec.limits.higher_is_better,
            "cost": self.cost,
            "cost_is": "measured" if self.measured else "typical",
            "plot": self.spec.plot,
            "per_plane": self.per_plane.tolist(),
            "positions": self.positions.tolist(),
            "detail": self.detail,
            "meaning": self.spec.meaning,
            "advice": self.spec.advice if self.merit in ("bad", "fair") else "",
        }


def judge(spec: MetricSpec, readings: Sequence[Reading], shape: tuple[int, int, int]) -> Metric:
    """Return the metric of an H of ``shape`` ``(nz, ny, nx)`` from one reading for each plane, or a single one.

    Raises
    ------
    ValueError
        If the number of readings, a map or a mask does not match the shape, because the function of the metric is
        wrong.
    """
    nz, ny, nx = shape
    if len(readings) not in (1, nz):
        raise ValueError(f"metric {spec.key!r}: expected 1 or {nz} readings, got {len(readings)}")
    for reading in readings:
        for array in (reading.map, reading.positions):
            if array is not None and array.shape != (ny, nx):
                raise ValueError(f"metric {spec.key!r}: expected maps of {(ny, nx)} positions, got {array.shape}")
    per_plane = np.array([r.value for r in readings], float)
    value = _overall(spec, per_plane)
    named = np.zeros((len(readings), ny, nx), bool)
    for z, reading in enumerate(readings):
        if reading.positions is not None:
            named[z] = reading.positions
    return Metric(
        spec,
        value,
        spec.limits.merit(value),
        _cost(spec, value, readings, nz * ny * nx),
        per_plane,
        _maps(readings, (ny, nx)),
        np.argwhere(named),
        "; ".join(sorted({r.detail for r in readings} - {""})) or (spec.if_unknown if math.isnan(value) else ""),
    )


def _cost(spec: MetricSpec, value: float, readings: Sequence[Reading], frames: int) -> float:
    """Return the cost of a value: 0 if it is good, else the cost measured for the planes, or the typical one."""
    reported = [one.cost for one in readings if not math.isnan(one.cost)]
    typical = spec.cost.of(value, spec.limits, frames)
    if reported and typical > 0:
        typical = min(spec.cost.worst, math.sqrt(sum(cost**2 for cost in reported) / len(readings)))
    # NaN if the value is unknown
    return typical if math.isnan(typical) else min(LARGEST, typical)


def _overall(spec: MetricSpec, per_plane: NDArray[np.float64]) -> float:
    known = per_plane[~np.isnan(per_plane)]
    if not known.size:
        return math.nan
    if spec.overall == "sum":
        value = float(known.sum())
    else:
        value = float(known.min() if spec.limits.higher_is_better else known.max())
    # values of some planes are enough for a bad result, but not for a good one: an unknown plane may be worse
    incomplete = spec.needs_all and known.size < per_plane.size
    return math.nan if incomplete and spec.limits.merit(value) == "good" else value


def _maps(readings: Sequence[Reading], shape: tuple[int, int]) -> NDArray[np.float32] | None:
    if all(r.map is None for r in readings):
        return None
    blank = np.full(shape, np.nan)
    return np.stack([blank if r.map is None else r.map for r in readings]).astype(np.float32)
