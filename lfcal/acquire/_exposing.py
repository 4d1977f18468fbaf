"""Expose the frame of a position, and check that it is complete, new and of the expected shape.

Several exposures of one position are averaged, or merged to a high dynamic range.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.control import Control
from lfcal.base import InputError, format_pixels
from lfcal.devices import CameraError, CheckedCamera, Frame, IncompleteFrame, Rig, Roi, StaleFrame, WrongFrame

__all__ = ["ExposedFrame", "Exposer", "average", "merge"]


def average(frames: Sequence[NDArray[Any]], max_value: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the mean of equally exposed frames, and a mask of the pixels that are saturated in any of them.

    Parameters
    ----------
    frames
        Frames ``(rows, columns)`` of unsigned integers, all of the same shape.
    max_value
        Saturated sample value. A pixel that is saturated in any frame is marked, because its mean is too low.

    Returns
    -------
    mean, saturated
        Mean (float32) and mask (bool), ``(rows, columns)``.
    """
    if not frames or any(frame.shape != frames[0].shape for frame in frames):
        shapes = " and ".join(dict.fromkeys(format_pixels(frame.shape) for frame in frames))
        raise InputError.expected(
            "frames to average", "one or more frames of the same shape", shapes or "none", "record them again"
        )
    total = np.zeros(frames[0].shape, np.uint32)
    saturated = np.zeros(frames[0].shape, np.bool_)
    for frame in frames:
        total += frame
        saturated |= frame >= max_value
    return (total / np.float64(len(frames))).astype(np.float32), saturated


