"""Names of `lfcal.accuracy` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.accuracy.curves import cost_axis, format_cost, marks_of
from lfcal.accuracy.subject import reference_seconds

__all__ = [
    "cost_axis",
    "format_cost",
    "marks_of",
    "reference_seconds",
]
