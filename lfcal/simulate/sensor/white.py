"""The micro-image pattern of white frames, which show a uniformly lit scene."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, PupilLenslets, ScanPlan, cutout_for, nearest_lens
from lfcal.simulate.effects import Bandwidth, Distortion, Effect, FiniteSource, MissingLenslets
from lfcal.simulate.response import PlaneResponse

__all__ = ["elemental_white", "fold", "white_light", "white_tile"]

BLURRED_DEPTH = 1.2
"""Virtual depth of the plane, on either side of the lenslets, that represents a uniform scene. Here a point illuminates
few lenslets; at 1, its images would be a whole pixel apart."""


def fold(pattern: NDArray[np.float32], period: tuple[int, int], shift: tuple[int, int]) -> NDArray[np.float64]:
    """Return one ``period`` (rows, columns) in which pixels of ``pattern`` that are whole periods apart are added.

    Pixel (0, 0) of ``pattern`` is added at ``shift`` (row, column), modulo the period.
    """
    ny, nx = period
    rows, columns = -(-pattern.shape[0] // ny), -(-pattern.shape[1] // nx)
    padded = np.zeros((rows * ny, columns * nx))
    padded[: pattern.shape[0], : pattern.shape[1]] = pattern
    tile = padded.reshape(rows, ny, columns, nx).sum(axis=(0, 2))
    return np.roll(tile, shift, axis=(0, 1))


def white_tile(plan: ScanPlan, effects: Sequence[Effect]) -> NDArray[np.float64]:
    """Return one period ``(ny, nx)`` of the image of a uniform plane, traced with rays; about 1 if no light is blocked.

    Pixel (0, 0) belongs to source position (0, 0). The radiance of a uniform scene is the same in every plane. The
    scene is represented by sources one pixel apart in a plane where no lens type is in focus (`_blurred`). Rays are
    sufficient, because diffraction hardly changes a smooth image. Distortion does not change a uniform scene. The
    bandwidth, the size of the source, and effects that depend on the wavelength are ignored. `white_light` applies
    missing lenslets.
    """
    ny, nx = plan.period  # in resampled pixels if the plan resamples: then it is the array's period, a whole number
    neglected = Bandwidth | Distortion | FiniteSource | MissingLenslets
    simple = [e for e in effects if not (isinstance(e, neglected) or e.by_wavelength)]
    blurred = _blurred(plan)
    side = cutout_for(plan.camera, blurred.depths_um)
    response = PlaneResponse(blurred, 0, simple, level="geometric", cutout=(side, side))
    ct, cs = ((n - 1) // 2 for n in response.cutout)
    tile = np.zeros((ny, nx))
    for y in range(ny):
        for x, pattern in enumerate(response.rows([y], range(nx))[0]):
            tile += fold(pattern, (ny, nx), (y - ct, x - cs))
    return tile


def _blurred(plan: ScanPlan) -> ScanPlan:
    """Return ``plan`` with one plane, near the lenslets, in which every lens type blurs a point over many pixels.

    A point in focus lights one pixel, and points a pixel apart leave bars between them.
    """
    camera = plan.camera
    foci = [lens.focus_depth(camera.lattice.gap_um) for lens in camera.lattice.types]
    v = max((BLURRED_DEPTH, -BLURRED_DEPTH), key=lambda v: min(abs(1 / v - 1 / focus) for focus in foci))
    depth = camera.depth_of(v)
    return replace(plan, depths_um=(depth,), exposure_s=plan.exposures[0])


def elemental_white(camera: Camera) -> NDArray[np.float32]:
    """Return the light ``(rows, columns)`` of a uniform scene: 1 in a disc behind each lenslet, and 0 elsewhere.

    The field stop is assumed to be the largest for which elemental images do not overlap, as in published designs.
    """
    lenslets = camera.lattice
    assert isinstance(lenslets, PupilLenslets)
    rows, columns = np.indices(camera.sensor.shape, np.float32)
    out = np.zeros(camera.sensor.shape, np.float32)
    radius = min(lenslets.spacing_um / 2 / camera.sensor.pixel_um, float(min(camera.sensor.shape)) / 2)
    for row, column in camera.pixels(np.array(lenslets.lens_centres_um) + np.array(lenslets.offset_um)).tolist():
        edge = np.clip(radius + 0.5 - np.hypot(rows - row, columns - column), 0.0, 1.0)
        np.maximum(out, edge, out=out)
    return out


def white_light(plan: ScanPlan, tile: NDArray[np.float64], effects: Sequence[Effect] = ()) -> NDArray[np.float32]:
    """Return the light on the whole sensor ``(rows, columns)``: ``tile``, repeated with the exact lattice period.

    ``tile`` is as returned by `white_tile`. The light is interpolated linearly between the tile's pixels and follows
    the rotation of the array. Defective lenslets among the ``effects`` are darker.
    """
    camera = plan.camera
    period = np.array(camera.period_px) * np.array(plan.cells)
    c, s = np.cos(camera.lattice.tilt_rad), np.sin(camera.lattice.tilt_rad)
    x = np.arange(camera.sensor.shape[1]) - plan.anchor[1]
    out = np.empty(camera.sensor.shape, np.float32)
    for row in range(len(out)):
        y = row - plan.anchor[0]
        out[row] = _sample(tile, (c * y - s * x) / period[0], (c * x + s * y) / period[1])
    for effect in effects:
        if isinstance(effect, MissingLenslets):
            _darken(out, plan, effect)
    return out


def _darken(out: NDArray[np.float32], plan: ScanPlan, effect: MissingLenslets) -> None:
    """Take from the pixels nearest to defective lenslets' micro-images the light that those lenslets do not pass."""
    camera, px = plan.camera, plan.camera.sensor.pixel_um
    first = np.rint(camera.lattice.lenslet_at(camera.sensor_um(nearest_lens(camera, plan.anchor)))).astype(int)
    half = math.ceil(camera.pitch_px)
    for r, q, passed in effect.lenslets:
        row, column = camera.pixels(camera.periodic.centres_um(first[0] + q, first[1] + r))
        top, left = max(0, round(row) - half), max(0, round(column) - half)
        part = out[top : max(0, round(row) + half + 1), left : max(0, round(column) + half + 1)]
        if not part.size:
            continue
        y, x = np.indices(part.shape, float)
        y, x = (y + top - row) * px, (x + left - column) * px
        # nearer to this centre than to its neighbours
        a, b = camera.lattice.basis_um()
        nearest = np.ones(part.shape, bool)
        for way in (a, b, b - a, a + b):
            nearest &= np.abs(x * way[0] + y * way[1]) <= 0.5 * float(way @ way)
        part[nearest] *= np.float32(passed)


def _sample(tile: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the periodic ``tile`` at rows u and columns v, in periods."""
    ny, nx = tile.shape
    row, column = (u % 1.0) * ny, (v % 1.0) * nx
    i, j = row.astype(np.intp), column.astype(np.intp)
    fy, fx = row - i, column - j
    i, j = i % ny, j % nx
    below, right = (i + 1) % ny, (j + 1) % nx
    upper = tile[i, j] * (1 - fx) + tile[i, right] * fx
    lower = tile[below, j] * (1 - fx) + tile[below, right] * fx
    result: NDArray[np.float64] = upper * (1 - fy) + lower * fy
    return result
