"""What is wrong with data, in one form: what it is, where, how large, what it costs and what to do."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from lfcal.base.units import format_count

__all__ = ["RANK", "SUBJECTS", "Finding", "Judgement", "Merit", "listed"]

Merit = Literal["good", "fair", "bad", "unknown"]

RANK: dict[Merit, int] = {"bad": 0, "fair": 1, "good": 2, "unknown": 3}
"""Order of merits in a report."""

SUBJECTS = ("frames", "stage", "light", "sensor", "optics", "planes", "cutout", "target", "file", "other")
"""Subjects of findings, in the order of a report."""

WORST: tuple[Merit, ...] = ("bad", "unknown", "fair", "good")
"""Order of findings in a judgement: what is unknown may be bad."""

VERDICT: dict[Merit, str] = {
    "bad": "should not be used as it is",
    "unknown": "is not fully judged",
    "fair": "can be used; worth a look",
    "good": "is good but",
}
REMAINS: dict[Merit, str] = {
    "bad": "should not be used",
    "unknown": "is not fully judged",
    "fair": "is worth a look",
    "good": "is good but for",
}
"""What a verdict says of data by the merit of the worst finding, and of what remains without the first one."""

LISTED: dict[Merit, int] = {"bad": 3, "unknown": 3, "fair": 4, "good": 3}
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


@dataclass(frozen=True, slots=True)
class Judgement:
    """The verdict on data, from all that is wrong with them.

    Attributes
    ----------
    data
        What the data are: "PSF", "session", "camera".
    findings
        What is wrong, the worst first. Those of a merit that is good concern positions to repeat; those of an unknown
        merit are why it is not known whether the data are good.
    known
        What is known of the data besides, as "good by 26 metrics"; empty: nothing.

    Examples
    --------
    >>> from lfcal.judge import Finding, Judgement
    >>> print(Judgement("PSF", (), "good by 26 metrics").verdict)
    This PSF is good by 26 metrics.
    >>> hot = Finding(kind="hot_line", what="hot line", detail="60 counts", cost_words="0.31", remedy="Use a dark.")
    >>> print(Judgement("PSF", (hot,), "good").verdict.partition(". ")[2])
    Hot line: 60 counts; it costs 0.31. Use a dark. What remains is good.
    """

    data: str
    findings: tuple[Finding, ...]
    known: str

    @classmethod
    def of(cls, data: str, findings: Iterable[Finding], known: str) -> Judgement:
        """Return the judgement with the findings sorted, the worst first."""
        return cls(data, tuple(sorted(findings, key=lambda one: WORST.index(one.merit))), known)

    @property
    def merit(self) -> Merit:
        """The merit of the data."""
        return self.findings[0].merit if self.findings else "good" if self.known else "unknown"

    @property
    def verdict(self) -> str:
        """What is wrong, where, what it costs, the remedy, and what remains then."""
        if not self.findings:
            nothing = f"Nothing could be measured: it is not known whether this {self.data} is good."
            return f"This {self.data} is {self.known}." if self.known else nothing
        first = self.findings[0]
        named = [one for one in self.findings if one.merit == first.merit]
        names = listed([one.what for one in named], LISTED[first.merit])
        words = VERDICT[first.merit]
        if first.merit == "good":
            words += f" for {format_count(sum(one.repeat for one in named), 'position', 'positions')} to record again"
        head = f"This {self.data} {words}: {names}."
        return " ".join(filter(None, (head, first.sentence, first.remedy, self._remains())))

    def _remains(self) -> str:
        """Return what remains without the first finding; the reason of a doubt is always given."""
        parts = []
        others = self.findings[1:]
        for merit in dict.fromkeys(one.merit for one in others if one.merit in (others[0].merit, "unknown")):
            names = listed([one.what for one in others if one.merit == merit], LISTED[merit])
            parts.append(f"{REMAINS[merit]} {names}" if merit == "good" else f"{REMAINS[merit]}: {names}")
        if not others and self.known:
            parts = [f"is {self.known}"]
        doubts = [f"{one.sentence} {one.remedy}" for one in others if one.merit == "unknown"]
        return " ".join((f"What remains {', and '.join(parts)}.", *doubts)) if parts else ""

    def by_subject(self) -> dict[str, tuple[Finding, ...]]:
        """Return findings by their subjects, in the order of `SUBJECTS`, the worst of each first."""
        found: dict[str, tuple[Finding, ...]] = {}
        for one in sorted(self.findings, key=lambda one: SUBJECTS.index(one.subject)):
            found[one.subject] = (*found.get(one.subject, ()), one)
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return merit, verdict, all findings, and the merit by each subject as plain values."""
        return {
            "merit": self.merit,
            "verdict": self.verdict,
            "findings": [asdict(one) for one in self.findings],
            "subjects": {subject: found[0].merit for subject, found in self.by_subject().items()},
        }


def listed(names: Sequence[str], most: int) -> str:
    """Return the first of the names, and how many more there are."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
