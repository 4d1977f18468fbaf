"""Names of `lfcal.judge.faults` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge.faults.places import only_recorded

__all__ = [
    "only_recorded",
]
