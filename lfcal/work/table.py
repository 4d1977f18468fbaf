"""A run as people see it: the same words on the command line and in the window."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lfcal.base import format_seconds
from lfcal.work.journal import RunState

__all__ = ["HEADER", "RunTable", "run_table"]

HEADER = ("unit", "state", "attempts", "time", "by", "why")

SHOWN = 40
"""Units of a table; of more those that are done or wait are only counted."""


@dataclass(frozen=True)
class RunTable:
    """What is shown of a run.

    Attributes
    ----------
    headline
        What it makes, how far it is, and who is at work.
    place
        Where its workers can be watched, an address; empty where they cannot.
    rows
        A row of `HEADER` for each unit that is worth one.
    pace
        Units under way, how many are done in an hour, and how long the rest takes, as far as there is something to go
        by; empty where nobody is at work.
    """

    headline: str
    place: str
    rows: tuple[tuple[str, ...], ...]
    pace: str


def run_table(state: RunState) -> RunTable:
    """Return what is shown of a run."""
    who = f"{state.executor}, {state.workers} at work" if state.running else "not running"
    headline = f"{state.title}: {state.count('done')} of {len(state.units)} units done; {who}"
    told = [u for u in state.units if len(state.units) <= SHOWN or u.state in ("under way", "failed") or u.reason]
    rows = tuple(
        (
            unit.name,
            unit.state,
            str(unit.attempts or ""),
            "" if math.isnan(unit.seconds) else format_seconds(unit.seconds),
            unit.worker,
            unit.reason,
        )
        for unit in told
    )
    known = []
    if state.running:
        known.append(f"{state.count('under way')} under way")
        if state.per_hour is not None and state.eta_seconds is not None:
            known += [f"{state.per_hour:.3g} units an hour", f"about {format_seconds(state.eta_seconds)} left"]
    return RunTable(headline, state.place if state.running else "", rows, ", ".join(known))
