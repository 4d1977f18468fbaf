"""Findings: problems of data, each with position, size, cost and remedy in a common form."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

from lfcal.base.units import format_count

__all__ = ["RANK", "SUBJECTS", "Finding", "Judgement", "Merit", "listed"]

Merit = Literal["good", "fair", "bad", "unknown"]

RANK: dict[Merit, int] = {"bad": 0, "fair": 1, "good": 2, "unknown": 3}
"""Merits in the order of a report."""

SUBJECTS = ("frames", "stage", "light", "sensor", "optics", "planes", "cutout", "target", "file", "other")
"""Subjects of findings, in the order of a report."""

WORST: tuple[Merit, ...] = ("bad", "unknown", "fair", "good")
"""Order of findings in a judgement; unknown ranks high, because it may be bad."""

VERDICT: dict[Merit, str] = {
    "bad": "should not be used as it is",
    "unknown": "is not fully judged",
    "fair": "is usable, but should be checked",
    "good": "is good but",
}
"""Verdict on data, by the merit of the worst finding."""

REMAINS: dict[Merit, str] = {
    "bad": "should not be used",
    "unknown": "is not fully judged",
    "fair": "should be checked",
    "good": "is good but for",
}
"""Verdict on data without the worst finding, by the merit of the next findings."""

LISTED: dict[Merit, int] = {"bad": 3, "unknown": 3, "fair": 4, "good": 3}
"""Largest number of findings that a verdict names; others are counted."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """Problem found in data.

    Attributes
    ----------
    kind, what
        Identifier for programs, and short description for display.
    subject
        Part of the set-up or the recording that the problem concerns, one of `SUBJECTS`.
    detail
        Details, with numbers and units.
    where
        Description of the affected positions or pixels; empty if unknown.
    positions
        Affected positions as indices: (z, y, x) of a scan, or holes (row, column) of a target.
    size, limit
        Measured value, and the limit that it violates, in the same unit; NaN if there is none.
    sigma
        Significance relative to noise, in standard deviations; NaN if unknown.
    cost
        Increase of the error of a reconstruction (NRMSE, a fraction); None if unknown.
    cost_words
        The cost as text; empty if unknown.
    remedy
        Remedy for the problem.
    merit
        Rating of data with this problem: ``"good"``, ``"fair"``, ``"bad"`` or ``"unknown"``.
    repeat
        Number of positions to record again to fix the problem; 0 if it does not concern single positions.

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
        """Sentence with the description, details, affected positions and cost."""
        parts = [self.detail, self.where, f"it costs {self.cost_words}" if self.cost_words else ""]
        found = "; ".join(part for part in parts if part)
        return f"{self.what[:1].upper()}{self.what[1:]}{': ' if found else ''}{found}."

    @property
    def line(self) -> str:
        """Line of text with the kind, value, limit, description and remedy."""
        value = "" if math.isnan(self.size) else f"{self.size:.3g} (limit {self.limit:g}): "
        return f"{self.kind}: {value}{self.what}: {self.remedy}"

    def __str__(self) -> str:
        """Return the details, or the description if there are none."""
        return self.detail or self.what


@dataclass(frozen=True, slots=True)
class Judgement:
    """Rating of data, based on all findings.

    Attributes
    ----------
    data
        Kind of data, such as "H", "session" or "camera".
    findings
        All findings, the worst first. Findings rated ``"good"`` concern positions to record again; findings rated
        ``"unknown"`` explain why the quality is unknown.
    known
        Summary of what was found to be good, such as "good by 26 checks"; may be empty.

    Examples
    --------
    >>> from lfcal.judge import Finding, Judgement
    >>> print(Judgement("H", (), "good by 26 checks").verdict)
    This H is good by 26 checks.
    >>> hot = Finding(kind="hot_line", what="hot line", detail="60 counts", cost_words="0.31", remedy="Use a dark.")
    >>> print(Judgement("H", (hot,), "good").verdict.partition(". ")[2])
    Hot line: 60 counts; it costs 0.31. Use a dark. What remains is good.
    """

    data: str
    findings: tuple[Finding, ...]
    known: str

    @classmethod
    def of(cls, data: str, findings: Iterable[Finding], known: str) -> Judgement:
        """Return the judgement of ``data`` with the findings sorted in the order of `WORST`.

        ``data`` and ``known`` are as in `Judgement`.
        """
        return cls(data, tuple(sorted(findings, key=lambda one: WORST.index(one.merit))), known)

    @property
    def merit(self) -> Merit:
        """Rating of the data: that of the worst finding; if there is none, "good" if `known` is set, else "unknown"."""
        return self.findings[0].merit if self.findings else "good" if self.known else "unknown"

    @property
    def verdict(self) -> str:
        """Text with the rating, the first finding (positions, cost and remedy), and a summary of the other findings.

        Without findings, it states `known`, or that nothing could be measured.
        """
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
        """Return a text on the findings except the first; reasons for an unknown quality are always included."""
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
        """Return the findings by subject, in the order of `SUBJECTS`; within a subject, the worst is first."""
        found: dict[str, tuple[Finding, ...]] = {}
        for one in sorted(self.findings, key=lambda one: SUBJECTS.index(one.subject)):
            found[one.subject] = (*found.get(one.subject, ()), one)
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return the rating, the verdict, all findings, and the rating of each subject as plain JSON types."""
        return {
            "merit": self.merit,
            "verdict": self.verdict,
            "findings": [asdict(one) for one in self.findings],
            "subjects": {subject: found[0].merit for subject, found in self.by_subject().items()},
        }


def listed(names: Sequence[str], most: int) -> str:
    """Return a text with the first ``most`` names, and the number of further ones."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more
