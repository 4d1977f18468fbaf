"""Measured speed of this machine: duration of jobs relative to their forecasts. No Qt."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from statistics import median

FORECASTS = {"make": "make_s", "compute": "compute_s", "reconstruct": "reconstruct_s", "depth": "depth_s"}
"""Kinds of jobs with a forecast, and the field of `Sitting` that contains it."""

KEPT = 5
"""Number of newest runs of each kind that are used."""


@dataclass
class Paces:
    """Corrects forecasts by the median ratio of duration to forecast in the latest jobs of the same kind.

    A median is used because resumed jobs take less time.

    Examples
    --------
    >>> from lfcal_gui.models.pace import Paces
    >>> paces = Paces()
    >>> paces.take("make", forecast=2.0, seconds=3.0)
    >>> print(paces.corrected({"make_s": 4.0, "frames": 12}))
    {'make_s': 6.0, 'frames': 12}
    """

    runs: dict[str, list[float]] = field(default_factory=dict)

    def take(self, kind: str, forecast: float, seconds: float) -> None:
        """Record the duration of a job."""
        if forecast > 0 and seconds > 0:
            self.runs[kind] = [*self.runs.get(kind, ()), seconds / forecast][-KEPT:]

    def seconds(self, kind: str, forecast: float) -> float:
        """Return a forecast for a kind of job, corrected for this machine."""
        runs = self.runs.get(kind)
        return forecast * median(runs) if runs else forecast

    def corrected(self, facts: Mapping[str, object]) -> dict[str, object]:
        """Return facts of a sitting with forecasts corrected for this machine."""
        found = dict(facts)
        for kind, name in FORECASTS.items():
            seconds = found.get(name)
            if isinstance(seconds, float):
                found[name] = self.seconds(kind, seconds)
        return found

    def texts(self) -> list[str]:
        """Return the texts stored between starts, one for each kind."""
        return [" ".join((kind, *(f"{run:.4g}" for run in runs))) for kind, runs in self.runs.items()]

    @classmethod
    def of(cls, texts: Iterable[str]) -> Paces:
        """Return the object that `texts` describes; other texts are ignored."""
        found: dict[str, list[float]] = {}
        for kind, *runs in map(str.split, texts):
            try:
                values = [float(run) for run in runs]
            except ValueError:
                continue
            if kind in FORECASTS and values and all(0 < value < 1e6 for value in values):
                found[kind] = values[-KEPT:]
        return cls(found)
