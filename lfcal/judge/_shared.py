"""Names of `lfcal.judge` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge.inspection import is_bad, is_fair
from lfcal.judge.telling import compared_words, cost_words, told

__all__ = [
    "compared_words",
    "cost_words",
    "is_bad",
    "is_fair",
    "told",
]
