"""Validation of a scan plan's entries."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from lfcal.axes import Position
from lfcal.camera._checks import check_number, check_tuple
from lfcal.camera.description import Camera
from lfcal.errors import InputError, expectation

if TYPE_CHECKING:
    from lfcal.camera.plan import ScanPlan

__all__ = ["check_on_sensor", "depths_of", "set_depths", "set_exposures"]


def set_depths(plan: ScanPlan) -> None:
    """Check the planes: numbers the camera can see, strictly ordered."""
    depths = check_tuple("depths (µm)", plan.depths_um)
    for z in depths:
        plan.camera.step_um(z)
    steps = np.diff(np.array(depths))
    if steps.size and not (np.all(steps > 0) or np.all(steps < 0)):
        raise InputError(expectation("depths (µm)", "rising or falling throughout", "another order or a repeated plane",
                                     "sort them and remove repetitions"))  # fmt: skip
    object.__setattr__(plan, "depths_um", depths)


def set_exposures(plan: ScanPlan) -> None:
    """Check the exposures: one, or one per plane."""
    given, planes = plan.exposure_s, len(plan.depths_um)
    several = isinstance(given, list | tuple) and len(given) != 1
    values = check_tuple("exposures (s), one or one per plane", given if isinstance(given, list | tuple) else [given],
                         planes if several else 1, above=0)  # fmt: skip
    object.__setattr__(plan, "exposure_s", values if several else values * planes)


def depths_of(camera: Camera, depths: Iterable[float] | None, virtual: Iterable[float] | None) -> tuple[float, ...]:
    """Return object-space depths (µm) from whichever of the two is given."""
    if (depths is None) == (virtual is None):
        raise InputError(expectation("depth planes", "depths in µm or virtual depths", "both or neither", "give one"))
    values: Sequence[float] = tuple(depths if depths is not None else virtual or ())
    for value in values:
        check_number("depth", value)
    return tuple(values) if depths is not None else tuple(camera.depth_of(v) for v in values)


def check_on_sensor(plan: ScanPlan) -> None:
    """Raise unless the cutout of every position lies on the sensor; the anchor and step are plane-independent."""
    factors = plan.resample_factors
    for axis, name in enumerate(("row", "column")):
        size = plan.camera.sensor.shape[axis]
        half = (plan.cutout[axis] - 1) / 2 / factors[axis]
        centres = np.floor(plan.anchor[axis] + 0.5) + np.arange(plan.period[axis]) / factors[axis]
        outside = np.flatnonzero((centres - half < -0.5) | (centres + half > size - 0.5))
        if outside.size:
            k = int(outside[0])
            place = Position(0, k, 0) if axis == 0 else Position(0, 0, k)
            lo, hi = centres[k] - half, centres[k] + half
            raise InputError(
                expectation(f"cutout of position z={place.z}, y={place.y}, x={place.x}", f"{name}s 0 to {size - 1}",
                            f"{lo:.0f} to {hi:.0f}", "move the anchor inwards or choose a smaller cutout")
            )  # fmt: skip
