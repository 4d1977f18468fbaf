"""Reconstruction without super-pixels: iterative for any transmissions, and by the camera's lattice. No Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, LfcalError, map_npy, storage_errors
from lfcal.camera import Camera
from lfcal.frames import read_image
from lfcal.frames.corrections import read_average
from lfcal.lattice import FrameLattice, LatticeFit, ViewGrid, cropped, fit_lattice, lattice_of
from lfcal.multiplex import (
    Modulator,
    colour_edges,
    filament_light_field,
    lattice_transmissions,
    sample_places,
    view_edges,
    zone_plate,
)
from lfcal_gui.models import ProjectState
from lfcal_gui.pages.multiplex.model import MultiplexSettings

SCENE_SIDE = 240
SCENE_CELLS = 12
FEWEST_CELLS = 6
MOST_SHARES = 10_000_000
"""Transmissions of a built-in scene on the lattice."""

MOST_SOLVED = 64_000_000
"""Transmissions that the general route takes here: half a gigabyte."""

OF_FRAMES = "frames:"
"""Before the path of a white image that is that of Record > Folder: it counts for frames of its size only."""

Array = NDArray[Any]


@dataclass(frozen=True)
class FramePart:
    """Where a frame lies in the whole one: its first pixel (row, column), and the whole's shape."""

    corner: tuple[int, int]
    whole: tuple[int, int]

    def cut(self, image: Array, shape: tuple[int, ...]) -> Array:
        """Return the same part of a whole image or of a stack of them."""
        (top, left), (rows, columns) = self.corner, shape
        return image[..., top : top + rows, left : left + columns]


