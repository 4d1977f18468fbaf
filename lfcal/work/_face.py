"""The public names of `lfcal.work`, all loaded when the first of them is used."""

from __future__ import annotations

from lfcal.work.choice import RunChoice, iter_begun, iter_made
from lfcal.work.executors import EXECUTORS
from lfcal.work.journal import RunState, read_run
from lfcal.work.runs import iter_run, parts_folder
from lfcal.work.unit import Unit

__all__ = [
    "EXECUTORS",
    "RunChoice",
    "RunState",
    "Unit",
    "iter_begun",
    "iter_made",
    "iter_run",
    "parts_folder",
    "read_run",
]
