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


FAULTS: dict[str, Fault] = {}


def matrix(scene: Scene, values: Values, **about: Any) -> PSFMatrix:
    """Return H of the scene's camera and depths."""
    return PSFMatrix(values, **{"depths": scene.depths, "camera": scene.camera} | about)


def base(scene: Scene, seed: int = 0) -> Values:
    """Return a clean recording of the scene, to be changed at will."""
    return _base(scene, seed).copy()


@functools.lru_cache(maxsize=4)
def _base(scene: Scene, seed: int) -> Values:
    return recorded(scene.planes, seed, NOISE)


def fault(name: str, *names: str) -> Callable[[Callable[[Scene], PSFMatrix]], Callable[[Scene], PSFMatrix]]:
    """Enter a fault into `FAULTS`."""

    def enter(make: Callable[[Scene], PSFMatrix]) -> Callable[[Scene], PSFMatrix]:
        FAULTS[name] = Fault(make, names)
        return make

    return enter


def changed(name: str, *names: str) -> Callable[[Callable[[Values, Scene], Values | None]], None]:
    """Enter a fault that changes the values of a clean recording, in place or as a new array."""

    def enter(change: Callable[[Values, Scene], Values | None]) -> None:
        def make(scene: Scene) -> PSFMatrix:
            values = base(scene)
            out = change(values, scene)
            return matrix(scene, values if out is None else out)

        FAULTS[name] = Fault(make, names)

    return enter


def moved(scene: Scene, stage: NDArray[np.float64], planes: tuple[int, ...] | None = None) -> PSFMatrix:
    """Return a recording in which the source stood ``stage (ny, nx, 2)`` as (y, x) pixels from its place."""
    clean = scene.planes.copy()
    for z in range(len(clean)) if planes is None else planes:
        clean[z] = scene.plane(z, stage=stage) * scene.scale
    return matrix(scene, recorded(clean, 0, NOISE))


