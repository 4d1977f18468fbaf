"""The engine that a forecast chose on a device."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.reconstruct.projectors._device_direct import DeviceDirect
from lfcal.reconstruct.projectors._device_engine import DeviceEngine, Placement
from lfcal.reconstruct.projectors._device_forecast import ON_DEVICES, device_forecast
from lfcal.reconstruct.projectors._device_polyphase import DevicePolyphase
from lfcal.reconstruct.projectors._device_reduced import DeviceReduced
from lfcal.reconstruct.projectors._device_sparse import DeviceSparse
from lfcal.reconstruct.projectors._reduced import Reduced
from lfcal.reconstruct.projectors.device import ArrayDevice, find_device
from lfcal.reconstruct.projectors.forecast import REDUCED, ProjectionForecast, ProjectionProblem, forecast
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["engine_on", "forecast_on"]


def forecast_on(
    device: str | ArrayDevice, problem: ProjectionProblem, method: str, memory_limit: int
) -> tuple[ArrayDevice | None, ProjectionForecast]:
    """Return the device that ``device`` names, None for the processor, and the cheapest way to project there.

    ``auto`` falls back to the processor where the device does not know the method, or has no room for it.
    """
    found = find_device(device) if isinstance(device, str) else device
    if found is None or (device == "auto" and method not in ("auto", *ON_DEVICES)):
        return None, forecast(problem, method, memory_limit)
    try:
        return found, device_forecast(problem, method, memory_limit, found)
    except InputError:
        if device != "auto":
            raise
        return None, forecast(problem, method, memory_limit)


def engine_on(
    device: ArrayDevice,
    chosen: ProjectionForecast,
    grid: Grid,
    common: tuple[np.dtype[Any], int, NDArray[np.bool_] | None],
    tolerance: float,
) -> DeviceEngine:
    """Return the engine of a forecast for ``device``; ``common``: type, threads that prepare, image phases in use."""
    assert chosen.device is not None
    placement = Placement(device, chosen.device.kept, chosen.device.room)
    (dtype, workers, phases), name = common, chosen.chosen.method
    if chosen.plan is not None:
        return DevicePolyphase(chosen.plan, dtype, placement, workers, phases)
    if name == REDUCED:
        return DeviceReduced(Reduced(grid, dtype, workers, phases, tolerance=tolerance), placement)
    if name == "sparse":
        return DeviceSparse(grid, dtype, placement, workers, phases)
    return DeviceDirect(grid, dtype, placement, phases)
