"""Findings of metrics about an H, and the number of metrics with each rating."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from lfcal.base import RANK, Finding, Merit
from lfcal.judge.quality.metric import BAD, FAIR, Metric

__all__ = ["BAD", "FAIR", "counted", "counted_words", "findings_of", "merit_of", "merit_word", "where"]

PLACES = 3
"""Number of positions that a finding lists."""


def merit_of(metric: Metric) -> Merit:
    """Return the rating of an H according to a metric, such as ``"good"``.

    A metric of single frames is rated by its cost, because these frames can be recorded again.
    """
    if metric.merit in ("bad", "fair") and metric.spec.by_cost and len(metric.positions):
        return "bad" if metric.cost >= BAD else "fair" if metric.cost >= FAIR else "good"
    return metric.merit


def merit_word(metric: Metric) -> str:
    """Return the rating of a metric for a table, or "repeat" if H is good except for positions to record again."""
    return "repeat" if merit_of(metric) == "good" != metric.merit else merit_of(metric)


def findings_of(metrics: Iterable[Metric], shape: Sequence[int]) -> tuple[Finding, ...]:
    """Return the findings of bad and fair metrics about an H of ``shape`` ``(nz, ny, nx, ...)``, the worst first."""
    found = (_finding(m, math.prod(shape[:3])) for m in metrics if m.merit in ("bad", "fair"))
    return tuple(sorted(found, key=lambda one: RANK[one.merit]))


def _finding(metric: Metric, frames: int) -> Finding:
    spec = metric.spec
    named = spec.verdict_detail and metric.detail and not math.isnan(metric.value)
    cost = ""
    if metric.cost > 0:
        cost = f"{metric.cost:.3f} (NRMSE)" if metric.measured else f"{metric.cost:.2g} (NRMSE, typical)"
    return Finding(
        kind=spec.key,
        what=metric.detail if named else spec.title.lower(),
        subject=spec.subject,
        detail=metric.text if named or not metric.detail else f"{metric.text}, {metric.detail}",
        where=where(metric.positions.tolist(), frames),
        positions=tuple(map(tuple, metric.positions.tolist())),
        size=metric.value,
        limit=spec.limits.bad if metric.merit == "bad" else spec.limits.good,
        cost=None if math.isnan(metric.cost) else metric.cost,
        cost_words=cost,
        remedy=spec.advice,
        merit=merit_of(metric),
        repeat=len(metric.positions) if spec.redo else 0,
    )


def where(positions: Sequence[Sequence[int]], frames: int) -> str:
    """Return the number of affected positions and the first of them (z, y, x) as text; empty if there are none.

    ``frames`` is the number of all positions; if all are affected, none is named.
    """
    if not positions:
        return ""
    if len(positions) >= frames:
        return "all positions"
    first = ", ".join(f"({', '.join(map(str, place))})" for place in positions[:PLACES])
    more = " …" if len(positions) > PLACES else ""
    return f"{len(positions):,} of {frames:,} positions (z, y, x): {first}{more}"


def counted(metrics: Iterable[Metric]) -> dict[str, int]:
    """Return the number of metrics with each rating, and the number of metrics that do not apply.

    The keys are ``"bad"``, ``"fair"``, ``"good"``, ``"unknown"`` and ``"not_applicable"``.
    """
    found = dict.fromkeys(("bad", "fair", "good", "unknown", "not_applicable"), 0)
    for metric in metrics:
        found[merit_of(metric) if metric.applies else "not_applicable"] += 1
    return found


def counted_words(metrics: Iterable[Metric]) -> str:
    """Return the numbers of `counted` as text, such as ``26 good, 12 not applicable``."""
    found = counted(metrics)
    shown = [f"{many} {key.replace('_', ' ')}" for key, many in found.items() if many or key == "good"]
    return ", ".join(shown)