def merge(
    frames: Sequence[NDArray[Any]],
    saturated: Sequence[NDArray[np.bool_]],
    exposures_s: Sequence[float],
    *,
    reference_s: float,
    black_level: float = 0.0,
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Merge bracketed frames into the counts that a sensor of unlimited range would show at ``reference_s``.

    Each pixel is the sum of its unsaturated counts above black over the sum of their exposures, times the reference
    exposure, plus black. This is the maximum-likelihood rate for shot noise. Values may exceed the sensor's range. A
    pixel saturated even in the shortest exposure keeps that exposure's value, a lower bound, and is marked.

    Parameters
    ----------
    frames
        Frames ``(rows, columns)`` (counts), one per exposure.
    saturated
        Mask of the saturated pixels of each frame, ``(rows, columns)``.
    exposures_s
        Actual exposure time of each frame (s).
    reference_s
        Exposure time for which counts are returned (s).
    black_level
        Counts without light, the same at every exposure.

    Returns
    -------
    counts, saturated
        Counts (float32), and mask (bool) of the pixels saturated in every frame, ``(rows, columns)``.
    """
    if not len(frames) == len(saturated) == len(exposures_s) > 0 or min(exposures_s) <= 0:
        raise InputError.expected(
            "exposure bracket",
            "one exposure above 0 s for each frame",
            f"{', '.join(f'{seconds:g} s' for seconds in exposures_s) or 'none'} for {len(frames)} frames",
            "give one exposure for each frame",
        )
    shortest = int(np.argmin(exposures_s))
    light = np.zeros(frames[0].shape, np.float64)
    seconds = np.zeros(frames[0].shape, np.float64)
    for k, (frame, full, exposure) in enumerate(zip(frames, saturated, exposures_s, strict=True)):
        # if all exposures of a pixel are saturated, the shortest is the best estimate
        use = ~full if k != shortest else ~full | np.logical_and.reduce(saturated)
        light += np.where(use, frame - np.float64(black_level), 0.0)
        seconds += np.where(use, exposure, 0.0)
    counts = light / seconds * reference_s + black_level
    return counts.astype(np.float32), np.logical_and.reduce(saturated)


SLACK_S = 1e-4
"""Tolerance between the clock of the exposure start and that of the stage's arrival (s)."""


class ExposedFrame(NamedTuple):
    """Samples read from the sensor at one position.

    ``data`` contains the samples ``(rows, columns)`` of the region as delivered, or float32 values if several exposures
    were combined. ``saturated`` is the number of saturated pixels in the region, and ``mask`` marks them (None: those
    at the maximum). ``exposure_s`` is the exposure time to which ``data`` corresponds. ``raws`` contains all exposures
    from which ``data`` was computed, in the requested region. ``reported_s`` contains the exposure times that the
    camera reported with the frames of the full exposure, if any.
    """

    data: NDArray[Any]
    mask: NDArray[np.bool_] | None
    saturated: int
    exposure_s: float
    raws: tuple[NDArray[Any], ...] = ()
    reported_s: tuple[float, ...] = ()


class Exposer:
    """Control of the camera, which takes, checks, averages and merges frames.

    Parameters
    ----------
    rig, control
        The devices, and the requests of the user.
    bracket
        Multiples of the exposure time; see `Options.bracket`.
    black_level
        Counts without light.
    timeout_s
        Longest wait for a frame beyond its exposure (s).
    """

    def __init__(
        self, rig: Rig, control: Control, bracket: tuple[float, ...], black_level: float, timeout_s: float
    ) -> None:
        self._camera = CheckedCamera.of(rig.camera)
        self._control = control
        self._bracket, self._black, self._timeout = bracket, black_level, timeout_s
        self._max = rig.camera.max_value
        self._dtype = np.dtype(np.uint8 if rig.camera.bit_depth <= 8 else np.uint16)
        self._last_number = -1
        self._requested: float | None = None
        self._actual = 0.0
        self._raws: list[NDArray[Any]] = []
        self._reported: list[float] = []
        self._wanted_roi: Roi | None = None
        self.roi = Roi(0, 0, *rig.camera.sensor_shape)

    def read_region(self, roi: Roi) -> None:
        """Read at least the region ``roi`` from now on; the attribute `roi` is the actual region of the camera."""
        # many cameras restart when a region is set, so set it only if it changes
        if roi == self._wanted_roi:
            return
        actual = self._camera.set_roi(roi).actual
        if not actual.holds(roi):
            raise CameraError.expected(
                "camera region",
                f"one that contains {_region_words(roi)}",
                _region_words(actual),
                "reset the camera's region",
            )
        self._wanted_roi, self.roi = roi, actual

    def expose(self, exposure_s: float, repeats: int, arrived_s: float) -> ExposedFrame:
        """Return the frame at the current position; every exposure starts after ``arrived_s`` on the rig's clock."""
        self._raws, self._reported = [], []
        data, mask, saturated, actual = self._combined(exposure_s, repeats, arrived_s)
        return ExposedFrame(data, mask, saturated, actual, tuple(self._raws), tuple(self._reported))

    def _combined(
        self, exposure_s: float, repeats: int, arrived_s: float
    ) -> tuple[NDArray[Any], NDArray[np.bool_] | None, int, float]:
        """Return data, mask, count of saturated pixels and exposure of an `ExposedFrame`."""
        # a single exposure keeps the camera's integer type
        if len(self._bracket) == 1 and repeats == 1:
            data = self._grab(exposure_s, arrived_s)
            return data, None, int(np.count_nonzero(data >= self._max)), self._actual
        means, masks, actual = [], [], []
        for factor in self._bracket:
            frames = [self._grab(exposure_s, arrived_s, factor) for _ in range(repeats)]
            mean, mask = average(frames, self._max)
            means.append(mean)
            masks.append(mask)
            actual.append(self._actual)
        if len(self._bracket) == 1:
            return means[0], masks[0], int(masks[0].sum()), actual[0]
        reference = actual[self._bracket.index(1.0)]
        data, mask = merge(means, masks, actual, reference_s=reference, black_level=self._black)
        return data, mask, int(mask.sum()), reference

    def _grab(self, exposure_s: float, arrived_s: float, factor: float = 1.0) -> NDArray[Any]:
        whole = factor == 1.0
        exposure_s *= factor
        if self._requested != exposure_s:
            self._actual = self._camera.set_exposure(exposure_s).actual
            self._requested = exposure_s
        self._control.check()
        try:
            frame = self._camera.grab(self._timeout + exposure_s, lambda: self._control.aborting)
        except CameraError:
            self._requested = None  # the camera's setting is unknown, so set the exposure again
            raise
        if frame is None:
            raise self._control.aborted()
        check_frame(frame, self.roi.shape, self._dtype, self._last_number, arrived_s)
        self._last_number = frame.number
        # keep only the requested region in memory if the camera reads more
        wanted = self._wanted_roi or self.roi
        self._raws.append(frame.data if wanted == self.roi else frame.data[wanted.within(self.roi)].copy())
        if whole and frame.exposure_s > 0:
            self._reported.append(frame.exposure_s)
        return frame.data


def _region_words(roi: Roi) -> str:
    return f"{format_pixels(roi.shape)} from row {roi.row}, column {roi.column}"


def check_frame(frame: Frame, shape: tuple[int, int], dtype: np.dtype[Any], last_number: int, arrived_s: float) -> None:
    """Raise a `CameraError` unless a frame is complete, new and of the expected shape and type.

    Parameters
    ----------
    frame
        Frame as delivered by the camera.
    shape, dtype
        Expected shape of the region of interest, and sample type of the camera.
    last_number
        Number of the previous frame.
    arrived_s
        Time at which the stage had arrived and settled, on the rig's clock (s).

    Raises
    ------
    IncompleteFrame, StaleFrame, WrongFrame
    """
    if frame.status != "complete":
        raise IncompleteFrame.expected(
            "camera buffer", "a complete frame", frame.status, "check cable, packet size and bandwidth"
        )
    if frame.data.shape != shape or frame.data.dtype != dtype:
        raise WrongFrame.expected(
            "camera frame",
            f"{format_pixels(shape)} of {dtype}",
            f"{format_pixels(frame.data.shape)} of {frame.data.dtype}",
            "another program may have changed the camera settings; start again",
        )
    if frame.number <= last_number:
        raise StaleFrame.expected(
            "frame number",
            f"a number above {last_number}",
            frame.number,
            "the camera repeated an old buffer; flush its buffers",
        )
    if frame.started_s is not None and frame.started_s < arrived_s - SLACK_S:
        raise StaleFrame.expected(
            "exposure",
            "a start after the arrival of the stage",
            f"a start {arrived_s - frame.started_s:.3g} s earlier",
            "trigger the camera, or flush its buffers",
        )
