"""Names of `lfcal.work.executors` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.work.executors.base import Ended, Event, Executor, What
from lfcal.work.executors.threads import at_once, memory_beside

__all__ = [
    "Ended",
    "Event",
    "Executor",
    "What",
    "at_once",
    "memory_beside",
]
