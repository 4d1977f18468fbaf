"""What is drawn over a live frame: where the plan expects image and cutout, and the lenslets' centres."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.axes import centre
from lfcal.camera import ScanPlan
from lfcal.devices.protocols import Point, Roi

__all__ = ["lattice_centres", "predicted_cutout", "predicted_image"]


def predicted_image(plan: ScanPlan, stage_um: Point) -> tuple[float, float]:
    """Return where the plan expects the image (row, column) with the stage at ``stage_um``; sensor pixels."""
    right, down, away = plan.stage.to_object(np.array(stage_um)).tolist()
    step = plan.camera.step_um(away)
    row, column = plan.camera.sensor.centre_px
    return row + down / step, column + right / step


def predicted_cutout(plan: ScanPlan, stage_um: Point) -> Roi:
    """Return the cutout that would be kept with the stage at ``stage_um``; it may reach beyond the sensor."""
    row, column = predicted_image(plan, stage_um)
    nt, ns = plan.cutout
    return Roi(math.ceil(row - 0.5) - centre(nt), math.ceil(column - 0.5) - centre(ns), nt, ns)


def lattice_centres(plan: ScanPlan, roi: Roi) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Return the micro-image centres of the plan's camera within ``roi``.

    Returns
    -------
    centres, types
        ``(N, 2)`` (row, column) in sensor pixels, and ``(N,)`` lens types.
    """
    sensor, lattice = plan.camera.sensor, plan.camera.lattice
    rows, columns = sensor.centre_px
    middle = roi.row + (roi.rows - 1) / 2 - rows, roi.column + (roi.columns - 1) / 2 - columns
    found, types = lattice.lenslets_within(
        roi.columns / 2 * sensor.pixel_um,
        roi.rows / 2 * sensor.pixel_um,
        (middle[1] * sensor.pixel_um, middle[0] * sensor.pixel_um),
    )
    return found[:, ::-1] / sensor.pixel_um + np.array([rows, columns]), types