def grid(scene: Scene) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return row and column of every position ``(ny, nx)``."""
    ny, nx = scene.period
    y, x = np.meshgrid(np.arange(ny), np.arange(nx), indexing="ij")
    return y, x


# -- order ---------------------------------------------------------------------------------------------------
@changed("two columns swapped", "misplaced")
def _(h: Values, scene: Scene) -> None:
    h[:, :, [3, 4]] = h[:, :, [4, 3]]


@changed("two rows swapped", "misplaced")
def _(h: Values, scene: Scene) -> None:
    h[:, [5, 6]] = h[:, [6, 5]]


@changed("axes swapped", "scan_order")
def _(h: Values, scene: Scene) -> Values:
    ny, nx = scene.period  # the frames ran along y first and were counted along x
    return np.ascontiguousarray(h.transpose(0, 2, 1, 3, 4)).reshape(h.shape[0], ny, nx, *h.shape[3:])


@changed("direction reversed", "scan_order")
def _(h: Values, scene: Scene) -> Values:
    return np.ascontiguousarray(h[:, :, ::-1])


@changed("frames mirrored", "scan_order")
def _(h: Values, scene: Scene) -> Values:
    return np.ascontiguousarray(h[..., ::-1, :])


@changed("some frames mirrored", "misplaced")
def _(h: Values, scene: Scene) -> None:
    h[0, 4:6, 2:7] = h[0, 4:6, 2:7, :, ::-1].copy()


@changed("planes in the wrong order", "depth_order")
def _(h: Values, scene: Scene) -> Values:
    return np.ascontiguousarray(np.roll(h, 1, axis=0))


# -- stage ---------------------------------------------------------------------------------------------------
@fault("stage step 10 % too large", "stage_gain")
def _(scene: Scene) -> PSFMatrix:
    y, x = grid(scene)
    return moved(scene, 0.1 * np.stack([y, x], -1))


@fault("stage runs backwards", "scan_order")
def _(scene: Scene) -> PSFMatrix:
    y, x = grid(scene)
    return moved(scene, np.stack([0 * y, scene.period[1] // 2 * 1.0 - 2.0 * (x - scene.period[1] // 4)], -1))


@fault("stage jitter", "jitter")
def _(scene: Scene) -> PSFMatrix:
    return moved(scene, np.random.default_rng(5).normal(0, 0.35, (*scene.period, 2)))


@fault("backlash", "backlash")
def _(scene: Scene) -> PSFMatrix:
    y = grid(scene)[0]
    return moved(scene, np.stack([0 * y, np.where(y % 2, 0.45, -0.45)], -1))


@fault("thermal drift", "drift", "stage_gain")
def _(scene: Scene) -> PSFMatrix:
    y, x = grid(scene)
    scan = (y * scene.period[1] + x) / (scene.period[0] * scene.period[1])
    return moved(scene, np.stack([1.5 * scan, 4.0 * scan], -1))


@fault("stage missed a step", "misplaced", "duplicates")
def _(scene: Scene) -> PSFMatrix:
    stage = np.zeros((*scene.period, 2))
    stage[4, 7, 1] = -1
    return moved(scene, stage)


@fault("wrong period", "period")
def _(scene: Scene) -> PSFMatrix:
    return matrix(scene, base(scene)[:, :-2, :-2])


@fault("wrong period, camera unknown", "seam", "stage_gain")
def _(scene: Scene) -> PSFMatrix:
    return PSFMatrix(base(scene)[:, :-2, :-2])


# -- frames --------------------------------------------------------------------------------------------------
@changed("a missing frame", "missing")
def _(h: Values, scene: Scene) -> None:
    h[1, 4, 7] = 0


@changed("missing frames, 3 %", "missing")
def _(h: Values, scene: Scene) -> None:
    h[np.random.default_rng(2).random(h.shape[:3]) < 0.03] = 0


@changed("a duplicated frame", "duplicates")
def _(h: Values, scene: Scene) -> None:
    h[1, 4, 7] = h[1, 4, 6]


@changed("a duplicated file, cropped anew", "duplicates")
def _(h: Values, scene: Scene) -> None:
    h[1, 4, 7, :, :-1] = h[1, 4, 6, :, 1:]


@changed("not a number", "nonfinite")
def _(h: Values, scene: Scene) -> None:
    h[1, 2, 2, 3, 3] = np.nan


# -- planes --------------------------------------------------------------------------------------------------
@changed("a copied plane", "plane_copies")
def _(h: Values, scene: Scene) -> None:
    h[-1] = h[-2]


@fault("a plane recorded twice", "plane_copies")
def _(scene: Scene) -> PSFMatrix:
    values = base(scene)
    values[-1] = recorded(scene.planes[-2:-1], 9, NOISE)[0]
    return matrix(scene, values)


@changed("a dark plane", "planes_lit")
def _(h: Values, scene: Scene) -> None:
    h[1] = np.random.default_rng(4).normal(0, NOISE, h.shape[1:])


@changed("a plane brighter by 30 %", "plane_energy")
def _(h: Values, scene: Scene) -> None:
    h[1] *= 1.3


@fault("a plane at the wrong depth", "depth")
def _(scene: Scene) -> PSFMatrix:
    clean = scene.planes.copy()
    clean[1] = scene.plane(1, depth_gain=1.2) * scene.scale
    return matrix(scene, recorded(clean, 0, NOISE))


# -- light ---------------------------------------------------------------------------------------------------
@fault("flicker", "flicker")
def _(scene: Scene) -> PSFMatrix:
    return matrix(scene, recorded(scene.planes, 0, NOISE, flicker=0.08))


@changed("lamp decay", "lamp")
def _(h: Values, scene: Scene) -> None:
    y, x = grid(scene)
    h *= (1 - 0.2 * (y * scene.period[1] + x) / y.size)[None, :, :, None, None].astype(np.float32)


@fault("a noisy camera", "snr")
def _(scene: Scene) -> PSFMatrix:
    return matrix(scene, recorded(scene.planes, 0, 140.0))


@changed("saturation", "saturation")
def _(h: Values, scene: Scene) -> Values:
    return np.minimum(h * 1.8, np.float32(4031))


@fault("saturation, counted by the camera", "saturation")
def _(scene: Scene) -> PSFMatrix:
    counted = np.zeros((len(scene.virtual_depths), *scene.period), int)
    counted[1, 2:4, 3] = 9
    return matrix(scene, base(scene), saturated=counted)


@changed("background offset", "background")
def _(h: Values, scene: Scene) -> None:
    h += 0.002 * PEAK


@changed("dark frame subtracted twice", "background")
def _(h: Values, scene: Scene) -> None:
    h -= 5


@changed("clipped at zero", "clipped", "background")
def _(h: Values, scene: Scene) -> Values:
    return np.maximum(h, 0)


@changed("light leak", "leak")
def _(h: Values, scene: Scene) -> None:
    n = h.shape[-1]
    t, s = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
    h += (110 * np.exp(-((t - n / 2) ** 2 / (n / 5) ** 2 + s**2 / (n / 14) ** 2))).astype(np.float32)


# -- sensor and cutout -----------------------------------------------------------------------------------------
@changed("a hot pixel", "hot_pixels")
def _(h: Values, scene: Scene) -> None:
    row, column = h.shape[3] // 2 + 12, h.shape[4] // 2 + 9  # fixed on the sensor, so it walks through the cutouts
    for y in range(h.shape[1]):
        for x in range(h.shape[2]):
            h[:, y, x, row - y, column - x] += 0.3 * PEAK


@changed("a pixel stuck in the cutout", "hot_pixels")
def _(h: Values, scene: Scene) -> None:
    h[..., 9, 30] += 0.3 * PEAK


@changed("cutout too small", "truncation")
def _(h: Values, scene: Scene) -> Values:
    cut = (h.shape[3] - 2 * int(0.36 * sizes(scene))) // 2
    return np.ascontiguousarray(h[..., cut:-cut, cut:-cut])


@changed("cutout off centre", "centring", "truncation")
def _(h: Values, scene: Scene) -> Values:
    return np.roll(h, (9, -8), axis=(3, 4))


def sizes(scene: Scene) -> float:
    """Return the diameter of the largest pattern (px)."""
    return max(2 * float(scene.shadow(v).max()) * abs(1 - 1 / v) for v in scene.virtual_depths)


CLEAN: dict[str, Callable[[Scene], PSFMatrix]] = {
    "recorded": lambda scene: matrix(scene, base(scene)),
    "recorded, camera unknown": lambda scene: PSFMatrix(base(scene, 3)),
    "ideal": lambda scene: matrix(scene, scene.planes),
}
"""Scenes without a fault."""
