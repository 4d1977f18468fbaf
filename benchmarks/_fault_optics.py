"""Faults of lamps, focus and optics: functions of a recording and a strength that return all patterns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks._fault_recordings import PutIn, Recording

__all__ = [
    "blurred_type",
    "deep",
    "dim_type",
    "equalised",
    "flicker",
    "focus",
    "ghost",
    "jump",
    "lit",
    "odd",
    "shadow",
    "swapped_planes",
    "warming",
]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]


def lit(gain: Callable[[Recording, float], F8]) -> PutIn:
    return lambda r, s: r.noisy((r.light() * gain(r, s)).astype(np.float32))


def flicker(r: Recording, s: float) -> F8:
    found = 1 + s * np.random.default_rng(2).standard_normal(r.plan.shape[:3])
    return np.maximum(found, 0.0)[..., None, None]


def jump(r: Recording, s: float) -> F8:
    return np.where(r.come() > 0.5, 1 - s, 1.0)


def odd(count: int) -> Callable[[Recording, float], F8]:
    def gain(r: Recording, s: float) -> F8:
        found = np.ones(r.plan.shape[:3])
        found.ravel()[np.random.default_rng(9).choice(found.size, count, replace=False)] = s
        return found[..., None, None]

    return gain


def equalised(r: Recording, s: float) -> F8:
    tops = r.light().max((3, 4), keepdims=True).astype(np.float64)
    found: F8 = (tops / np.median(tops)) ** -s
    return found


def focus(r: Recording, s: float) -> F4:
    return r.noisy(r.deeper(0, s * (r.come()[..., 0, 0] - 0.5)))


def warming(r: Recording, s: float) -> F4:
    """Return the recording of a camera whose virtual depth changes by ``s`` during the scan of each plane."""
    light = r.light()
    for z, depth in enumerate(r.plan.depths_um):
        v = abs(r.plan.camera.virtual_depth(depth))
        light[z] = r.deeper(z, s / v * (r.come()[..., 0, 0] - 0.5))[z]
    return r.noisy(light)


def deep(*planes: int) -> PutIn:
    def put_in(r: Recording, s: float) -> F4:
        light = r.light()
        for z in planes:
            light[z] = r.deeper(z, np.full(r.plan.period, s))[z]
        return r.noisy(light)

    return put_in


def swapped_planes(r: Recording, s: float) -> F4:
    """Return the recording with the first fraction ``s`` of the rows exchanged between the planes."""
    values = r.clean()
    rows = round(s * values.shape[1])
    values[:, :rows] = values[::-1, :rows].copy()
    return values


def ghost(*axes: int) -> PutIn:
    def put_in(r: Recording, s: float) -> F4:
        light = r.light()
        other = np.roll(np.flip(light, axes) if axes else light, (7, -5), (3, 4))
        return r.noisy(light + np.float32(s) * other)

    return put_in


def type_image(r: Recording, kind: int, value: float) -> F4:
    camera = r.plan.camera
    _, ny, nx, nt, ns = r.plan.shape
    sides = ((0, nt, ny + nt - 1), (1, ns, nx + ns - 1))
    rows, columns = (r.plan.anchor[k] - (n - 1) / 2 + np.arange(m) for k, n, m in sides)
    points = camera.sensor_um(np.stack(np.meshgrid(rows, columns, indexing="ij"), -1))
    middle, span = points.mean((0, 1)), np.ptp(points, (0, 1))
    centres, kinds = camera.lattice.lenslets_within(span[0], span[1], (float(middle[0]), float(middle[1])))
    nearest = np.stack([np.argmin(np.square(row[:, None] - centres).sum(-1), axis=-1) for row in points])
    return np.where(kinds[nearest] == kind, value, 1.0).astype(np.float32)


def dim_type(r: Recording, s: float) -> F4:
    return r.noisy(r.scaled(r.light(), type_image(r, 1, 1.0 - s)))


def blurred_type(r: Recording, s: float) -> F4:
    camera = r.plan.camera
    types = list(camera.lattice.types)
    types[1] = replace(types[1], focal_length_um=types[1].focal_length_um * (1 + s))
    return r.noisy(r.with_camera(replace(camera, lattice=replace(camera.periodic, types=tuple(types)))))


def shadow(*, straight: bool) -> PutIn:
    """Return the fault of a partly dark pupil: beyond a chord, or increasingly towards one side."""

    def put_in(r: Recording, s: float) -> F4:
        light = r.light()
        nt, ns = r.plan.cutout
        y, x = np.mgrid[:nt, :ns] - np.array([(nt - 1) / 2, (ns - 1) / 2])[:, None, None]
        for z, image in enumerate(light.sum((1, 2), dtype=np.float64)):
            # radius of a uniform disc with this second moment
            radius = np.sqrt(2 * float((image * (y**2 + x**2)).sum() / image.sum()))
            along = (np.cos(0.6) * x + np.sin(0.6) * y) / max(radius, 1.0)
            part = 1 / (1 + np.exp((along - (1 - s)) / 0.05)) if straight else 1 - s * np.clip((along + 1) / 2, 0, 1)
            light[z] *= part.astype(np.float32)
        return r.noisy(light)

    return put_in
