"""Names of `lfcal.work.executors` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.work.executors.base import FINAL_EVENTS, Event, EventKind, Executor
from lfcal.work.executors.threads import concurrent_memory, concurrent_units

__all__ = [
    "FINAL_EVENTS",
    "Event",
    "EventKind",
    "Executor",
    "concurrent_memory",
    "concurrent_units",
]
