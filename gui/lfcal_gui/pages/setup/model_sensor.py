"""The sensor measured from flats and darks: the work, and what is shown of it. No Qt."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Work
from lfcal.camera import Camera
from lfcal.frames.photon_transfer import (
    SensorMeasurement,
    figures_of,
    find_frames,
    iter_measure_sensor,
    sensor_differences,
)

__all__ = ["Curves", "curves_of", "iter_sensor", "rows_of", "taken", "words_of"]


@dataclass(frozen=True)
class Curves:
    """Noise over signal (counts), arrays of x and y each: points fitted, other points, and the fit."""

    fitted: tuple[NDArray[np.float64], NDArray[np.float64]]
    others: tuple[NDArray[np.float64], NDArray[np.float64]]
    fit: tuple[NDArray[np.float64], NDArray[np.float64]]


def iter_sensor(camera: Camera, flats: Path, darks: Path) -> Work[SensorMeasurement]:
    """Yield progress and return the sensor's figures; the colour filter is that of the files, else the camera's."""
    (lit, facts), (dark, _) = find_frames(flats), find_frames(darks)
    found: SensorMeasurement = yield from iter_measure_sensor(lit, dark, cfa=str(facts.get("cfa") or camera.sensor.cfa))
    return found


def rows_of(found: SensorMeasurement, camera: Camera) -> list[tuple[str, str]]:
    """Return name and value of every figure, and of the full well that ``camera`` would take."""
    return figures_of(found, camera.sensor)


def words_of(found: SensorMeasurement, camera: Camera) -> str:
    """Return what is to be said of the figures, a line each: doubts, what ``camera`` has otherwise, notes."""
    doubts = [f"Not the sensor's own: {doubt}." for doubt in found.doubts]
    notes = (*sensor_differences(found, camera.sensor), *found.notes)
    return "\n".join([*doubts, *(f"{note[:1].upper()}{note[1:]}." for note in notes)])


def taken(found: SensorMeasurement, camera: Camera) -> tuple[Camera | None, str]:
    """Return ``camera`` with the measured sensor, or None and why it cannot be taken."""
    try:
        return found.camera(camera), ""
    except InputError as error:
        return None, str(error)


def curves_of(found: SensorMeasurement) -> Curves:
    """Return the photon-transfer curve to be drawn on logarithmic axes."""
    curve = found.curve
    lit = (curve.points.x > 0) & (curve.points.y > 0)
    x, y = curve.points.x, np.sqrt(np.maximum(curve.points.y, 0))
    empty = np.zeros(0)
    fit = (empty, empty)
    if curve.slope is not None and lit.any():
        over = np.geomspace(max(float(x[lit].min()) / 3, 1e-2), curve.limit, 100)
        fit = (over, np.sqrt(curve.variance(over)))
    used = curve.used
    return Curves((x[lit & used], y[lit & used]), (x[lit & ~used], y[lit & ~used]), fit)
