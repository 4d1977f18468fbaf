"""The live view: frames as they arrive, each with exact measurements."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.control import Control
from lfcal.acquire.preview import LiveFrame, Preview
from lfcal.acquire.spots import Spot, find_spot
from lfcal.base import InputError, njit
from lfcal.camera import ScanPlan
from lfcal.devices import CheckedCamera, FrameTimeout, IncompleteFrame, Point, Rig, Roi

__all__ = ["Levels", "LiveState", "iter_live", "levels", "predicted_image"]


@njit()
def _count(data: NDArray[Any], histogram: NDArray[np.int64]) -> None:
    """Count the samples of ``data`` (rows, columns) by value; the histogram's last entry includes higher values."""
    last = histogram.size - 1
    for i in range(data.shape[0]):
        for j in range(data.shape[1]):
            # one pass without a copy; np.bincount would convert 16 bits to 64 first
            histogram[min(int(data[i, j]), last)] += 1


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """Histogram of all pixels of a frame.

    Attributes
    ----------
    histogram
        Number of pixels with each sample value from 0, ``(max_value + 1,)``; the last entry includes all higher values.
    """

    histogram: NDArray[np.int64]

    @property
    def pixels(self) -> int:
        """Total number of pixels."""
        return int(self.histogram.sum())

    @property
    def saturated(self) -> int:
        """Number of saturated pixels, that is, with at least the value ``max_value``."""
        return int(self.histogram[-1])

    @property
    def maximum(self) -> int:
        """Highest sample value in the frame, at most ``max_value`` (counts)."""
        return int(np.flatnonzero(self.histogram)[-1])

    def quantile(self, share: float) -> int:
        """Return the lowest sample value (counts) that at least the fraction ``share`` of the pixels do not exceed."""
        total = np.cumsum(self.histogram)  # exact for whole numbers, without a sorted copy of the frame
        return int(np.searchsorted(total, share * total[-1]))


def levels(frame: NDArray[Any], max_value: int) -> Levels:
    """Return the histogram of ``frame`` ``(rows, columns)``, whose samples saturate at ``max_value``.

    Raises `InputError` unless the frame is a 2-D array of unsigned integers that is not empty.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.acquire.setup import Levels, levels
    >>> found: Levels = levels(np.array([[0, 100], [200, 4095]], np.uint16), max_value=4095)
    >>> print(found.saturated, "saturated pixel")
    1 saturated pixel
    """
    if frame.ndim != 2 or frame.dtype.kind != "u" or frame.size == 0:
        raise InputError.expected(
            "frame", "a 2-D array of unsigned samples", f"{frame.ndim}-D {frame.dtype}", "pass a raw frame"
        )
    histogram = np.zeros(max_value + 1, np.int64)
    _count(frame, histogram)
    return Levels(histogram)


@dataclass(frozen=True, slots=True, eq=False)
class LiveState:
    """Measurements of a live frame.

    Attributes
    ----------
    levels
        Histogram of the frame; None without a frame.
    spot
        Light of the source, with its centroid in sensor coordinates; None if no light is significant.
    stage_um
        Position (x, y, z) of the stage (µm).
    expected_px
        Position (row, column) of the image on the sensor according to the plan (px); None without a plan.
    trouble
        Reason why the last attempt returned no frame; empty if it returned one.
    """

    levels: Levels | None
    spot: Spot | None
    stage_um: tuple[float, float, float]
    expected_px: tuple[float, float] | None
    trouble: str = ""

    @property
    def offset_px(self) -> tuple[float, float] | None:
        """Measured minus expected position (row, column) of the image (px); None if either is unknown."""
        if self.spot is None or self.expected_px is None:
            return None
        return self.spot.row - self.expected_px[0], self.spot.column - self.expected_px[1]


def predicted_image(plan: ScanPlan, stage_um: Point) -> tuple[float, float]:
    """Return the image position (row, column) on the sensor (px) that the plan predicts for the stage position.

    ``stage_um`` contains the stage coordinates (x, y, z) in µm.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21)
    >>> from lfcal.acquire.setup import predicted_image
    >>> stage = tuple(plan.stage_um([0, 4, 2]).tolist())
    >>> row, column = predicted_image(plan, stage)
    >>> print(plan.image_px([0, 4, 2]).round(1).tolist(), round(row, 1), round(column, 1))  # there and back
    [154.0, 146.0] 154.0 146.0
    """
    right, down, away = plan.stage.to_object(np.array(stage_um)).tolist()
    step = plan.camera.step_um(away)
    row, column = plan.camera.sensor.centre_px
    return row + down / step, column + right / step


def iter_live(
    rig: Rig,
    preview: Preview,
    control: Control,
    exposure_s: float,
    *,
    plan: ScanPlan | None = None,
    timeout_s: float = 5.0,
) -> Generator[LiveState, float | None, None]:
    """Take frames of the whole sensor until a stop is requested; put each into ``preview``, and yield its measurements.

    ``send`` a number to the generator to change the exposure time (s). A missing or incomplete frame is reported in
    `LiveState.trouble`, and the view continues.

    Parameters
    ----------
    rig, preview, control
        Devices, queue of frames to display, and requests from other threads.
    exposure_s
        Initial exposure time (s).
    plan
        Plan that predicts the position of the image. None: no prediction.
    timeout_s
        Longest wait for a frame beyond its exposure (s).

    Raises
    ------
    DeviceLost
        If the camera no longer answers.
    DeviceError
        If a driver raises any other error.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire import Control, Preview
    >>> from lfcal.acquire.setup import LiveState, iter_live
    >>> live = iter_live(simulated_rig(plan), Preview(), Control(), exposure_s=0.01, plan=plan)
    >>> state: LiveState = next(live)
    >>> print(state.levels.saturated, "saturated pixels, spot expected at", state.expected_px)
    0 saturated pixels, spot expected at (159.5, 159.5)
    >>> live.close()
    """
    camera = CheckedCamera.of(rig.camera)
    roi = camera.set_roi(Roi(0, 0, *camera.sensor_shape)).actual
    seconds = camera.set_exposure(exposure_s).actual
    while not control.stopping:
        stage = rig.stage.position()
        expected = None if plan is None else predicted_image(plan, stage)
        try:
            frame = camera.grab(timeout_s + seconds, lambda: control.stopping)
            if frame is None:
                break
            if frame.status != "complete":
                raise IncompleteFrame.expected(
                    "camera buffer", "a complete frame", frame.status, "check cable and bandwidth"
                )
        except (FrameTimeout, IncompleteFrame) as error:
            wanted = yield LiveState(None, None, stage, expected, str(error))
        else:
            counts = levels(frame.data, camera.max_value)
            preview.put(LiveFrame(frame.data, roi, None, None, counts.saturated, "live"))
            try:
                seen = find_spot(frame.data)
                spot = replace(seen, row=seen.row + roi.row, column=seen.column + roi.column)
            except InputError:
                spot = None
            wanted = yield LiveState(counts, spot, stage, expected)
        # only if it changes, because some cameras restart their stream
        if wanted is not None:
            seconds = camera.set_exposure(wanted).actual
