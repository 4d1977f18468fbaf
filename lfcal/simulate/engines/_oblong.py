"""Non-square pixels: frames resampled by unequal factors are computed on fine square pixels and summed.

The engines support only square pixels. The light of each response is computed on a fine grid with `FINER` square
pixels across the width of an oblong one. Its running sum along an axis is smooth, and differences at the edges of the
oblong pixels give their light. Columns of the grids coincide; rows drift apart by less than a pixel, and the windows'
rows are chosen for each source.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import centre
from lfcal.simulate.engines.base import Certificate, Pilot, PlaneEngine, Sampling
from lfcal.simulate.scene import Scene

__all__ = ["FINER", "OblongPlane"]

FINER = 3
"""Fine pixels across the width of an oblong one; the spline through their running sum has an error of 1e-4.

An odd number: if the aspect is nearly 1, edges of oblong pixels are near edges of fine ones.
"""

SPARE = 6
"""Fine pixels around the window, for the ends of the spline."""


@lru_cache(maxsize=4096)
def _sums(fine: int, oblong: int, step: float, fill: float, shift: float, degree: int) -> NDArray[np.float64]:
    """Return ``(oblong, fine)``: the light of oblong pixels, with sensitive fraction ``fill``, from that of fine ones.

    ``step`` fine pixels are between oblong ones, whose middle one is ``shift`` fine pixels from the fine middle. The
    running sum is a spline of ``degree``: 5 for waves, 1 for the sharp edges of rays.
    """
    from scipy.interpolate import make_interp_spline  # slow to import

    edges = np.arange(fine + 1) - 0.5 - centre(fine)
    # the spline through the running sum of the light of a single fine pixel, for each of them
    running = make_interp_spline(edges, np.tri(fine + 1, fine, -1), k=degree)
    middle = shift + step * (np.arange(oblong) - centre(oblong))
    sums: NDArray[np.float64] = running(middle + fill * step / 2) - running(middle - fill * step / 2)
    return sums


def _fine_scene(scene: Scene) -> Scene:
    """Return the scene on fine square pixels; position (y, x) is `FINER` times (y, x) there, its rows' drift added."""
    aspect, (ny, nx) = scene.pixel_aspect, scene.period
    drift = FINER * (aspect - 1) * np.arange(ny)
    around = SPARE + math.ceil(abs(drift[-1]))
    cutout = (_odd(scene.cutout[0] * FINER * aspect, around), _odd(scene.cutout[1] * FINER, around))
    width = scene.pixel_um / FINER
    offsets = np.zeros((ny * FINER, nx * FINER, 2))
    offsets[::FINER, ::FINER, 0] = width * drift[:, None]
    if scene.offsets_um is not None:
        offsets[::FINER, ::FINER] += scene.offsets_um
    period = (ny * FINER, nx * FINER)
    return replace(
        scene, pixel_um=width, pixel_aspect=1.0, pixel_fill=1.0, cutout=cutout, period=period, offsets_um=offsets
    )


def _odd(width: float, around: int) -> int:
    return 2 * math.ceil(width / 2 + around) + 1


def _fine_sampling(sampling: Sampling) -> Sampling:
    """Return the sampling of fine pixels from the requested sampling of oblong ones."""
    samples = sampling.samples_per_px
    return replace(
        sampling,
        samples_per_px=None if samples is None else max(1, math.ceil(samples / FINER)),
        nodes_per_px=math.ceil(sampling.nodes_per_px / FINER),
        margin_px=sampling.margin_px * FINER,
    )


class OblongPlane:
    """Engine of any level for a scene whose pixels are not square; see the module.

    Parameters
    ----------
    scene
        The scene to compute; its ``pixel_aspect`` is not 1.
    sampling
        Sampling for each oblong pixel.
    make
        Function that makes the engine of the fine pixels from their scene and sampling.
    """

    def __init__(self, scene: Scene, sampling: Sampling, make: Callable[..., PlaneEngine]) -> None:
        self.scene = scene
        self._fine = make(_fine_scene(scene), sampling=_fine_sampling(sampling))
        self.level = self._fine.level
        self._degree = 1 if self.level == "geometric" else 5
        self._pilot = Pilot()

    @property
    def grid_side(self) -> int:
        """Samples on a side of the grid; see `PlaneEngine.grid_side`."""
        return self._fine.grid_side

    @property
    def certificate(self) -> Certificate:
        """Energy in and out of all responses so far."""
        return self._fine.certificate

    def rows(
        self, ys: ArrayLike, xs: ArrayLike, out: NDArray[np.float32] | None = None, workers: int | None = None
    ) -> NDArray[np.float32]:
        """Return the cutouts of positions ys x xs; see `PlaneEngine.rows`."""
        rows, columns = np.atleast_1d(np.asarray(ys, np.int64)), np.atleast_1d(np.asarray(xs, np.int64))
        result = np.empty((rows.size, columns.size, *self.scene.cutout), np.float32) if out is None else out
        # as many rows in one block as there are threads, because fine windows are larger
        block = max(1, workers or 2)
        for start in range(0, rows.size, block):
            part = rows[start : start + block]
            fine = self._fine.rows(part * FINER, columns * FINER, workers=workers)
            for r, y in enumerate(part):
                result[start + r] = self._binned(fine[r], float(y) * FINER * (self.scene.pixel_aspect - 1))
        return result

    def point(self, y_um: float, x_um: float) -> NDArray[np.float32]:
        """Return the cutout for a chief ray that meets the sensor at (``y_um``, ``x_um``); see `PlaneEngine.point`."""
        row, column = self.scene.nearest_pixel(y_um, x_um)
        fine_row, fine_column = self._fine.scene.nearest_pixel(y_um, x_um)
        shift = row * FINER * self.scene.pixel_aspect - fine_row
        return self._binned(self._fine.point(y_um, x_um), shift, column * FINER - fine_column)

    def predicted_seconds(self, n_positions: int) -> float:
        """Return the predicted CPU-seconds for ``n_positions`` positions; see `PlaneEngine.predicted_seconds`."""
        return self._pilot.seconds(self, n_positions)

    def _binned(self, fine: NDArray[np.float32], shift_y: float, shift_x: float = 0.0) -> NDArray[np.float32]:
        """Return fine windows ``(..., rows, columns)`` summed to oblong pixels moved by (shift_y, shift_x)."""
        scene, fill = self.scene, self.scene.pixel_fill
        nt, ns = fine.shape[-2:]
        down = _sums(nt, scene.cutout[0], FINER * scene.pixel_aspect, fill, round(shift_y, 9), self._degree)
        across = _sums(ns, scene.cutout[1], float(FINER), fill, float(shift_x), self._degree)
        binned: NDArray[np.float32] = (down @ fine @ across.T).astype(np.float32)
        return binned
