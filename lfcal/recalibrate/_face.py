"""The public names of `lfcal.recalibrate`: each is loaded on first use."""

from __future__ import annotations

from lfcal.recalibrate.model import Contents
from lfcal.recalibrate.recalibrate import Recalibration, iter_recalibrate, recalibrate
from lfcal.recalibrate.score import Goodness
from lfcal.recalibrate.watch import iter_watch, watch
from lfcal.recalibrate.watched import DriftTrend, DriftWatch, WatchedFrame, WatchedMean

__all__ = [
    "Contents",
    "DriftTrend",
    "DriftWatch",
    "Goodness",
    "Recalibration",
    "WatchedFrame",
    "WatchedMean",
    "iter_recalibrate",
    "iter_watch",
    "recalibrate",
    "watch",
]
