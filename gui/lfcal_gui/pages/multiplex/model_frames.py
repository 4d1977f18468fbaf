"""What the Multiplexing page records: built-in scenes, opened images, live frames, and which part is taken. No Qt."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, LfcalError
from lfcal.camera import Camera, Sensor
from lfcal.multiplex import (
    Modulator,
    black_level_map,
    colour_edges,
    filament_light_field,
    multiplex,
    view_edges,
    zone_plate,
)
from lfcal_gui.pages.multiplex import model_routes as routes
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.pages.multiplex.model_routes import FramePart

CFA_SIDE = 240
SCENE_VALUES = 4_000_000
FEWEST_CELLS = 6
LARGEST = 1536
"""Side of the middle part taken of an opened image or a live frame (px)."""

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Seen:
    """A recorded frame.

    Attributes
    ----------
    frame
        ``(rows, columns)``, less the level of no light.
    words
        What it is.
    truth
        The scene at every pixel, None where it is not known.
    part
        Of what it is a part; None for built-in scenes.
    level
        Level of no light that was taken off: a number, or one per pixel.
    """

    frame: Array = field(repr=False)
    words: str
    truth: Array | None = field(default=None, repr=False)
    part: FramePart | None = None
    level: Any = 0.0


def recorded(
    settings: MultiplexSettings,
    modulator: Modulator,
    sensor: Sensor,
    live: tuple[Array, tuple[int, int]] | None,
    camera: Camera | None,
) -> Seen:
    """Return what the sensor recorded behind the modulator; parameters as in `model_scene`."""
    if settings.scene == "live":
        if live is None:
            raise InputError("scene: no live frame yet; switch the live view of Record > Rig on")
        return _from_live(live[0], live[1], modulator.side, sensor)
    if settings.scene == "image":
        return _from_file(settings, modulator, sensor.black_level if settings.weighted else 0.0)
    frame: Array | None = None
    if settings.route == "lattice" and camera is not None:
        truth, frame = routes.lattice_scene(settings, modulator, camera)
    elif settings.route == "general" and settings.transmissions:
        truth, frame = routes.scene_behind(settings, modulator)
    else:
        truth = scene_of(settings.scene, modulator)
        frame = multiplex(truth, modulator)
    words = "built-in scene"
    if settings.noise:
        frame, words = noisy(frame, sensor, settings.gain, np.random.default_rng(1)), f"{words} with camera noise"
    return Seen(frame, f"{words}, {_sized(frame.shape)}", truth)


def _sized(shape: tuple[int, ...]) -> str:
    return f"{shape[1]} × {shape[0]} px"


def scene_of(kind: str, modulator: Modulator) -> NDArray[np.float64]:
    """Return a built-in scene ``(N, rows, columns)`` of whole super-pixels: ``"edges"`` or ``"smooth"``."""
    if modulator.views == (1, 1):
        rows, columns = (math.ceil(CFA_SIDE / n) * n for n in modulator.side)
        shown = colour_edges((rows, columns)) if kind == "edges" else zone_plate((rows, columns), 0.2)
        return shown if modulator.colours == ("R", "G", "B") else _told_apart(shown, modulator)
    views, step = modulator.views[0], modulator.side[0] // modulator.cell[0]
    if modulator.cell == (1, 1):
        step = max(1, modulator.side[0] // views)
    cells = min(48, math.isqrt(SCENE_VALUES // (modulator.count * views * views))) // step * step
    if cells < FEWEST_CELLS:
        raise InputError.expected(
            "size for a built-in scene (px)",
            "up to 17, fewer with colours",
            views,
            "choose a smaller one, or open a recorded frame",
        )
    if kind == "edges":
        light = view_edges(views, (cells, cells))
    else:
        light = filament_light_field(views, (cells, cells), np.random.default_rng(7))
    if not modulator.colours:
        return light
    tint = _told_apart(colour_edges(light.shape[1:]), modulator)
    return np.asarray((light[:, None] * tint[: len(modulator.colours)]).reshape(-1, *light.shape[1:]))


def _told_apart(shown: NDArray[np.float64], modulator: Modulator) -> NDArray[np.float64]:
    """Return one plane per sample of a direction, all with different shapes, made from planes of three colours.

    Stokes parameters are a share of S0, so that the light exists.
    """
    names = modulator.colours or ("light",)
    planes = np.stack([np.roll(shown[k % 3], 7 * (k // 3), axis=1) for k in range(len(names))])
    if any(name.startswith("S0") for name in names):
        stokes = [not name.startswith("S0") for name in names]
        planes[stokes] = 0.5 * planes[stokes] * shown.mean(0) - 0.1
    return planes


def opened(path: str) -> tuple[Array | None, Array | None, str]:
    """Return an image file as a scene ``(3, rows, columns)`` in 0 … 1 or as a frame, and what the file says of it."""
    seen = _opened(path, (1, 1))
    return (None, seen.frame, seen.words) if seen.truth is None else (seen.truth, None, seen.words)


def is_frame(path: str) -> bool:
    """Return whether a file is there and holds grey values as a sensor records them."""
    from lfcal.frames import open_image

    try:
        open_image(path).close()
    except LfcalError:
        return False
    return True


def _opened(path: str, side: tuple[int, int], dark: float = 0.0) -> Seen:
    """Return the middle of an image file, from a whole super-pixel on; ``dark``: black level where it states none."""
    from lfcal.frames import open_image, read_image

    try:
        image = open_image(path)
    except FileFormatError as error:
        try:
            planes = np.stack([read_image(path, colour=c) for c in "RGB"])
        except (FileFormatError, InputError):
            raise error from None
        part = _part(planes.shape[1:], (0, 0), side)
        scene = np.asarray(_cut(planes, part), np.float32)
        return Seen(scene[0], "colour image", scene / (float(scene.max()) or 1.0), part)
    try:
        frame, cfa = image.read(0), str(image.metadata.get("cfa", ""))
        level = black_level_map(image.metadata.get("black_level", dark), frame.shape)
    finally:
        image.close()
    part = _part(frame.shape, (0, 0), side)
    black = _cut(level, part) if level.ndim else level
    light = np.asarray(_cut(frame, part), np.float32) - black.astype(np.float32)
    return Seen(light, f"frame with filters {cfa}" if cfa else "frame", None, part, black)


def _part(shape: tuple[int, ...], first: tuple[int, int], side: tuple[int, int]) -> FramePart:
    """Return the middle part of a frame, from a whole super-pixel on; these begin at the sensor's corner.

    ``first`` is the sensor's pixel of the frame's first one.
    """
    start = [max(0, n - LARGEST) // 2 for n in shape]
    top, left = (s + -(s + f) % p for s, f, p in zip(start, first, side, strict=True))
    return FramePart((top, left), (shape[0], shape[1]))


def _cut(image: Array, part: FramePart) -> Array:
    return part.cut(image, (LARGEST, LARGEST))


def _from_live(frame: Array, first: tuple[int, int], side: tuple[int, int], sensor: Sensor) -> Seen:
    part, level = _part(frame.shape, first, side), sensor.black_level
    light = np.asarray(_cut(frame, part), np.float32) - np.float32(level)
    corner = (first[0] + part.corner[0], first[1] + part.corner[1])
    return Seen(light, f"live frame, {_sized(light.shape)}", None, FramePart(corner, sensor.shape), level)


def _from_file(settings: MultiplexSettings, modulator: Modulator, dark: float) -> Seen:
    if not settings.image:
        raise InputError("scene: no image yet; open one, or choose a built-in scene")
    seen = _opened(settings.image, modulator.side, dark)
    assert seen.part is not None  # of the file
    shape = seen.frame.shape
    words = f"{seen.words}, {_sized(shape)}"
    if shape != seen.part.whole:
        words = f"{seen.words}, the middle {_sized(shape)} of {_sized(seen.part.whole)} (a copied command takes all)"
    if seen.truth is None:
        return replace(seen, words=words)
    only_frames = settings.route == "lattice" or (settings.route == "general" and settings.transmissions)
    if only_frames or modulator.count != len(seen.truth):
        raise InputError.expected(
            "opened image",
            "a grey frame recorded behind this modulator",
            seen.words,
            "choose colour filters, or open a grey frame",
        )
    return Seen(multiplex(seen.truth, modulator), words, seen.truth, seen.part)


def noisy(frame: Array, sensor: Sensor, gain: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return ``frame`` with shot and read noise of a sensor whose full scale its brightest pixel fills."""
    scale = sensor.full_well_e / gain / (float(frame.max()) or 1.0)
    electrons = rng.poisson(np.maximum(frame, 0) * scale) + sensor.read_noise_e * rng.standard_normal(frame.shape)
    return np.asarray(electrons / scale)
