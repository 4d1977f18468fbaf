"""Renderers for the simulated camera: a built-in quick pattern, or frames of another source."""

from __future__ import annotations

import functools
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, format_pixels
from lfcal.camera import ScanPlan, half_extent_px
from lfcal.devices.protocols import Point, Roi
from lfcal.devices.simulated._camera import LightPatch
from lfcal.frames import FrameSource

if TYPE_CHECKING:
    from lfcal.simulate.effects import Effect

__all__ = ["FramesRenderer", "PatternRenderer", "chosen_effects", "lit", "simulated_optics"]


LIT_S = 0.02
"""Exposure (s) of a new plan, at which the brightest plane reaches its intended peak."""

TOLERANCE = 0.01
"""Relative L1 error of simulated optics with effects; with 5 %, a fit of 24 frames reported an incomplete model."""

OFF_PLANE_PX = 0.5
"""Change of the radius of the aperture's shadow above which a source is not in a plane of the plan."""

GRID_TOLERANCE = 0.003
"""Relative L1 error at level ``grid``, because a fit of many frames detects errors far below the noise of one frame."""


def lit(plan: ScanPlan) -> ScanPlan:
    """Return ``plan`` with the exposure that determines the brightness of the source.

    A real source does not change when the exposures of a plan change, for example between two parts of a session.
    """
    return replace(plan, exposure_s=LIT_S)


class PatternRenderer:
    """A fast substitute for plenoptic optics: a blurred disc seen through a periodic mask.

    The disc is at the paraxial image of the source and grows with its distance from the native plane. The mask has
    exactly the plan's period, so the resulting H is periodic. Use it to test sessions, not to assess a PSF.

    Parameters
    ----------
    plan
        Camera, period and depths.
    peak
        Peak of the brightest plane at an exposure of 20 ms, as a fraction of the range between black and saturation.
    """

    optics = "pattern"

    def __init__(self, plan: ScanPlan, *, peak: float = 0.6) -> None:
        self._plan = plan
        self._camera = plan.camera
        self._centre = plan.camera.sensor.centre_px
        self._limit = max(1.0, (min(plan.cutout) - 1) / 2)
        brightest = LIT_S / min(map(self._sigma, plan.depths_um)) ** 2
        sensor = plan.camera.sensor
        self._rate = peak * (sensor.max_value - sensor.black_level) / brightest

    def _sigma(self, depth_um: float) -> float:
        if self._camera.has_lattice:
            blur = 0.3 * abs(self._camera.virtual_depth(depth_um))
        else:  # as much as the spots move
            blur = 0.3 * abs(half_extent_px(self._camera, depth_um) - half_extent_px(self._camera, 0.0))
        return min(1.5 + blur, self._limit / 3)

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        """Return a patch that extends six standard deviations about the image of ``source_um``."""
        step = self._camera.step_um(source_um[2])
        row = self._centre[0] + source_um[1] / step
        column = self._centre[1] + source_um[0] / step
        sigma = self._sigma(source_um[2])
        peak = np.float32(self._rate * exposure_s / sigma**2)
        # rounded, so that the cache also works for the same position reached along another path
        top, down = _profile(round(row, 6), sigma, self._plan.period[0])
        left, along = _profile(round(column, 6), sigma, self._plan.period[1])
        return LightPatch(top, left, np.multiply.outer(peak * down, along))


@functools.lru_cache(maxsize=4096)
def _profile(middle: float, sigma: float, period: int) -> tuple[int, NDArray[np.float32]]:
    """Return first pixel and values of a Gaussian around ``middle``, seen through a mask of period ``period``."""
    half = math.ceil(3 * sigma)
    first = math.floor(middle + 0.5) - half
    pixels = np.arange(first, first + 2 * half + 1)
    # depends on the pixel, not on the source, because the lenslets do not move
    mask = 0.75 + 0.25 * np.cos((2 * math.pi / period) * (pixels % period))
    return first, (mask * np.exp(-((pixels - middle) ** 2) / (2 * sigma**2))).astype(np.float32)


@runtime_checkable
class LitFrames(Protocol):
    """Frames whose light is known before sensor noise, such as `lfcal.simulate.SimulatedCamera`."""

    def patch(self, index: int) -> tuple[int, int, NDArray[Any]]:
        """Return first row and column of the lit part of a frame, and its photoelectrons ``(rows, columns)``."""
        ...

    def patch_of(self, source_um: Point) -> tuple[int, int, NDArray[Any]]:
        """Return the patch for a source at any position (right, down, away) (µm)."""
        ...


