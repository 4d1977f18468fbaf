"""What a volume of a frame may contain: planes, steps within a position, and the form of the dark field."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import worker_count
from lfcal.fit import Setup, Vector
from lfcal.recalibrate._patterns import VoxelPatterns, Voxels, every_voxel, patterns_at
from lfcal.recalibrate._scene import ObjectFrame, SceneEstimate, dark_fields, estimate_scene
from lfcal.recalibrate._window import SensorWindow
from lfcal.recalibrate.score import Goodness, Score, goodness, score_of
from lfcal.simulate import Sampling

__all__ = ["Contents", "WindowModel"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

STEP = 0.25
"""Step of a finite difference, in scales of its unknown."""

BRIGHT = 0.995
"""Fraction of the light whose voxels determine derivatives; the many dark ones would cost most of the time."""


@dataclass(frozen=True)
class Contents:
    """Assumptions about the contents of frames.

    Attributes
    ----------
    depths_um
        Depths of the planes of the volume (µm).
    halves
        Whether the volume has four voxels per position, half a pixel apart.
    dark_parts
        Number of pieces of the smooth dark field along each side.
    """

    depths_um: tuple[float, ...]
    halves: bool = False
    dark_parts: int = 1

    def setup(self, setup: Setup) -> Setup:
        """Return ``setup`` with the planes of these contents."""
        return replace(setup, depth_errors_um=(0.0,) * len(self.depths_um))


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
        self.fields = dark_fields(window.shape, contents.dark_parts)
        self._voxels = every_voxel(self.plan, halves=contents.halves)

    def patterns(self, setup: Setup, sampling: Sampling, voxels: Voxels | None = None) -> VoxelPatterns:
        """Return the patterns of ``voxels``. None: of all."""
        own = self._voxels if voxels is None else voxels
        return patterns_at(self.contents.setup(setup), self.plan, own, sampling, self.workers)

    def scenes(self, patterns: VoxelPatterns, iterations: int) -> list[SceneEstimate]:
        """Return the estimated object of each frame."""
        return [estimate_scene(patterns, frame, self.fields, iterations) for frame in self.frames]

    def score(self, patterns: VoxelPatterns, scenes: Sequence[SceneEstimate], derivatives: F4) -> Score:
        """Return the score of all frames together, given the ``derivatives`` of their expected values."""
        parts = zip(self.frames, scenes, np.moveaxis(derivatives, 1, 0), strict=True)
        scores = [score_of(patterns, frame, scene, own, self.fields) for frame, scene, own in parts]
        return sum(scores, Score.none(len(derivatives)))

    def goodness(self, patterns: VoxelPatterns, scenes: Sequence[SceneEstimate]) -> list[Goodness]:
        """Return the goodness of fit of each frame: see `lfcal.recalibrate.score.goodness`."""
        pairs = zip(self.frames, scenes, strict=True)
        return [goodness(patterns, frame, scene, self.fields) for frame, scene in pairs]

    def derivatives(
        self, vector: Vector, u: F8, patterns: VoxelPatterns, scenes: Sequence[SceneEstimate], sampling: Sampling
    ) -> F4:
        """Return the derivatives of all expected frames ``(k, frames, rows, columns)`` for fixed volumes."""
        light = patterns.values.sum((1, 2))
        keep = np.logical_or.reduce([_brightest(scene.volume * light) for scene in scenes])
        some, volumes = patterns.of(keep), np.stack([scene.volume[keep] for scene in scenes])
        base = some.images(volumes)
        found = np.empty((len(u), *base.shape), np.float32)
        for k in range(len(u)):
            moved = u.copy()
            moved[k] += STEP
            step = STEP if np.isclose(vector.clipped(moved)[k], moved[k]) else -STEP
            moved[k] = u[k] + step
            displaced = self.patterns(vector.setup_at(moved), sampling, (some.places, some.offsets_px))
            found[k] = (displaced.images(volumes) - base) / np.float32(step)
        return found


def _brightest(light: F4) -> NDArray[np.bool_]:
    """Return a mask of the fewest voxels that contain the fraction `BRIGHT` of the light ``(n,)``."""
    order = np.argsort(-light)
    total = np.cumsum(light[order], dtype=np.float64)
    keep = np.zeros(len(light), np.bool_)
    keep[order[: int(np.searchsorted(total, BRIGHT * total[-1])) + 1]] = True
    return keep
