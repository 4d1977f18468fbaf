"""Possible faults in the content of a frame, and their messages."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.acquire.recording import Suspicion
from lfcal.base import Finding

__all__ = ["CERTAIN", "NO_DOUBT", "Doubt"]

CERTAIN = Suspicion.REPEATED | Suspicion.TORN | Suspicion.EXPOSURE
"""Faults proved by the frame alone; all others are checked with a known position first."""


SUBJECTS = {
    Suspicion.BLANK: "light",
    Suspicion.LIGHT: "light",
    Suspicion.DISPLACED: "stage",
    Suspicion.DARK_LEVEL: "sensor",
    Suspicion.CLIPPED: "sensor",
}
"""Subject of each kind of finding; the subject of all others is the frame itself."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """Suspected faults of one frame, with the findings that explain them; falsy if there are none."""

    what: Suspicion = Suspicion.NONE
    findings: tuple[Finding, ...] = ()

    @classmethod
    def of(cls, what: Suspicion, why: str) -> Doubt:
        """Return a doubt with one finding; ``why`` states what was expected and found, then "; " and the remedy."""
        detail, _, remedy = why.rpartition("; ") if "; " in why else (why, "", "")
        one = Finding(
            kind=what.words.replace(" ", "_"),
            what=what.words,
            subject=SUBJECTS.get(what, "frames"),
            detail=detail,
            remedy=remedy,
            merit="bad" if what & CERTAIN else "fair",
        )
        return cls(what, (one,))

    def __bool__(self) -> bool:
        """Return whether anything is suspected."""
        return bool(self.findings)

    def __or__(self, other: Doubt) -> Doubt:
        """Return the findings of both doubts as one."""
        if not other.findings:
            return self
        return Doubt(self.what | other.what, self.findings + other.findings)

    @property
    def certain(self) -> bool:
        """Whether the frame alone proves at least one of the faults."""
        return bool(self.what & CERTAIN)

    @property
    def text(self) -> str:
        """Details and remedies of all findings as one line."""
        return "; ".join(part for one in self.findings for part in (one.detail, one.remedy) if part)


NO_DOUBT = Doubt()
