"""What can be wrong with the content of a frame, and the words for it."""

from __future__ import annotations

from dataclasses import dataclass

from lfcal.acquire.recording import Suspicion

__all__ = ["CERTAIN", "NO_DOUBT", "Doubt"]

CERTAIN = Suspicion.REPEATED | Suspicion.TORN | Suspicion.EXPOSURE
"""What a frame proves by itself; everything else is held against a known place before it counts."""


@dataclass(frozen=True, slots=True)
class Doubt:
    """What is suspected of a frame, and why: expected, got and the remedy, a clause each; false without suspicion."""

    what: Suspicion = Suspicion.NONE
    why: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        """Return whether anything is suspected."""
        return bool(self.why)

    def __or__(self, other: Doubt) -> Doubt:
        """Return both doubts as one."""
        if not other.why:
            return self
        return Doubt(self.what | other.what, self.why + other.why)

    @property
    def certain(self) -> bool:
        """Whether the frame proves it by itself."""
        return bool(self.what & CERTAIN)

    @property
    def text(self) -> str:
        """All reasons in one line."""
        return "; ".join(self.why)


NO_DOUBT = Doubt()
