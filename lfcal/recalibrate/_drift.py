"""Drift of the array in a frame of an unknown object, for an H that stays fixed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lfcal.fit import Fineness, ScanScales, Setup, Vector
from lfcal.recalibrate._frames import in_window
from lfcal.recalibrate._patterns import VoxelPatterns
from lfcal.recalibrate._scene import ObjectFrame, estimate_scene
from lfcal.recalibrate._window import SensorWindow
from lfcal.recalibrate.model import STEP, Contents, WindowModel
from lfcal.recalibrate.score import Goodness, Score, score_and_goodness

__all__ = ["COPIES", "DRIFTS", "FLOORS", "DriftWindow"]

F4 = NDArray[np.float32]

DRIFTS = ("offset_x_um", "offset_y_um", "gap_um")
"""Unknowns that are measured in each frame: shift of the array (px) in x and y, and change of the gap (%)."""

FLOORS = np.array([0.001, 0.001, 0.02])
"""Error of the model for the three drifts (px, px, %): stated noise does not include it."""

ITERATIONS = 50
"""Iterations for the object of a frame."""

SAMPLING = Fineness.fine

COPIES = len(DRIFTS) + 2
"""Number of arrays of the size of all patterns that a window needs."""


class DriftWindow:
    """H and its derivatives with respect to the three drifts over a window, computed once for all frames.

    Parameters
    ----------
    window
        The window.
    setup
        Camera and effects of H.
    contents
        Assumptions about the contents of frames.
    workers
        Number of threads; None: all processors.
    """

    def __init__(self, window: SensorWindow, setup: Setup, contents: Contents, workers: int | None) -> None:
        self.window, self._model = window, WindowModel(window, (), contents, workers)
        self._vector = Vector(setup, ScanScales.of(window.plan), ("geometry",))
        self._patterns: VoxelPatterns
        self._derivatives: list[VoxelPatterns] = []

    def iter_prepared(self, at: NDArray[np.float64]) -> Iterator[None]:
        """Compute H and its derivatives at a drift ``at`` (px, px, %), in as many steps as there are results: 1 + 3."""
        self._derivatives = []
        names = [one.name for one in self._vector.unknowns]
        camera = self._vector.setup.camera
        units = (camera.sensor.pixel_um, camera.sensor.pixel_um, 0.01 * camera.lattice.gap_um)
        start = self._vector.at(dict(zip(DRIFTS, (at * units).tolist(), strict=True)))
        self._patterns = self._model.patterns(self._vector.setup_at(start), SAMPLING)
        yield
        for name, unit in zip(DRIFTS, units, strict=True):
            k = names.index(name)
            moved = start.copy()
            moved[k] += STEP
            other = self._model.patterns(self._vector.setup_at(moved), SAMPLING)
            size = np.float32(STEP * self._vector.unknowns[k].scale / unit)
            np.subtract(other.values, self._patterns.values, out=other.values)
            np.divide(other.values, size, out=other.values)
            self._derivatives.append(other)
            yield

    def measured(self, whole: ObjectFrame) -> tuple[Score, Goodness] | None:
        """Return the score of a frame of the whole sensor for the drifts, and the goodness of fit after their step.

        The result is None if no pixel of the window is valid.
        """
        frame, fields = in_window(whole, self.window), self._model.fields
        if not frame.valid.any():
            return None
        scene = estimate_scene(self._patterns, frame, fields, ITERATIONS)
        images = np.concatenate([one.images(scene.volume[None]) for one in self._derivatives])
        return score_and_goodness(self._patterns, frame, scene, images, fields)
