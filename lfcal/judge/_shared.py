"""Names of `lfcal.judge` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge._fit_trend import Trend, draw_trend, trend
from lfcal.judge.dated import fits_in, read_dated
from lfcal.judge.inspection import is_bad, is_fair
from lfcal.judge.pairing import Pair, pair
from lfcal.judge.region_loss import draw_region_loss, iter_region_loss
from lfcal.judge.telling import compared_words, cost_words, told

__all__ = [
    "Pair",
    "Trend",
    "compared_words",
    "cost_words",
    "draw_region_loss",
    "draw_trend",
    "fits_in",
    "is_bad",
    "is_fair",
    "iter_region_loss",
    "pair",
    "read_dated",
    "told",
    "trend",
]
