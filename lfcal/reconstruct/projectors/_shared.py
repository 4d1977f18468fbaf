"""Names of `lfcal.reconstruct.projectors` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.reconstruct.projectors.device import ArrayDevice, device_count, find_device
from lfcal.reconstruct.projectors.field_projector import FieldProjector
from lfcal.reconstruct.projectors.forecast import METHODS, ProjectionForecast
from lfcal.reconstruct.projectors.grid import Grid
from lfcal.reconstruct.projectors.projector import Projector

__all__ = [
    "METHODS",
    "ArrayDevice",
    "FieldProjector",
    "Grid",
    "ProjectionForecast",
    "Projector",
    "device_count",
    "find_device",
]
