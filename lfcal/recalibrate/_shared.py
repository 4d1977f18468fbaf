"""Names of `lfcal.recalibrate` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.recalibrate.files import iter_write_recalibration, recalibration_dict, recalibration_outputs
from lfcal.recalibrate.model import stated_contents
from lfcal.recalibrate.watch_files import RECALIBRATED, StoredWatch, read_watch, watch_outputs, write_watch
from lfcal.recalibrate.watched import DRIFT_NAMES

__all__ = [
    "DRIFT_NAMES",
    "RECALIBRATED",
    "StoredWatch",
    "iter_write_recalibration",
    "read_watch",
    "recalibration_dict",
    "recalibration_outputs",
    "stated_contents",
    "watch_outputs",
    "write_watch",
]
