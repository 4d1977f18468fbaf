"""What other packages of lfcal use of `lfcal.judge.faults`, and nobody else: it may change."""

from __future__ import annotations

from lfcal.judge.faults.places import only_recorded

__all__ = [
    "only_recorded",
]
