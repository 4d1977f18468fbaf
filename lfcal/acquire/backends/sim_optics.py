"""Renderers for the simulated camera: a quick pattern of its own, or frames made elsewhere."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.backends.sim_camera import Patch
from lfcal.acquire.devices import Point, Roi
from lfcal.camera import ScanPlan
from lfcal.errors import InputError, expectation
from lfcal.frames.source import FrameSource

__all__ = ["FramesRenderer", "PatternRenderer"]


class PatternRenderer:
    """A light, quick stand-in for plenoptic optics: a blurred disc seen through a periodic mask.

    The disc lies on the paraxial image of the source and grows with its distance from the native plane;
    the mask has exactly the plan's period, so the resulting H is periodic. It is for exercising a session,
    not for judging a PSF.

    Parameters
    ----------
    plan
        Camera, period and exposures; the brightest plane peaks at ``peak`` of the sensor's range.
    peak
        Share of the range between black and saturation.
    """

    def __init__(self, plan: ScanPlan, *, peak: float = 0.6) -> None:
        self._plan = plan
        self._camera = plan.camera
        self._centre = plan.camera.sensor.centre_px
        self._limit = max(1.0, (min(plan.cutout) - 1) / 2)
        sigmas = [self._sigma(z) for z in plan.depths_um]
        exposures = plan.exposure_s if isinstance(plan.exposure_s, tuple) else (plan.exposure_s,) * len(sigmas)
        brightest = max(t / s**2 for t, s in zip(exposures, sigmas, strict=True))
        sensor = plan.camera.sensor
        self._rate = peak * (sensor.max_value - sensor.black_level) / brightest

    def _sigma(self, depth_um: float) -> float:
        return min(1.5 + 0.3 * abs(self._camera.virtual_depth(depth_um)), self._limit / 3)

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> Patch:
        """Return a patch of six standard deviations about the image of ``source_um``."""
        step = self._camera.step_um(source_um[2])
        row = self._centre[0] + source_um[1] / step
        column = self._centre[1] + source_um[0] / step
        sigma = self._sigma(source_um[2])
        half = math.ceil(3 * sigma)
        top, left = math.floor(row + 0.5) - half, math.floor(column + 0.5) - half
        rows, columns = np.arange(top, top + 2 * half + 1), np.arange(left, left + 2 * half + 1)
        peak = self._rate * exposure_s / sigma**2
        down = self._profile(rows, row, sigma, self._plan.period[0])
        along = self._profile(columns, column, sigma, self._plan.period[1])
        return Patch(top, left, np.multiply.outer((peak * down).astype(np.float32), along.astype(np.float32)))

    @staticmethod
    def _profile(pixels: NDArray[Any], middle: float, sigma: float, period: int) -> NDArray[np.float64]:
        mask = 0.75 + 0.25 * np.cos((2 * math.pi / period) * (pixels % period))
        profile: NDArray[np.float64] = mask * np.exp(-((pixels - middle) ** 2) / (2 * sigma**2))
        return profile


class FramesRenderer:
    """Frames of a `FrameSource` (a simulated camera, a recorded session) as what the optics make.

    The frame of the plan's position nearest to the source is taken, scaled by the exposure; its own noise and
    black level stay in it. A source more than half a step from every position is an error: the frames do not
    tell what is seen there.

    Parameters
    ----------
    plan
        The plan the frames belong to.
    frames
        One full sensor frame per position.
    """

    def __init__(self, plan: ScanPlan, frames: FrameSource) -> None:
        if tuple(frames.shape) != tuple(plan.camera.sensor.shape):
            raise InputError(
                expectation("frames", f"the sensor's shape {plan.camera.sensor.shape}", frames.shape, "match them")
            )
        self._plan, self._frames = plan, frames
        self._index = {tuple(frames.position(k)): k for k in range(len(frames))}

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> Patch:
        """Return the frame's part that lies in ``roi``."""
        plan = self._plan
        z = int(np.argmin(np.abs(np.array(plan.depths_um) - source_um[2])))
        step = plan.camera.step_um(plan.depths_um[z])
        centre, factors = plan.camera.sensor.centre_px, plan.resample_factors
        y, x = (round((centre[k] + source_um[1 - k] / step - plan.anchor[k]) * factors[k]) for k in range(2))
        index = self._index.get((z, y, x))
        if index is None:
            raise InputError(
                expectation("simulated source", "a position of the plan", f"(z, y, x) = {(z, y, x)}",
                            "use the built-in pattern for control frames and set-up")
            )  # fmt: skip
        exposures = plan.exposure_s if isinstance(plan.exposure_s, tuple) else (plan.exposure_s,) * len(plan.depths_um)
        frame = self._frames.read(index)[roi.row : roi.row + roi.rows, roi.column : roi.column + roi.columns]
        black = plan.camera.sensor.black_level
        return Patch(roi.row, roi.column, (frame - np.float32(black)).clip(0) * np.float32(exposure_s / exposures[z]))
