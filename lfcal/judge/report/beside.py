"""What a comparison with the camera adds to a report of the metrics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lfcal.judge.quality import Merit

__all__ = ["Beside", "ToldFault"]


@dataclass(frozen=True, slots=True)
class ToldFault:
    """A fault in words, with the picture that shows it.

    Attributes
    ----------
    title, detail, share, cost, advice
        What it is, what was found of it, how much of the light it changes, what it makes of the error of a
        reconstruction, what to do.
    picture, caption
        PNG that shows it (empty: none), and what that is.
    """

    title: str
    detail: str
    share: str
    cost: str
    advice: str
    picture: bytes = b""
    caption: str = ""


@dataclass(frozen=True, slots=True)
class Beside:
    """What was found beside the metrics: it has the last word on verdict and positions.

    Attributes
    ----------
    verdict, merit
        One sentence on H, and the merit that it stands for.
    words
        How much was compared, or why nothing was.
    faults
        What was found, the worst first.
    settled
        Title of the fault that stands for a metric, by the metric's key.
    withdrawn
        Keys of metrics that the comparison refutes.
    redo
        Positions (z, y, x) to record again with the reasons.
    record
        All of it as plain values.
    judged
        What of the metrics' plain values it replaces: verdict, problems, positions.
    """

    verdict: str
    merit: Merit
    words: str
    faults: tuple[ToldFault, ...] = ()
    settled: Mapping[str, str] = field(default_factory=dict)
    withdrawn: frozenset[str] = frozenset()
    redo: tuple[tuple[tuple[int, int, int], str], ...] = ()
    record: Mapping[str, Any] = field(default_factory=dict)
    judged: Mapping[str, Any] = field(default_factory=dict)
