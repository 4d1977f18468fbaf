"""The public names of `lfcal.recalibrate`: each is loaded on first use."""

from __future__ import annotations

from lfcal.recalibrate.model import Contents
from lfcal.recalibrate.recalibrate import Recalibration, iter_recalibrate, recalibrate
from lfcal.recalibrate.score import Goodness

__all__ = ["Contents", "Goodness", "Recalibration", "iter_recalibrate", "recalibrate"]
