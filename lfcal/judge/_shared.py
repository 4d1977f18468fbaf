"""What other packages of lfcal use of `lfcal.judge`, and nobody else: it may change."""

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
