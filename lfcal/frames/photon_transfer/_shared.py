"""Names of `lfcal.frames.photon_transfer` for use within lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.frames.photon_transfer.frame_list import find_frames
from lfcal.frames.photon_transfer.measurement import iter_measure_sensor
from lfcal.frames.photon_transfer.result import SensorMeasurement, figures_of, save_curve, sensor_differences

__all__ = [
    "SensorMeasurement",
    "figures_of",
    "find_frames",
    "iter_measure_sensor",
    "save_curve",
    "sensor_differences",
]