class FramesRenderer:
    """Use frames of a `FrameSource` (a simulated camera, a recorded session) as the light of the optics.

    The frame of the nearest position of the plan is used, shifted by whole periods where necessary, and scaled by the
    exposure. The camera adds black level and noise. `LitFrames` provide noise-free electrons, computed for the actual
    position between and beyond the planes. Other frames should be free of noise.

    Parameters
    ----------
    plan
        The plan of the frames.
    frames
        One full sensor frame per position, in sample values with the sensor's black level.
    """

    def __init__(self, plan: ScanPlan, frames: FrameSource) -> None:
        if tuple(frames.shape) != tuple(plan.camera.sensor.shape):
            raise InputError.expected(
                "frames",
                f"{format_pixels(plan.camera.sensor.shape)}, as the sensor has",
                format_pixels(frames.shape),
                "give frames of this sensor",
            )
        self._plan, self._frames = plan, frames
        # a live view shows the same position repeatedly
        self._patch_of = functools.lru_cache(maxsize=2)(frames.patch_of) if isinstance(frames, LitFrames) else None
        self._index = {tuple(frames.info(k).position): k for k in range(len(frames))}

    @property
    def optics(self) -> str:
        """Level of the simulator; ``"frames"`` if the source of frames states none."""
        return str((self._frames.metadata.simulated or {}).get("level", "frames"))

    def render(self, source_um: Point, exposure_s: float, roi: Roi) -> LightPatch:
        """Return the frame of the nearest position, or of the actual position between planes; ``roi`` is ignored."""
        plan = self._plan
        z = int(np.argmin(np.abs(np.array(plan.depths_um) - source_um[2])))
        if self._patch_of is not None and self._off_plane(source_um[2], z):
            row, column, electrons = self._patch_of(tuple(round(value, 3) for value in source_um))
            counts = electrons * np.float32(exposure_s / plan.exposures[z] / plan.camera.sensor.electrons_per_count)
            return LightPatch(row, column, counts)
        step = plan.camera.step_um(plan.depths_um[z])
        centre, factors = plan.camera.sensor.centre_px, plan.resample_factors
        steps = [round((centre[k] + source_um[1 - k] / step - plan.anchor[k]) * factors[k]) for k in range(2)]
        # whole periods away, the pattern is the same but displaced
        (ky, y), (kx, x) = (divmod(n, period) for n, period in zip(steps, plan.period, strict=True))
        index = self._index.get((z, y, x))
        if index is None:
            raise InputError.expected(
                "simulated frames", f"a frame of position (z, y, x) = {(z, y, x)}", "none", "simulate this position too"
            )
        top, left, light = self._light(index)
        shift = round(ky * plan.period[0] / factors[0]), round(kx * plan.period[1] / factors[1])
        return LightPatch(top + shift[0], left + shift[1], light * np.float32(exposure_s / plan.exposures[z]))

    def _off_plane(self, depth_um: float, z: int) -> bool:
        """Return whether the image differs from the image of plane ``z``: in shadow size by over `OFF_PLANE_PX`."""
        camera = self._plan.camera
        there, planned = (half_extent_px(camera, depth) for depth in (depth_um, self._plan.depths_um[z]))
        return abs(there - planned) > OFF_PLANE_PX

    def _light(self, index: int) -> LightPatch:
        """Return counts above black of frame ``index``."""
        sensor = self._plan.camera.sensor
        if isinstance(self._frames, LitFrames):
            row, column, electrons = self._frames.patch(index)
            return LightPatch(row, column, electrons * np.float32(1 / sensor.electrons_per_count))
        return LightPatch(0, 0, (self._frames.read(index) - np.float32(sensor.black_level)).clip(0))


def simulated_optics(plan: ScanPlan, level: str, effects: str = "") -> FramesRenderer:
    """Return the plenoptic camera of ``plan``, simulated at ``level``, with ideal optics or with effects.

    The result is free of noise; `SimCamera` adds the noise of the sensor. The brightest pixel reaches 80 % of the full
    well in 20 ms, whatever the exposures of the plan. ``level`` is ``"auto"``, ``"geometric"``,
    ``"wave"``, ``"grid"`` (slower, and as fine as a fit) or ``"microscope"``. ``effects`` is a JSON file as in
    `lfcal.simulate.effects.described.read_entries`, whose effects on H are simulated together with those that
    `plan_effects` finds necessary; or ``"auto"``: only the latter. Ideal optics focus a point into a single pixel of
    each micro-image, which cannot be distinguished from a hot pixel. Raises `InputError` if the level does not suit the
    plan's camera, or the file has no effects.
    """
    # imported here, so that the quick pattern does not load the simulator
    from lfcal.simulate import SimulatedCamera

    plan = lit(plan)
    if not effects:
        return FramesRenderer(plan, SimulatedCamera(plan, (), level=level))
    fine = GRID_TOLERANCE if level == "grid" else TOLERANCE
    return FramesRenderer(plan, SimulatedCamera(plan, chosen_effects(plan, effects), level=level, tolerance=fine))


def chosen_effects(plan: ScanPlan, effects: str, tolerance: float = TOLERANCE) -> tuple[Effect, ...]:
    """Return the effects of a JSON file together with the necessary ones, or for ``"auto"`` only the latter."""
    from lfcal.simulate import plan_effects
    from lfcal.simulate.effects import parse_entries

    if effects == "auto":
        return plan_effects(plan, tolerance).effects
    settings, given = parse_entries(effects)
    return plan_effects(plan, tolerance, settings, effects=given).effects
