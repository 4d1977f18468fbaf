"""Simulate frames of a target: the light of all its holes on the whole sensor."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import (
    Clock,
    InputError,
    Region,
    Work,
    array_words,
    check_region,
    for_each_chunk,
    one_blas_thread,
    worker_count,
)
from lfcal.camera import half_extent_px
from lfcal.frames import FrameInfo, FrameMetadata, Frames
from lfcal.simulate import EffectsLike, Sampling, SimulatedCamera, budgeted, plan_effects, tolerance_for
from lfcal.simulate.effects import FiniteSource, MotionEffect
from lfcal.simulate.sensor import FrameKind, Responses, Window, place
from lfcal.targets.images import HoleImages, hole_images
from lfcal.targets.plan import TargetPlan
from lfcal.targets.target import Target

__all__ = ["TargetCamera", "uneven"]

DEPTH_PX = 0.05
"""Change of the aperture shadow's radius below which two holes are computed at one depth."""

REGIONS = 256
"""Largest number of parts of the sensor; each is computed with the optics of its middle."""


class _Hole(NamedTuple):
    """A hole in a frame: its image (row, column), its distance behind the plane (µm), and its relative light."""

    pixel: tuple[float, float]
    farther_um: float
    brightness: float


class TargetCamera(Frames):
    """Source of simulated frames that show a target at the positions of a plan, in the order of the plan.

    Every hole is a source at its depth, imaged by the optics of its region of the field (with mechanical vignetting,
    field curvature and distortion). The light of all holes is added, and then converted to a frame by the model of the
    sensor. Exposure times are those of the scan, in which the brightest pixel of a single source reaches the fraction
    ``peak`` of the full well.

    Parameters
    ----------
    plan
        The plan, with the target and its offsets.
    effects
        As in `SimulatedCamera`, but without motion. The diameter of the sources is the ``hole_um`` of the target,
        unless the effects include `FiniteSource`.
    really
        The actual target, if it differs from the planned one in pose, pitch or missing holes. None: as planned.
    brightness
        Light of each hole of the actual target relative to that of the scan's source, ``(n,)`` in the order of
        `Target.holes`. None: all 1. See `uneven`.
    level, tolerance, sampling, peak, seed
        As in `SimulatedCamera`.

    Raises
    ------
    InputError
        If ``brightness`` does not have one finite value of 0 or more for each hole, or an effect moves the source.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import TargetCamera, TargetPlan, parse_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> offsets = (((0.0, 0.0), (0.0, 7.0)),)
    >>> plan = TargetPlan(scan, parse_target("array:3x3@2mm"), offsets, 0.1, (0.0,), "geometric")
    >>> frames = TargetCamera(plan, effects=(), level="geometric")
    >>> for k in range(len(frames)):
    ...     print(frames.read(k).shape, "middle hole at", frames.points(k).pixels[4].round(3).tolist())
    (320, 320) middle hole at [159.5, 159.5]
    (320, 320) middle hole at [159.5, 166.5]
    """

    def __init__(
        self,
        plan: TargetPlan,
        effects: EffectsLike = "auto",
        *,
        really: Target | None = None,
        brightness: ArrayLike | None = None,
        level: str = "auto",
        tolerance: float | None = None,
        sampling: Sampling | None = None,
        peak: float = 0.8,
        seed: int = 0,
    ) -> None:
        self.plan, self.target = plan, really or plan.target
        scan = plan.scan
        if effects == "auto":
            effects = plan_effects(scan, tolerance_for(effects, tolerance), frames=True, peak=peak).effects
        budget = budgeted(effects, scan, tolerance)
        chosen = budget.effects
        if any(isinstance(effect, MotionEffect) for effect in chosen):
            raise InputError.expected(
                "effects of a target's frames",
                "no effect of stage motion",
                next(effect.name for effect in chosen if isinstance(effect, MotionEffect)),
                "leave this effect out",
            )
        if self.target.hole_um > 0 and not any(isinstance(effect, FiniteSource) for effect in chosen):
            chosen = (*chosen, FiniteSource(self.target.hole_um))
        count = len(self.target.holes)
        light = np.ones(count) if brightness is None else np.asarray(brightness, float)
        if light.shape != (count,) or not np.isfinite(light).all() or (light < 0).any():
            wanted = f"{count} values of 0 or more, one for each hole"
            raise InputError.expected(
                "brightness of holes",
                wanted,
                array_words(light),
                "list the holes in the order of the target, with 0 for dark ones",
            )
        self.brightness: NDArray[np.float64] = light
        # only light; the sensor is applied once for all holes
        self.single = SimulatedCamera(
            scan,
            chosen,
            level=level,
            tolerance=budget.tolerance,
            sampling=sampling,
            peak=peak,
            seed=seed,
        )
        self._middle = Responses(scan, self.single.budget, level, sampling)
        self._regions: dict[tuple[int, int], Responses] = {}
        self._side = max(1, math.ceil(math.sqrt(math.prod(self.shape) / REGIONS)))
        self._lock = threading.Lock()
        self._frames = plan.frames

    # -- frame source ----------------------------------------------------------------------------------
    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of every frame, that of the sensor (px)."""
        return self.single.shape

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type: uint16, or float32 if sample values are not rounded."""
        return self.single.dtype

    @cached_property
    def metadata(self) -> FrameMetadata:
        """Metadata of a `SimulatedCamera` of the scan, without its numbers of positions (``plan_shape``)."""
        return replace(self.single.metadata, plan_shape=None)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._frames)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index`` without positions, which must be detected in the frame."""
        z, k = self._at(index)
        label = f"simulated target {index} (z {z}, offset {k})"
        return FrameInfo((), exposure_s=self.plan.scan.exposures[z], label=label)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index`` in counts, or its ``region`` (row and column slices).

        The whole frame is computed, even for a region.
        """
        frame = self.exposed(self.light(index), index)
        return frame if region is None else np.ascontiguousarray(frame[check_region(region, self.shape)])

    # -- light -----------------------------------------------------------------------------------------
    def points(self, index: int) -> HoleImages:
        """Return the actual positions of the images of all holes in frame ``index``, from paraxial chief rays.

        If frames of the plan show several offsets together, ``index`` is that of a single offset instead.
        """
        z, k = self._at(index)
        return self._moved(z, self.plan.offsets_px[z][k])

    def light(self, index: int) -> NDArray[np.float32]:
        """Return the photoelectrons of frame ``index``, ``(rows, columns)``, before effects of the sensor."""
        z, k = self._at(index)
        lit = self.plan.lit_in(z, k)
        found = self.light_at(z, self.plan.offsets_px[z][lit[0]])
        for other in lit[1:]:
            found = found + self.light_at(z, self.plan.offsets_px[z][other])
        return found

    def light_at(self, z: int, offset_px: tuple[float, float]) -> NDArray[np.float32]:
        """Return the photoelectrons ``(rows, columns)`` of a frame of plane ``z`` that shows the offset ``offset_px``.

        The offset is the displacement (rows, columns) of the images of holes in the depth plane (px).
        """
        out = np.zeros(self.shape, np.float32)
        # one depth after the other, to reuse results
        for hole in sorted(self._seen_holes(z, offset_px), key=lambda hole: hole.farther_um):
            responses = self._region(self._region_of(hole.pixel))
            self._add(out, z, hole, responses)
        return out

    def iter_lights(self, frames: Sequence[int] | None = None, workers: int | None = None) -> Work[NDArray[np.float32]]:
        """Return the photoelectrons of several frames, ``(n, rows, columns)``, as `light` does for one frame.

        The optics of each region and depth are computed once for all frames and then released. Those of all regions
        together may not fit into memory.

        Parameters
        ----------
        frames
            Indices of the frames. None: all.
        workers
            Number of threads. None: all processors.
        """
        chosen = list(range(len(self))) if frames is None else list(frames)
        out = np.zeros((len(chosen), *self.shape), np.float32)
        groups: dict[tuple[int, int, int, float], list[tuple[int, _Hole]]] = {}
        for n, index in enumerate(chosen):
            z, k = self._at(index)
            for offset in (self.plan.offsets_px[z][one] for one in self.plan.lit_in(z, k)):
                for hole in self._seen_holes(z, offset):
                    key = (z, *self._region_of(hole.pixel), hole.farther_um)
                    groups.setdefault(key, []).append((n, hole))
        keys, lock = sorted(groups, key=lambda key: (key[0], key[3], key[1:3])), threading.Lock()
        for z in {key[0] for key in keys}:
            self._middle.at(z)
            self.single.electrons_per_unit(z)
        clock, count = Clock("light of the target's frames", len(keys)), worker_count(workers)
        yield clock.at(0)

        def some(start: int, stop: int) -> None:
            for key in keys[start:stop]:
                responses = self._made(key[1:3])
                for n, hole in groups[key]:
                    windows = self._windows(key[0], hole, responses)
                    with lock:
                        for top, left, values in windows:
                            place(out[n], values, top, left)

        with one_blas_thread():
            for first in range(0, len(keys), 4 * count):
                last = min(len(keys), first + 4 * count)
                for_each_chunk(lambda a, b, at=first: some(at + a, at + b), last - first, count)  # type: ignore[misc]
                yield clock.at(last)
        return out

    def exposed(self, light_e: NDArray[np.float32], index: int) -> NDArray[Any]:
        """Return frame ``index`` in counts, from its photoelectrons ``light_e``, as returned by `light`."""
        z, _ = self._at(index)
        return self.single.expose(light_e, self.plan.scan.exposures[z], FrameKind.LIGHT, index)

    def _seen_holes(self, z: int, offset_px: tuple[float, float]) -> list[_Hole]:
        """Return the holes whose light reaches the sensor, each at its position."""
        points, camera = self._moved(z, offset_px), self.plan.scan.camera
        errors = self._depth_errors(z, points.away_um)
        found = []
        for k, (pixel, away) in enumerate(zip(points.pixels.tolist(), points.away_um.tolist(), strict=True)):
            row, column = pixel
            beside = max(-row, -column, row - self.shape[0], column - self.shape[1])
            reach = 2 * half_extent_px(camera, away) + max(self.plan.scan.cutout)
            if self.brightness[k] > 0 and beside < reach:
                found.append(_Hole((row, column), float(errors[k]), float(self.brightness[k])))
        return found

    def _add(self, out: NDArray[np.float32], z: int, hole: _Hole, responses: Responses) -> None:
        for top, left, values in self._windows(z, hole, responses):
            place(out, values, top, left)

    def _windows(self, z: int, hole: _Hole, responses: Responses) -> list[Window]:
        """Return the photoelectrons of a hole in windows, with the positions of the windows on the sensor."""
        factor = np.float32(hole.brightness * self.single.electrons_per_unit(z))
        found = responses.windows(z, hole.farther_um, hole.pixel)
        return [(top, left, factor * values) for top, left, values in found]

    def _moved(self, z: int, offset_px: tuple[float, float]) -> HoleImages:
        images = hole_images(self.target, self.plan.scan.camera, self.plan.scan.depths_um[z])
        return replace(images, pixels=images.moved(np.array(offset_px)))

    def _region_of(self, pixel: tuple[float, float]) -> tuple[int, int]:
        """Return the index (row, column) of the region that contains a pixel (row, column)."""
        return math.floor(pixel[0] / self._side), math.floor(pixel[1] / self._side)

    def _region(self, key: tuple[int, int]) -> Responses:
        """Return the responses of a region, which are cached for the next frame."""
        with self._lock:
            if key not in self._regions:
                self._regions[key] = self._made(key)
            return self._regions[key]

    def _made(self, key: tuple[int, int]) -> Responses:
        """Return the responses of a region."""
        own = replace(self.plan.scan, anchor=self._anchor(key))
        return Responses(own, self.single.budget, self.single.level, self.single.sampling, like=self._middle)

    def _anchor(self, key: tuple[int, int]) -> tuple[float, float]:
        """Return the image of the scan's first position if its cell is in the middle of a region.

        A region at the rim has the optics of the nearest position at which a scan's cutouts are on the sensor.
        """
        scan, moved = self.plan.scan, []
        for k, at, n, side, own in zip(key, scan.anchor, scan.period, scan.cutout, self.shape, strict=True):
            least, most = (side - 1) // 2, own - 1 - (side - 1) // 2 - (n - 1)
            wanted = at + round((k + 0.5) * self._side - at - (n - 1) / 2)
            # the cutout is centred on the nearest pixel; halves are rounded down
            rest = at - math.floor(at + 0.5)
            moved.append(min(max(wanted, least + rest), most + rest))
        return moved[0], moved[1]

    def _depth_errors(self, z: int, away_um: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance of each hole behind the plane (µm), rounded to steps that change no shadow."""
        camera, depth = self.plan.scan.camera, self.plan.scan.depths_um[z]
        errors = away_um - depth
        widest = float(np.abs(errors).max(initial=0.0))
        if widest == 0:
            return errors
        change = max(abs(half_extent_px(camera, depth + e) - half_extent_px(camera, depth)) for e in (widest, -widest))
        step = widest / max(1, math.ceil(change / DEPTH_PX))
        rounded: NDArray[np.float64] = np.rint(errors / step) * step
        return rounded

    def _at(self, index: int) -> tuple[int, int]:
        if not 0 <= index < len(self):
            raise InputError.expected("frame index", f"0 to {len(self) - 1}", index, "choose one in this range")
        return self._frames[index]


def uneven(target: Target, spread: float, seed: int = 0) -> NDArray[np.float64]:
    """Return random brightness values of the n holes of ``target``, ``(n,)``, normally distributed around 1.

    ``spread`` is the standard deviation, and ``seed`` the random seed. Brightness values below 0 are set to 0.

    Examples
    --------
    >>> from lfcal.targets import parse_target, uneven
    >>> light = uneven(parse_target("array:100x100@1mm"), 0.1, seed=1)
    >>> print(f"{len(light)} holes, mean {light.mean():.2f}, standard deviation {light.std():.2f}")
    10000 holes, mean 1.00, standard deviation 0.10
    """
    draws = np.random.default_rng(seed).normal(1.0, spread, len(target.holes))
    light: NDArray[np.float64] = np.maximum(draws, 0.0)
    return light
