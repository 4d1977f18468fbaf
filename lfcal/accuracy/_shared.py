"""What other packages of lfcal use of `lfcal.accuracy`, and nobody else: it may change."""

from __future__ import annotations

from lfcal.accuracy.base import cost_axis, format_cost

__all__ = [
    "cost_axis",
    "format_cost",
]
