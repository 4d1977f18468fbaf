"""The verdict as sentences: what is wrong, where, what it costs, the remedy, and what remains after it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from lfcal.base import format_count
from lfcal.judge.quality.metric import RANK, Merit, Metric

__all__ = [
    "BAD",
    "FAIR",
    "QualityProblem",
    "counted",
    "counted_words",
    "judged_sentence",
    "listed",
    "merit_of",
    "merit_word",
    "problems_of",
    "where",
]

FAIR, BAD = 0.03, 0.1
"""Thresholds of the cost (NRMSE) of a fault: H is worth a look, H should not be used as it is."""

LISTED = {"bad": 3, "fair": 4, "good": 3}
"""Problems that a verdict names; the others are counted."""

PLACES = 3
"""Positions that it writes out."""


@dataclass(frozen=True)
class QualityProblem:
    """One thing that is wrong with an H.

    Attributes
    ----------
    title, detail
        What it is, and what was found of it.
    where
        Positions or pixels concerned, in words; empty: not known.
    cost
        What it adds to the error of a reconstruction, in words; empty: not known.
    advice
        The remedy.
    merit
        Of an H that has it.
    repeat
        Number of positions that fix it when they are recorded again; 0: it concerns no single positions.

    Examples
    --------
    >>> from lfcal.judge.quality import QualityProblem, judged_sentence
    >>> hot = QualityProblem("hot line", "60 counts too many", "all positions", "0.31", "Subtract a dark frame.", "bad")
    >>> print(judged_sentence([hot], "good").partition(". ")[2])
    Hot line: 60 counts too many; all positions; it costs 0.31. Subtract a dark frame. What remains is good.
    """

    title: str
    detail: str
    where: str
    cost: str
    advice: str
    merit: Merit
    repeat: int = 0

    @property
    def sentence(self) -> str:
        """What it is, where, and what it costs."""
        parts = [self.detail, self.where, f"it costs {self.cost}" if self.cost else ""]
        return f"{_capital(self.title)}: {'; '.join(part for part in parts if part)}."


def judged_sentence(problems: Sequence[QualityProblem], rest: str) -> str:
    """Return the verdict on an H.

    Parameters
    ----------
    problems
        What is wrong, the worst first; those of a merit that is good concern positions to repeat.
    rest
        What is known of H besides, as "good by 26 metrics".

    Examples
    --------
    >>> from lfcal.judge.quality import judged_sentence
    >>> print(judged_sentence([], "good by 26 metrics"))
    This PSF is good by 26 metrics.
    """
    worst: Merit = next((m for m in ("bad", "fair") if any(one.merit == m for one in problems)), "good")
    if not problems:
        return f"This PSF is {rest}."
    own = [one for one in problems if one.merit == worst]
    first = own[0]
    names = listed([one.title for one in own], LISTED[worst])
    if worst == "bad":
        head = f"This PSF should not be used as it is: {names}."
    elif worst == "fair":
        head = f"This PSF can be used; worth a look: {names}."
    else:
        many = format_count(sum(one.repeat for one in own), "position", "positions")
        head = f"This PSF is good but for {many} to record again: {names}."
    left = [one for one in problems if one is not first]
    return f"{head} {first.sentence} {first.advice} {_remains(left, rest)}"


def _remains(left: Sequence[QualityProblem], rest: str) -> str:
    for merit, words in (("bad", "should not be used"), ("fair", "is worth a look"), ("good", "is good but for")):
        own = [one.title for one in left if one.merit == merit]
        if own:
            names = listed(own, LISTED[merit])
            return f"What remains {words} {names}." if merit == "good" else f"What remains {words}: {names}."
    return f"What remains is {rest}."


def merit_of(metric: Metric) -> Merit:
    """Return the merit that a metric gives an H: of single frames by what they cost, as they can be recorded again."""
    spec = metric.spec
    if metric.merit in ("bad", "fair") and spec.redo and spec.cost.per_frame and len(metric.positions):
        return "bad" if metric.cost >= BAD else "fair" if metric.cost >= FAIR else "good"
    return metric.merit


def merit_word(metric: Metric) -> str:
    """Return the merit of a metric for a table: ``repeat`` where positions to record again leave H good."""
    return "repeat" if merit_of(metric) == "good" != metric.merit else metric.merit


def problems_of(metrics: Iterable[Metric], shape: Sequence[int]) -> tuple[QualityProblem, ...]:
    """Return what metrics say is wrong with an H of ``shape`` ``(nz, ny, nx, ...)``, the worst first."""
    found = (_problem(m, math.prod(shape[:3])) for m in metrics if m.merit in ("bad", "fair"))
    return tuple(sorted(found, key=lambda one: RANK[one.merit]))


def _problem(metric: Metric, frames: int) -> QualityProblem:
    named = metric.spec.verdict_detail and metric.detail and not math.isnan(metric.value)
    value = f"∞ {metric.spec.unit}".strip() if math.isinf(metric.value) else metric.text
    cost = ""
    if metric.cost > 0:
        cost = f"{metric.cost:.3f} (NRMSE)" if metric.measured else f"{metric.cost:.2g} (NRMSE, typical)"
    return QualityProblem(
        metric.detail if named else metric.spec.title.lower(),
        value if named or not metric.detail else f"{value}, {metric.detail}",
        where(metric.positions.tolist(), frames),
        cost,
        metric.spec.advice,
        merit_of(metric),
        len(metric.positions) if metric.spec.redo else 0,
    )


def where(positions: Sequence[Sequence[int]], frames: int) -> str:
    """Return how many of the positions are concerned, and the first of them as (z, y, x); empty where none is named."""
    if not positions:
        return ""
    if len(positions) >= frames:
        return "all positions"
    first = ", ".join(f"({', '.join(map(str, place))})" for place in positions[:PLACES])
    more = " …" if len(positions) > PLACES else ""
    return f"{len(positions):,} of {frames:,} positions (z, y, x): {first}{more}"


def counted(metrics: Iterable[Metric]) -> dict[str, int]:
    """Return how many metrics have which merit, and how many do not apply."""
    found = dict.fromkeys(("bad", "fair", "good", "unknown", "not_applicable"), 0)
    for metric in metrics:
        found[merit_of(metric) if metric.applies else "not_applicable"] += 1
    return found


def counted_words(metrics: Iterable[Metric]) -> str:
    """Return the same for people: ``26 good, 12 not applicable``."""
    found = counted(metrics)
    shown = [f"{many} {key.replace('_', ' ')}" for key, many in found.items() if many or key == "good"]
    return ", ".join(shown)


def listed(names: Sequence[str], most: int) -> str:
    """Return the first of the names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _capital(words: str) -> str:
    return words[:1].upper() + words[1:]
