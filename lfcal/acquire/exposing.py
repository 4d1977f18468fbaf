"""From exposures to the one frame that is kept of a position."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.acceptance import check_frame
from lfcal.acquire.averaging import average
from lfcal.acquire.control import Control
from lfcal.acquire.hdr import merge
from lfcal.devices.errors import CameraError, driver_errors
from lfcal.devices.protocols import CameraDevice, Rig, Roi

__all__ = ["Exposer", "ExposedFrame"]


class ExposedFrame(NamedTuple):
    """What was read from the sensor at one place.

    ``data`` ``(rows, columns)`` of the region: samples as they came, or float32 where several were combined;
    ``saturated`` counts of the whole region, ``mask`` which pixels (None: those at the maximum);
    ``exposure_s`` the exposure that ``data`` corresponds to.
    """

    data: NDArray[Any]
    mask: NDArray[np.bool_] | None
    saturated: int
    exposure_s: float


class Exposer:
    """Grab, check, average and merge.

    Parameters
    ----------
    rig, control
        The devices, and what the user asks.
    bracket
        Factors of the exposure; see `Options.bracket`.
    black_level
        Counts of no light.
    timeout_s
        Longest wait for a frame beyond its exposure (s).
    """

    def __init__(
        self, rig: Rig, control: Control, bracket: tuple[float, ...], black_level: float, timeout_s: float
    ) -> None:
        self._camera: CameraDevice = rig.camera
        self._name = rig.camera.name
        self._time, self._control = rig.time, control
        self._bracket, self._black, self._timeout = bracket, black_level, timeout_s
        self._max = rig.camera.max_value
        self._dtype = np.dtype(np.uint8 if rig.camera.bit_depth <= 8 else np.uint16)
        self._last_number = -1
        self._requested: float | None = None
        self._actual = 0.0
        self._wanted_roi: Roi | None = None
        self.roi = Roi(0, 0, *rig.camera.sensor_shape)

    def read_region(self, roi: Roi) -> None:
        """Read at least ``roi`` from now on; `roi` says what the camera took."""
        if roi == self._wanted_roi:
            return
        with driver_errors(self._name):
            actual = self._camera.set_roi(roi).actual
        if not actual.holds(roi):
            raise CameraError.expected("camera region", f"at least {roi}", actual, "reset the camera's region")
        self._wanted_roi, self.roi = roi, actual

    def expose(self, exposure_s: float, repeats: int, arrived_s: float) -> ExposedFrame:
        """Return the frame of this place; every exposure starts after ``arrived_s`` on the rig's clock."""
        if len(self._bracket) == 1 and repeats == 1:
            data = self._grab(exposure_s, arrived_s)
            return ExposedFrame(data, None, int(np.count_nonzero(data >= self._max)), self._actual)
        means, masks, actual = [], [], []
        for factor in self._bracket:
            frames = [self._grab(exposure_s * factor, arrived_s) for _ in range(repeats)]
            mean, mask = average(frames, self._max)
            means.append(mean)
            masks.append(mask)
            actual.append(self._actual)
        if len(self._bracket) == 1:
            return ExposedFrame(means[0], masks[0], int(masks[0].sum()), actual[0])
        reference = actual[self._bracket.index(1.0)]
        data, mask = merge(means, masks, actual, reference_s=reference, black_level=self._black)
        return ExposedFrame(data, mask, int(mask.sum()), reference)

    def _grab(self, exposure_s: float, arrived_s: float) -> NDArray[Any]:
        if self._requested != exposure_s:
            with driver_errors(self._name):
                self._actual = self._camera.set_exposure(exposure_s).actual
            self._requested = exposure_s
        self._control.check()
        try:
            with driver_errors(self._name):
                frame = self._camera.grab(self._timeout + exposure_s)
        except CameraError:
            self._requested = None  # what the camera still holds is unknown: set the exposure again
            raise
        check_frame(frame, self.roi.shape, self._dtype, self._last_number, arrived_s)
        self._last_number = frame.number
        return frame.data
