"""Scans that another program recorded: a small camera, a stage mounted anyhow, frames and a list of its own form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from lfcal.camera import Camera, preset

ROWS, COLUMNS = 4, 7
SENSOR = (40, 48)
START = (18.0, 21.0)
"""Sensor row and column of the image at the first position."""


def small_camera() -> Camera:
    """Return the bench camera with large pixels: a cell of 7 by 4.04 of them."""
    camera = preset("bench")
    pixel = camera.sensor.pixel_um * camera.period_px[1] / COLUMNS
    return replace(camera, sensor=replace(camera.sensor, pixel_um=pixel, shape=SENSOR, bit_depth=16, black_level=0))


def step_um(camera: Camera, z: float) -> float:
    """Return the step of one pixel by similar triangles, from the camera's numbers alone."""
    lens = camera.optics
    image = 1 / (1 / lens.focal_length_um - 1 / lens.working_distance_um)
    return camera.sensor.pixel_um * (lens.working_distance_um + z) / (image + camera.lattice.gap_um)


@dataclass
class Scan:
    """Positions in the order of the list, stage coordinates (x, y, z) in um, and the camera."""

    camera: Camera
    depths: tuple[float, ...]
    positions: NDArray[np.int64]
    stage: NDArray[np.float64]


def scan(
    depths: Sequence[float] = (-40e3, 10e3),
    *,
    right: str = "+x",
    down: str = "+y",
    away: str = "+z",
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    turn_deg: float = 0.0,
    jitter: float = 0.0,
    shape: tuple[int, int] = (ROWS, COLUMNS),
    seed: int = 0,
) -> Scan:
    """Return a scan of the small camera; ``jitter`` is the stage's error in steps."""
    camera = small_camera()
    rng = np.random.default_rng(seed)
    positions = np.array(list(np.ndindex(len(depths), *shape)))
    steps = np.array([step_um(camera, z) for z in depths])[positions[:, 0]]
    offset = positions[:, 1:] + np.array(START) - (np.array(SENSOR) - 1) / 2
    offset = offset + rng.normal(0, 1, offset.shape) * jitter
    seen = {right: offset[:, 1] * steps, down: offset[:, 0] * steps, away: np.array(depths)[positions[:, 0]]}
    stage = np.zeros((len(positions), 3))
    for axis, values in seen.items():
        stage[:, "xyz".index(axis[1])] = values if axis[0] == "+" else -values
    turn = np.deg2rad(turn_deg)
    lateral = ["xyz".index(axis[1]) for axis in sorted((right, down), key=lambda a: a[1])]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    stage[:, lateral] = stage[:, lateral] @ rotation.T
    return Scan(camera, tuple(depths), positions, stage + np.array(origin))


def frame(place: Sequence[float], *, seed: int = 0, spread: float = 3.0) -> NDArray[np.uint16]:
    """Return a frame whose light is at ``START`` plus ``place`` (row, column), with a dark level and a hot pixel."""
    r, c = np.mgrid[: SENSOR[0], : SENSOR[1]]
    spot = np.exp(-((r - START[0] - place[0]) ** 2 + (c - START[1] - place[1]) ** 2) / (2 * spread))
    image = 100 + 3000 * spot + np.random.default_rng(seed).normal(0, 3, SENSOR)
    image[3, 3] = 4000
    return np.rint(image).astype(np.uint16)


def write_frames(folder: Path, found: Scan, names: Sequence[str]) -> None:
    """Write a TIFF for each frame of a scan."""
    for name, (z, y, x) in zip(names, found.positions, strict=True):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        tifffile.imwrite(folder / name, frame((y, x), seed=int(100 * z + 10 * y + x)))