def dead_pixels(path: str, part: FramePart, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return where the map at ``path`` marks dead pixels of a frame that is a part of the whole."""
    marked = read_image(path)
    if marked.shape != part.whole:
        raise InputError.expected("dead pixels", f"{part.whole} px", marked.shape, "use the frame's own camera's")
    return np.asarray(part.cut(marked, shape) != 0)


def shares_of(
    settings: MultiplexSettings, modulator: Modulator, part: FramePart | None, shape: Any
) -> Array | Modulator:
    """Return the weight of each sample in each pixel, from the file of transmissions or from the modulator."""
    if not settings.transmissions:
        _check_count(modulator.count, shape)
        return modulator
    found = _transmissions(settings.transmissions)
    if part is None:
        part = FramePart(_middle(found.shape[1:], shape), (found.shape[1], found.shape[2]))
    if found.shape[1:] != part.whole:
        raise InputError.expected("transmissions", f"(N, {part.whole})", found.shape, "one per pixel of the frame")
    _check_count(len(found), shape)
    shares = np.asarray(part.cut(found, shape), float)
    if not np.isfinite(shares).all():
        raise InputError.expected("transmissions", "finite numbers", "NaN or infinity", "write 0 for dead pixels")
    return shares


def _check_count(samples: int, shape: tuple[int, ...]) -> None:
    if samples * math.prod(shape) > MOST_SOLVED:
        most = MOST_SOLVED // math.prod(shape)
        raise InputError.expected(
            "samples of the general route", f"up to {most} for this frame", samples, "copy the command and run it"
        )


def _transmissions(path: str) -> Array:
    found = map_npy(path)
    if found.ndim != 3 or not found.size:
        raise InputError.expected("transmissions", "(N, rows, columns)", found.shape, "one plane per sample")
    return found


def _middle(whole: tuple[int, ...], shape: tuple[int, ...]) -> tuple[int, int]:
    return (whole[0] - shape[0]) // 2, (whole[1] - shape[1]) // 2


def scene_behind(settings: MultiplexSettings, modulator: Modulator) -> tuple[Array, Array]:
    """Return a built-in scene ``(N, rows, columns)`` and its frame behind the middle of the file's transmissions."""
    whole = _transmissions(settings.transmissions).shape
    shape = (min(whole[1], SCENE_SIDE), min(whole[2], SCENE_SIDE))
    shares = np.asarray(shares_of(settings, modulator, None, shape))
    drawn = colour_edges(shape) if settings.scene == "edges" else zone_plate(shape, 0.2)
    scene = np.stack([np.roll(drawn[k % 3], 7 * (k // 3), axis=1) for k in range(whole[0])])
    return scene, np.asarray((shares * scene).sum(0))


def at_nodes(scene: Array, nodes: tuple[int, ...]) -> Array:
    """Return a scene at the nodes of the general route, which lie in the middle of their pixels."""
    places = [(np.arange(n) + 0.5) * size / n - 0.5 for n, size in zip(nodes, scene.shape[1:], strict=True)]
    return _sampled(scene, np.stack(np.meshgrid(*places, indexing="ij"), -1).reshape(-1, 2), nodes)


def at_samples(scene: Array, grid: ViewGrid) -> Array:
    """Return a scene at the samples of views."""
    return _sampled(scene, sample_places(grid), grid.shape)


def _sampled(scene: Array, places: Array, shape: tuple[int, ...]) -> Array:
    from scipy.ndimage import map_coordinates

    planes = [map_coordinates(plane, places.T, order=1, mode="nearest") for plane in scene]
    return np.array(planes).reshape(-1, *shape)


def white_of(project: ProjectState) -> str:
    """Return the white image (or a folder of them) for the lattice: that of the page, else that of Folder."""
    own = MultiplexSettings.of(project).white
    frames = project.settings.get("frames")
    if own or not isinstance(frames, Mapping):
        return own
    white = frames.get("white", "")
    return OF_FRAMES + white if isinstance(white, str) and white else ""


def measured_in(project: ProjectState) -> str:
    """Return the white image that defines the lattice of an opened frame; empty: the camera defines it."""
    white, image = white_of(project), MultiplexSettings.of(project).image
    if not white.startswith(OF_FRAMES):
        return white
    path = white.removeprefix(OF_FRAMES)
    try:
        same = _measured(path, _stamp(path)).shape == read_image(image).shape
    except LfcalError:
        return ""
    return path if same else ""


def frame_lattice(
    white: str, camera: Camera, part: FramePart | None, shape: tuple[int, int]
) -> tuple[FrameLattice, str]:
    """Return the lattice under a frame, and in words where it comes from.

    It is measured in a white image where there is one (`white_of`), and else the camera's; a built-in scene lies in the
    middle of the sensor.

    Raises
    ------
    InputError
        If the frame is not the camera's, or the white image of another size or without a lattice.
    """
    path = white.removeprefix(OF_FRAMES)
    if part is not None and path:
        fit = _measured(path, _stamp(path))
        if fit.shape == part.whole:
            return cropped(fit, shape, part.corner), f"lattice measured in {Path(path).name}"
        if path == white:
            raise InputError.expected(
                "white image", f"the {part.whole} px of the frame", fit.shape, "choose one of the same camera"
            )
    sensor = camera.sensor.shape
    if part is not None and part.whole != sensor:
        raise InputError.expected(
            "frame", f"the {sensor} px of the project's camera", part.whole, "open a whole frame of this camera"
        )
    corner = _middle(sensor, shape) if part is None else part.corner
    return lattice_of(camera, shape, corner), f"lattice of {camera.name}, {camera.marks['lattice.pitch_um']}"


def _stamp(path: str) -> int:
    with storage_errors(Path(path)):
        return Path(path).stat().st_mtime_ns


@lru_cache(maxsize=2)
def _measured(path: str, _: int) -> LatticeFit:
    """Return the lattice of a white image or of the mean of a folder of them, measured once while it is unchanged."""
    return fit_lattice(read_average(path))


def lattice_scene(settings: MultiplexSettings, modulator: Modulator, camera: Camera) -> tuple[Array, Array]:
    """Return a built-in light field at every pixel, and its frame behind the modulator on the camera's lattice."""
    if modulator.side != modulator.cell or modulator.views[0] != modulator.views[1]:
        raise InputError.expected(
            "modulator on a lattice", "one super-pixel of a light field", modulator.name, "choose a mask or lenslets"
        )
    shape = _scene_shape(modulator, camera)
    lattice = frame_lattice("", camera, None, shape)[0]
    shares = lattice_transmissions(shape, lattice, modulator)
    cells = (math.ceil(shape[0] / modulator.views[0]), math.ceil(shape[1] / modulator.views[0]))
    if settings.scene == "edges":
        light = view_edges(modulator.views[0], cells)
    else:
        light = filament_light_field(modulator.views[0], cells, np.random.default_rng(7))
    light = light[:, : shape[0], : shape[1]]
    return light, np.asarray((shares * (_gathered(light, lattice) if modulator.lenslets else light)).sum(0))


def _gathered(light: Array, lattice: FrameLattice) -> Array:
    """Return what a lenslet gives each pixel behind it: the mean over its area, here that of a box."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(light, (0, round(lattice.row_pitch_px), round(lattice.pitch_px)), mode="nearest"))


def _scene_shape(modulator: Modulator, camera: Camera) -> tuple[int, int]:
    """Return rows and columns of a dozen super-pixels, fewer where there are many views."""
    lattice, sensor = lattice_of(camera), camera.sensor.shape
    pitch = max(lattice.pitch_px, lattice.row_pitch_px)
    most = min(SCENE_CELLS * pitch, math.sqrt(MOST_SHARES / modulator.count))
    if most < FEWEST_CELLS * pitch:
        raise InputError.expected(
            "mask for a built-in scene on this lattice",
            f"up to {int(MOST_SHARES / (FEWEST_CELLS * pitch) ** 2)} views",
            modulator.count,
            "choose a smaller one, or open a recorded frame",
        )
    return min(sensor[0], round(most)), min(sensor[1], round(most))
