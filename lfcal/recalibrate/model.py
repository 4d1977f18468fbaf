"""Assumptions about the volume and the dark field of a frame, and the model of the frames of one window."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, chunks, worker_count
from lfcal.fit import Setup, Vector
from lfcal.recalibrate._patterns import VoxelPatterns, Voxels, every_voxel, patterns_at
from lfcal.recalibrate._scene import ObjectFrame, SceneEstimate, dark_fields, estimate_scene
from lfcal.recalibrate._window import SensorWindow
from lfcal.recalibrate.score import Goodness, Score, goodness, score_of
from lfcal.simulate import Sampling

__all__ = ["COPIES", "DEPTH_SCALE", "Contents", "WindowModel", "stated_contents"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

STEP = 0.25
"""Step of a finite difference, in scales of its unknown."""

PARTS = 4
"""Number of parts in which the patterns of all voxels are computed for a derivative, to limit memory."""

COPIES = 1 + 1 / PARTS
"""Memory of a window, relative to that of the patterns of all its voxels."""

DEPTH_SCALE = 0.01
"""Unit in which a change of the scale of the depths is measured, as a fraction."""


@dataclass(frozen=True)
class Contents:
    """Assumptions about the contents of frames.

    Attributes
    ----------
    depths_um
        Depths of the planes of the volume (µm).
    halves
        Whether the volume has four voxels per source position, half a pixel apart, instead of one.
    dark_parts
        Number of pieces of the smooth dark field along each side; 1: a bilinear field.
    """

    depths_um: tuple[float, ...]
    halves: bool = False
    dark_parts: int = 1


def stated_contents(provenance: Mapping[str, Any]) -> Contents | None:
    """Return the assumptions about the frames on which an H was recalibrated; None if its ``provenance`` has none.

    Raise `InputError` if they are incomplete.
    """
    origin = provenance.get("recalibration")
    said = origin.get("contents") if isinstance(origin, Mapping) else None
    if not isinstance(said, Mapping):
        return None
    try:
        depths = tuple(float(z) for z in said["depths_um"])
        return Contents(depths, bool(said["halves"]), int(said["dark_parts"]))
    except (KeyError, TypeError, ValueError):
        raise InputError.expected(
            "description of the frames in H",
            "that of a recalibration",
            "an incomplete one",
            "run lfcal fit frames again",
        ) from None


class WindowModel:
    """Frames of one window, with the model that explains them.

    Parameters
    ----------
    window, frames
        The window, and its part of each frame.
    contents
        Assumptions about the volume and the dark field.
    workers
        Number of threads. None: all processors.
    """

    def __init__(
        self, window: SensorWindow, frames: Sequence[ObjectFrame], contents: Contents, workers: int | None = None
    ) -> None:
        self.frames, self.contents, self.workers = tuple(frames), contents, worker_count(workers)
        self.plan = replace(window.plan, depths_um=contents.depths_um, exposure_s=window.plan.exposures[0])
        self._planned = window.plan.depths_um
        self.fields = dark_fields(window.shape, contents.dark_parts)
        self._voxels = every_voxel(self.plan, halves=contents.halves)

    @property
    def voxels(self) -> int:
        """Number of voxels."""
        return len(self._voxels[0])

    def rows_of(self, count: int) -> Voxels:
        """Return the voxels in the middle ``count`` rows of each plane, or in all rows if there are fewer."""
        places, offsets = self._voxels
        rows = self.plan.period[0]
        first = max(0, (rows - count) // 2)
        own = (places[:, 1] >= first) & (places[:, 1] < first + count)
        return places[own], offsets[own]

    @property
    def memory(self) -> float:
        """Largest memory of the patterns that are kept at a time (bytes)."""
        return COPIES * 4 * self.voxels * math.prod(self.plan.cutout)

    def patterns(self, setup: Setup, sampling: Sampling, voxels: Voxels | None = None) -> VoxelPatterns:
        """Return the patterns of ``voxels`` (None: all) for the camera in ``setup``, computed with ``sampling``."""
        own = self._voxels if voxels is None else voxels
        order = np.argsort(self._planned)
        known, errors = np.array(self._planned)[order], np.array(setup.depth_errors_um)[order]
        moved = tuple(np.interp(self.contents.depths_um, known, errors).tolist())
        return patterns_at(replace(setup, depth_errors_um=moved), self.plan, own, sampling, self.workers)

    def scenes(self, patterns: VoxelPatterns, iterations: int) -> list[SceneEstimate]:
        """Return the object and the dark field of each frame, estimated in ``iterations`` iterations."""
        return [estimate_scene(patterns, frame, self.fields, iterations) for frame in self.frames]

    def score(self, patterns: VoxelPatterns, scenes: Sequence[SceneEstimate], derivatives: F4) -> Score:
        """Return the score of all frames together.

        ``scenes`` are the estimated objects of the frames. ``derivatives`` are those of the expected frames with
        respect to the unknowns, ``(k, frames, rows, columns)``.
        """
        parts = zip(self.frames, scenes, np.moveaxis(derivatives, 1, 0), strict=True)
        scores = [score_of(patterns, frame, scene, own, self.fields) for frame, scene, own in parts]
        return sum(scores, Score.none(len(derivatives)))

    def goodness(self, patterns: VoxelPatterns, scenes: Sequence[SceneEstimate]) -> list[Goodness]:
        """Return the goodness of fit of each frame: see `lfcal.recalibrate.score.goodness`."""
        pairs = zip(self.frames, scenes, strict=True)
        return [goodness(patterns, frame, scene, self.fields) for frame, scene in pairs]

    def derivatives(
        self,
        vector: Vector,
        u: F8,
        patterns: VoxelPatterns,
        scenes: Sequence[SceneEstimate],
        sampling: Sampling,
        bright: float,
    ) -> F4:
        """Return the derivatives ``(k + 1, frames, rows, columns)`` of all expected frames for fixed volumes.

        The first k are those with respect to the unknowns of ``vector`` at the values ``u`` ``(k,)``. The last one is
        that with respect to a common factor of all image distances from the array, in units of `DEPTH_SCALE`. For each
        of ``scenes``, the brightest voxels that contain the fraction ``bright`` of its light are used. ``patterns`` are
        those for ``u``, computed with ``sampling``.
        """
        light = patterns.values.sum((1, 2))
        keep = np.logical_or.reduce([_brightest(scene.volume * light, bright) for scene in scenes])
        some, volumes = patterns.of(keep), np.stack([scene.volume[keep] for scene in scenes])
        base = some.images(volumes)
        found = np.empty((len(u) + 1, *base.shape), np.float32)
        for k, (setup, step) in enumerate(self._displaced(vector, u)):
            moved = np.zeros_like(base)
            for start, stop in chunks(len(some), math.ceil(PARTS * len(some) / len(patterns))):
                own = slice(start, stop)
                moved += self.patterns(setup, sampling, (some.places[own], some.offsets_px[own])).images(
                    volumes[:, own]
                )
            found[k] = (moved - base) / np.float32(step)
        return found

    def _displaced(self, vector: Vector, u: F8) -> Iterator[tuple[Setup, float]]:
        """Yield a setup for each unknown and for the scale of the depths, and its step from ``u``."""
        for k in range(len(u)):
            moved = u.copy()
            moved[k] += STEP
            step = STEP if np.isclose(vector.clipped(moved)[k], moved[k]) else -STEP
            moved[k] = u[k] + step
            yield vector.setup_at(moved), step
        setup = vector.setup_at(u)
        pairs = zip(setup.depth_errors_um, self._planned, strict=True)
        errors = tuple(error + STEP * DEPTH_SCALE * _lever(setup, z) for error, z in pairs)
        yield replace(setup, depth_errors_um=errors), STEP


def _lever(setup: Setup, z_um: float) -> float:
    """Return the change of a depth (µm) per relative change of the distance of its image from the array."""
    camera, small = setup.camera, 1e-4 * max(1.0, abs(z_um))
    image = camera.image_shift_um(z_um)
    return image * small / (camera.image_shift_um(z_um + small) - image)


def _brightest(light: F4, fraction: float) -> NDArray[np.bool_]:
    """Return a mask of the fewest voxels that contain a ``fraction`` of the light ``(n,)``."""
    order = np.argsort(-light)
    total = np.cumsum(light[order], dtype=np.float64)
    keep = np.zeros(len(light), np.bool_)
    keep[order[: int(np.searchsorted(total, fraction * total[-1])) + 1]] = True
    return keep
