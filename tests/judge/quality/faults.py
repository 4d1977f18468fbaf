"""Faults by name: what goes wrong in a recording, put into a clean scene, and the metric that must name it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.psf import PSFMatrix

from .scenes import PEAK, Scene, recorded

NOISE = 3.0
Values = NDArray[np.float32]


@dataclass(frozen=True)
class Fault:
    """A fault.

    ``names`` are the metrics of which one must be bad and rank first, or second to a bad one that is also named.
    """

    make: Callable[[Scene], PSFMatrix]
    names: tuple[str, ...]


def matrix(scene: Scene, values: Values, **about: Any) -> PSFMatrix:
    """Return H of the scene's camera and depths."""
    return PSFMatrix(values, **{"depths": scene.depths, "camera": scene.camera} | about)


def base(scene: Scene, seed: int = 0) -> Values:
    """Return a clean recording of the scene, to be changed at will."""
    return _base(scene, seed).copy()


@functools.lru_cache(maxsize=4)
def _base(scene: Scene, seed: int) -> Values:
    return recorded(scene.planes, seed, NOISE)


def put(h: Values, where: Any, values: Any) -> Values:
    """Put values into a recording."""
    h[where] = values
    return h


def moved(scene: Scene, away: NDArray[np.float64]) -> PSFMatrix:
    """Return a recording in which the source was ``away (ny, nx, 2)`` as (y, x) pixels from its place."""
    clean = np.stack([scene.plane(z, stage=away) * scene.scale for z in range(len(scene.virtual_depths))])
    return matrix(scene, recorded(clean.astype(np.float32), 0, NOISE))


