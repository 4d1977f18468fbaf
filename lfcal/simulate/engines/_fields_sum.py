"""Engines for light that is a sum of fields that do not interfere: one engine for each field, intensities added."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.simulate.engines._wave import WavePlane
from lfcal.simulate.engines.base import Certificate, Displaceable, PlaneEngine, Sampling
from lfcal.simulate.engines.field import field_modes
from lfcal.simulate.engines.grid import GridPlane
from lfcal.simulate.engines.reference import ReferencePlane
from lfcal.simulate.scene import Scene

__all__ = ["FieldsSum", "grid_plane", "reference_plane", "wave_plane"]

Maker = Callable[[Scene], PlaneEngine]
Kind = type[WavePlane] | type[ReferencePlane]


def wave_plane(scene: Scene, sampling: Sampling) -> PlaneEngine:
    """Return the engine of level ``"wave"``; for a vectorial scene, the sum over its fields."""
    return _plane(scene, sampling, WavePlane)


def grid_plane(scene: Scene, sampling: Sampling) -> PlaneEngine:
    """Return the engine of level ``"grid"``; for a vectorial scene, the sum over its fields."""
    modes = field_modes(scene)
    first = GridPlane(scene, sampling, modes[0])
    if len(modes) == 1:
        return first
    makers: list[Maker] = [partial(GridPlane, sampling=sampling, mode=mode) for mode in modes]
    return FieldsSum(scene, makers, [first, *(first.in_mode(mode) for mode in modes[1:])])


def reference_plane(scene: Scene, sampling: Sampling) -> PlaneEngine:
    """Return the engine of level ``"reference"``; for a vectorial scene, the sum over its fields."""
    return _plane(scene, sampling, ReferencePlane)


def _plane(scene: Scene, sampling: Sampling, kind: Kind) -> PlaneEngine:
    makers: list[Maker] = [partial(kind, sampling=sampling, mode=mode) for mode in field_modes(scene)]
    return makers[0](scene) if len(makers) == 1 else FieldsSum(scene, makers)


class FieldsSum:
    """Engine that adds the light of several engines of one scene; see `PlaneEngine`.

    Parameters
    ----------
    scene
        The scene to compute.
    makers
        Functions from a scene to an engine, one for each field.
    parts
        The engines of the scene, if they already exist; they may share tables.
    """

    def __init__(self, scene: Scene, makers: list[Maker], parts: list[PlaneEngine] | None = None) -> None:
        self._set_parts(scene, makers, [make(scene) for make in makers] if parts is None else parts)

    def _set_parts(self, scene: Scene, makers: list[Maker], parts: list[PlaneEngine]) -> None:
        self.scene, self._makers, self._parts = scene, makers, parts
        self.level = parts[0].level

    def displaced(self, offsets_um: NDArray[np.float64]) -> FieldsSum:
        """Return an engine of the same plane for displaced sources, which shares tables where its parts can share them.

        ``offsets_um`` is as in `Displaceable.displaced`.
        """
        scene, other = replace(self.scene, offsets_um=offsets_um), object.__new__(FieldsSum)
        pairs = zip(self._parts, self._makers, strict=True)
        parts = [p.displaced(offsets_um) if isinstance(p, Displaceable) else make(scene) for p, make in pairs]
        other._set_parts(scene, self._makers, parts)
        return other

    @property
    def grid_side(self) -> int:
        """Samples on a side of the grid; see `PlaneEngine.grid_side`."""
        return max(part.grid_side for part in self._parts)

    @property
    def certificate(self) -> Certificate:
        """Energy in and out of all responses so far, over all fields."""
        found = [part.certificate for part in self._parts]
        return Certificate(
            max(c.responses for c in found),
            sum(c.energy_in for c in found),
            sum(c.energy_out for c in found),
            max(c.worst for c in found),
        )

    def rows(
        self, ys: ArrayLike, xs: ArrayLike, out: NDArray[np.float32] | None = None, workers: int | None = None
    ) -> NDArray[np.float32]:
        """Return the cutouts of positions ys x xs; see `PlaneEngine.rows`."""
        result = self._parts[0].rows(ys, xs, out, workers)
        for part in self._parts[1:]:
            result += part.rows(ys, xs, workers=workers)
        return result

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout for a chief ray that meets the sensor at (``y_um``, ``x_um``); see `PlaneEngine.point`."""
        result = self._parts[0].point(y_um, x_um)
        for part in self._parts[1:]:
            result += part.point(y_um, x_um)
        return result

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions; see `PlaneEngine.predicted_seconds`."""
        return sum(part.predicted_seconds(n_positions) for part in self._parts)
