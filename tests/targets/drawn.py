"""Frames of targets drawn without the simulator: discs of spots at the places of the chief rays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.camera.shadow import half_extent_px
from lfcal.targets import Target
from lfcal.targets.images import hole_images

__all__ = ["drawn", "places"]


def places(target: Target, camera: Camera, z_um: float) -> dict[tuple[int, int], tuple[float, float]]:
    """Return where each hole is imaged."""
    images = hole_images(target, camera, z_um)
    return {(r, c): (y, x) for (r, c), (y, x) in zip(images.holes.tolist(), images.pixels.tolist(), strict=True)}


def drawn(
    target: Target,
    camera: Camera,
    z_um: float,
    *,
    light: Mapping[tuple[int, int], float] | None = None,
    without: tuple[tuple[int, int], ...] = (),
    ghosts: tuple[tuple[float, float], ...] = (),
    aside: Mapping[tuple[int, int], tuple[float, float]] | None = None,
    spread: float = 0.0,
    bend: float = 0.0,
    seed: int = 0,
) -> NDArray[np.float64]:
    """Return a frame of the target: every hole a disc of micro-images, with noise on a dark level of 64."""
    rng = np.random.default_rng(seed)
    rows, columns = camera.sensor.shape
    out = np.zeros((rows, columns))
    radius = 0.85 * half_extent_px(camera, z_um)
    centre = np.array([(rows - 1) / 2, (columns - 1) / 2])
    points = [(at, hole) for hole, at in places(replace(target, absent=target.absent), camera, z_um).items()]
    points = [p for p in points if p[1] not in without] + [(g, None) for g in ghosts]
    # finer than the lenslets: the middle of few of them is not that of the disc, and this test is not about that
    pitch = 0.5 * camera.pitch_px
    for at, hole in points:
        moved = np.array(at) + np.array((aside or {}).get(hole, (0.0, 0.0)))
        moved = centre + (moved - centre) * (1 + bend * np.square(moved - centre).sum() / np.square(centre).sum())
        bright = (light or {}).get(hole, 1.0) * max(0.0, rng.normal(1.0, spread))
        for i in range(-6, 7):
            for j in range(-6, 7):
                # the lenslets stay where they are, the disc moves over them
                lens = np.round(moved / pitch) * pitch + np.array([i, j + 0.5 * (i % 2)]) * pitch
                far = float(np.hypot(*(lens - moved)))
                weight = bright * min(1.0, max(0.0, (radius - far) / pitch + 0.5))
                if weight > 0:
                    _spot(out, lens, 1200.0 * weight)
    noise = rng.normal(0.0, 2.0, out.shape) + rng.normal(0.0, 1.0, out.shape) * np.sqrt(out * 0.2)
    return np.clip(np.rint(out + noise + 64.0), 0, 4095)


def _spot(out: NDArray[np.float64], at: NDArray[np.float64], peak: float) -> None:
    top, left = (int(np.floor(v)) - 4 for v in at)
    y, x = np.arange(max(0, top), min(out.shape[0], top + 10)), np.arange(max(0, left), min(out.shape[1], left + 10))
    if len(y) and len(x):
        square = np.square(y[:, None] - at[0]) + np.square(x[None, :] - at[1])
        out[y[0] : y[-1] + 1, x[0] : x[-1] + 1] += peak * np.exp(-square / (2 * 1.3**2))