def grid(scene: Scene) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and column of every position ``(ny, nx)``."""
    ny, nx = scene.period
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    return y, x


def sizes(scene: Scene) -> float:
    """Return the diameter of the largest pattern (px)."""
    return max(2 * float(scene.shadow(v).max()) * abs(1 - 1 / v) for v in scene.virtual_depths)


def come(scene: Scene) -> NDArray[np.float64]:
    """Return how far the scan has come at each position, 0 to 1."""
    y, x = grid(scene)
    return (y * scene.period[1] + x) / y.size


def missed_step(scene: Scene) -> NDArray[np.float64]:
    stage = np.zeros((*scene.period, 2))
    stage[4, 7, 1] = -1
    return stage


def leak(h: Values) -> Values:
    n = h.shape[-1]
    t, s = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    return h + 110 * np.exp(-((t - n / 2) ** 2 / (n / 5) ** 2 + s**2 / (n / 14) ** 2))


def hot(h: Values) -> Values:
    row, column = h.shape[3] // 2 + 12, h.shape[4] // 2 + 9  # fixed on the sensor, so it walks through the cutouts
    for y, x in np.ndindex(h.shape[1:3]):
        h[:, y, x, row - y, column - x] += 0.3 * PEAK
    return h


def cut(h: Values, scene: Scene) -> Values:
    by = (h.shape[3] - 2 * int(0.36 * sizes(scene))) // 2
    return h[..., by:-by, by:-by]


def replaced(scene: Scene, z: int, plane: Values) -> PSFMatrix:
    """Return a recording in which the light of one plane is another."""
    clean = scene.planes.copy()
    clean[z] = plane
    return matrix(scene, recorded(clean, 0, NOISE))


def recorded_twice(scene: Scene) -> PSFMatrix:
    return matrix(scene, put(base(scene), -1, recorded(scene.planes[-2:-1], 9, NOISE)[0]))


def counted(scene: Scene) -> PSFMatrix:
    counts = np.zeros((len(scene.virtual_depths), *scene.period), int)
    counts[1, 2:4, 3] = 9
    return matrix(scene, base(scene), saturated=counts)


Change = Callable[[Values, Scene], Any]
CHANGES: dict[str, tuple[str, Change]] = {
    # order
    "two columns swapped": ("misplaced", lambda h, s: put(h, np.s_[:, :, [3, 4]], h[:, :, [4, 3]])),
    "two rows swapped": ("misplaced", lambda h, s: put(h, np.s_[:, [5, 6]], h[:, [6, 5]])),
    # the frames ran along y first and were counted along x
    "axes swapped": ("scan_order", lambda h, s: np.ascontiguousarray(h.transpose(0, 2, 1, 3, 4)).reshape(h.shape)),
    "direction reversed": ("scan_order", lambda h, s: h[:, :, ::-1]),
    "frames mirrored": ("scan_order", lambda h, s: h[..., ::-1, :]),
    "some frames mirrored": (
        "misplaced",
        lambda h, s: put(h, np.s_[0, 4:6, 2:7], h[0, 4:6, 2:7, :, ::-1].copy()),
    ),
    "planes in the wrong order": ("depth_order", lambda h, s: np.roll(h, 1, axis=0)),
    # frames
    "a missing frame": ("missing", lambda h, s: put(h, (1, 4, 7), 0)),
    "missing frames, 3 %": ("missing", lambda h, s: put(h, np.random.default_rng(2).random(h.shape[:3]) < 0.03, 0)),
    "a duplicated frame": ("duplicates", lambda h, s: put(h, (1, 4, 7), h[1, 4, 6])),
    "a duplicated file, cropped again": (
        "duplicates",
        lambda h, s: put(h, np.s_[1, 4, 7, :, :-1], h[1, 4, 6, :, 1:]),
    ),
    "not a number": ("nonfinite", lambda h, s: put(h, (1, 2, 2, 3, 3), np.nan)),
    # planes
    "a copied plane": ("plane_copies", lambda h, s: put(h, -1, h[-2])),
    "a dark plane": ("planes_lit", lambda h, s: put(h, 1, np.random.default_rng(4).normal(0, NOISE, h.shape[1:]))),
    "a plane brighter by 30 %": ("plane_energy", lambda h, s: put(h, 1, 1.3 * h[1])),
    # light
    "lamp decay": ("lamp", lambda h, s: h * (1 - 0.2 * come(s))[None, :, :, None, None]),
    "saturation": ("saturation", lambda h, s: np.minimum(h * 1.8, np.float32(4031))),
    "background offset": ("background", lambda h, s: h + 0.002 * PEAK),
    "dark frame subtracted twice": ("background", lambda h, s: h - 5),
    "clipped at zero": ("clipped background", lambda h, s: np.maximum(h, 0)),
    "light leak": ("leak", lambda h, s: leak(h)),
    # sensor and cutout
    "a hot pixel": ("hot_pixels", lambda h, s: hot(h)),
    "a pixel stuck in the cutout": ("hot_pixels", lambda h, s: put(h, np.s_[..., 9, 30], h[..., 9, 30] + 0.3 * PEAK)),
    "cutout too small": ("truncation", cut),
    "cutout off centre": ("centring truncation", lambda h, s: np.roll(h, (9, -8), axis=(3, 4))),
}
"""Metrics that name a change, and what it makes of the values of a clean recording."""


def stage(*axes: Any) -> NDArray[np.float64]:
    return np.stack(np.broadcast_arrays(*axes), -1)


MADE: dict[str, tuple[str, Callable[[Scene], PSFMatrix]]] = {
    # stage: the source is displaced by (y, x) pixels
    "stage step 10 % too large": ("stage_gain", lambda s: moved(s, 0.1 * stage(*grid(s)))),
    "stage runs backwards": (
        "scan_order",
        lambda s: moved(s, stage(0.0, s.period[1] // 2 * 1.0 - 2.0 * (grid(s)[1] - s.period[1] // 4))),
    ),
    "stage jitter": ("jitter", lambda s: moved(s, np.random.default_rng(5).normal(0, 0.35, (*s.period, 2)))),
    "backlash": ("backlash", lambda s: moved(s, stage(0.0, np.where(grid(s)[0] % 2, 0.45, -0.45)))),
    "thermal drift": ("drift stage_gain", lambda s: moved(s, stage(1.5 * come(s), 4.0 * come(s)))),
    "stage missed a step": ("misplaced duplicates", lambda s: moved(s, missed_step(s))),
    "wrong period": ("period", lambda s: matrix(s, base(s)[:, :-2, :-2])),
    "wrong period, camera unknown": ("seam stage_gain", lambda s: PSFMatrix(base(s)[:, :-2, :-2])),
    # planes and light
    "a plane recorded twice": ("plane_copies", recorded_twice),
    "a plane at the wrong depth": ("depth", lambda s: replaced(s, 1, s.plane(1, depth_gain=1.2) * s.scale)),
    "flicker": ("flicker", lambda s: matrix(s, recorded(s.planes, 0, NOISE, flicker=0.08))),
    "a noisy camera": ("snr", lambda s: matrix(s, recorded(s.planes, 0, 140.0))),
    "saturation, counted by the camera": ("saturation", counted),
}


def of_change(change: Change) -> Callable[[Scene], PSFMatrix]:
    return lambda scene: matrix(scene, np.ascontiguousarray(change(base(scene), scene), np.float32))


FAULTS: dict[str, Fault] = {
    **{name: Fault(of_change(change), tuple(names.split())) for name, (names, change) in CHANGES.items()},
    **{name: Fault(make, tuple(names.split())) for name, (names, make) in MADE.items()},
}


CLEAN: dict[str, Callable[[Scene], PSFMatrix]] = {
    "recorded": lambda scene: matrix(scene, base(scene)),
    "recorded, camera unknown": lambda scene: PSFMatrix(base(scene, 3)),
    "ideal": lambda scene: matrix(scene, scene.planes),
}
"""Scenes without a fault."""
