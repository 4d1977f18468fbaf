"""What is wrong with data, in one form: what it is, where, how large, what it costs and what to do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from lfcal.base.units import format_count

__all__ = ["RANK", "SUBJECTS", "Finding", "Merit", "by_subject", "listed", "verdict_of", "worst_merit"]

Merit = Literal["good", "fair", "bad", "unknown"]

RANK: dict[Merit, int] = {"bad": 0, "fair": 1, "good": 2, "unknown": 3}
"""Order of merits in a report."""

SUBJECTS = ("frames", "stage", "light", "sensor", "optics", "planes", "cutout", "target", "file", "other")
"""Subjects of findings, in the order of a report."""

LISTED = {"bad": 3, "fair": 4, "good": 3}
"""Number of findings that a verdict names; the others are counted."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One thing that is wrong with data.

    Attributes
    ----------
    kind, what
        Key for programs, and what it is, for people.
    subject
        What it concerns, one of `SUBJECTS`.
    detail
        What was found, with numbers and units.
    where
        Positions or pixels concerned, in words; empty: not known.
    positions
        The same as indices: positions (z, y, x) of a scan, or holes (row, column) of a target.
    size, limit
        The value, and the limit that it exceeds, in one unit; NaN: it has none.
    sigma
        By how many standard deviations it differs from what noise does; NaN: not known.
    cost
        What it adds to the error of a reconstruction (NRMSE); None: not known.
    cost_words
        The same for people; empty: not known.
    remedy
        What to do about it.
    merit
        Of data that have it.
    repeat
        Number of positions that fix it when they are recorded again; 0: it concerns no single positions.

    Examples
    --------
    >>> from lfcal.judge import Finding
    >>> hot = Finding(kind="hot_line", what="hot line", detail="60 counts too many", where="all positions")
    >>> print(hot.sentence)
    Hot line: 60 counts too many; all positions.
    """

    kind: str
    what: str
    subject: str = "other"
    detail: str = ""
    where: str = ""
    positions: tuple[tuple[int, ...], ...] = ()
    size: float = math.nan
    limit: float = math.nan
    sigma: float = math.nan
    cost: float | None = None
    cost_words: str = ""
    remedy: str = ""
    merit: Merit = "bad"
    repeat: int = 0

    @property
    def sentence(self) -> str:
        """What it is, where, and what it costs."""
        parts = [self.detail, self.where, f"it costs {self.cost_words}" if self.cost_words else ""]
        found = "; ".join(part for part in parts if part)
        return f"{self.what[:1].upper()}{self.what[1:]}{': ' if found else ''}{found}."

    @property
    def line(self) -> str:
        """Its value and its limit, what it is, and what to do, in one line."""
        value = "" if math.isnan(self.size) else f"{self.size:.3g} (limit {self.limit:g}): "
        return f"{self.kind}: {value}{self.what}: {self.remedy}"

    def __str__(self) -> str:
        """Return what was found."""
        return self.detail or self.what


def worst_merit(findings: Iterable[Finding]) -> Merit:
    """Return the merit of data with these findings: good without any."""
    return min((one.merit for one in findings), key=RANK.__getitem__, default="good")


def by_subject(findings: Iterable[Finding]) -> dict[str, tuple[Finding, ...]]:
    """Return findings by their subjects, in the order of `SUBJECTS`.

    Examples
    --------
    >>> from lfcal.judge import Finding, by_subject
    >>> lamp = Finding(kind="lamp", what="lamp that fades", subject="light")
    >>> jitter = Finding(kind="jitter", what="jitter of the stage", subject="stage")
    >>> {subject: len(found) for subject, found in by_subject([lamp, jitter]).items()}
    {'stage': 1, 'light': 1}
    """
    found: dict[str, tuple[Finding, ...]] = {}
    for one in sorted(findings, key=lambda one: SUBJECTS.index(one.subject)):
        found[one.subject] = (*found.get(one.subject, ()), one)
    return found


def verdict_of(findings: Sequence[Finding], rest: str, data: str = "PSF") -> str:
    """Return the verdict on data as sentences: what is wrong, where, what it costs, the remedy, and what remains then.

    Parameters
    ----------
    findings
        What is wrong, the worst first; those of a merit that is good concern positions to repeat.
    rest
        What is known of the data besides, as "good by 26 metrics".
    data
        What the data are.

    Examples
    --------
    >>> from lfcal.judge import Finding, verdict_of
    >>> print(verdict_of([], "good by 26 metrics"))
    This PSF is good by 26 metrics.
    >>> hot = Finding(kind="hot_line", what="hot line", detail="60 counts", cost_words="0.31", remedy="Use a dark.")
    >>> print(verdict_of([hot], "good").partition(". ")[2])
    Hot line: 60 counts; it costs 0.31. Use a dark. What remains is good.
    """
    if not findings:
        return f"This {data} is {rest}."
    worst: Merit = next((m for m in ("bad", "fair") if any(one.merit == m for one in findings)), "good")
    named = [one for one in findings if one.merit == worst]
    names = listed([one.what for one in named], LISTED[worst])
    if worst == "bad":
        head = f"This {data} should not be used as it is: {names}."
    elif worst == "fair":
        head = f"This {data} can be used; worth a look: {names}."
    else:
        many = format_count(sum(one.repeat for one in named), "position", "positions")
        head = f"This {data} is good but for {many} to record again: {names}."
    others = [one for one in findings if one is not named[0]]
    return f"{head} {named[0].sentence} {named[0].remedy} {_remains(others, rest)}"


def _remains(findings: Sequence[Finding], rest: str) -> str:
    for merit, words in (("bad", "should not be used"), ("fair", "is worth a look"), ("good", "is good but for")):
        names = [one.what for one in findings if one.merit == merit]
        if names:
            shown = listed(names, LISTED[merit])
            return f"What remains {words} {shown}." if merit == "good" else f"What remains {words}: {shown}."
    return f"What remains is {rest}."


def listed(names: Sequence[str], most: int) -> str:
    """Return the first of the names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
