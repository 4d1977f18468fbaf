"""Names of `lfcal.recalibrate` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.recalibrate.files import iter_write_recalibration, recalibration_dict, recalibration_outputs

__all__ = ["iter_write_recalibration", "recalibration_dict", "recalibration_outputs"]
