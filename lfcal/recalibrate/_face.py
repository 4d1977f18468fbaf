"""The public names of `lfcal.recalibrate`: each is loaded on first use."""

from __future__ import annotations

from lfcal.recalibrate.recalibrate import Recalibration, iter_recalibrate, recalibrate

__all__ = ["Recalibration", "iter_recalibrate", "recalibrate"]
