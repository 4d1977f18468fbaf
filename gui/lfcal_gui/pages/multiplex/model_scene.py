"""Scenes and frames of the Multiplexing page, reconstructed by both routes. No Qt."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    Clock,
    FileFormatError,
    InputError,
    LfcalError,
    Work,
    format_pixels,
    format_seconds,
    map_npy,
    storage_errors,
)
from lfcal.camera import Camera, Sensor
from lfcal.frames import read_image
from lfcal.frames.corrections import read_average
from lfcal.lattice import FrameLattice, LatticeFit, ViewGrid, cropped, fit_lattice, lattice_of
from lfcal.multiplex import (
    Modulator,
    black_level_map,
    channel_grid,
    colour_edges,
    demultiplex,
    demultiplex_lattice,
    filament_light_field,
    is_straight,
    iter_demultiplex_generally,
    lattice_transmissions,
    multiplex,
    pixel_weights,
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
"""Largest number of transmissions of a built-in scene on the lattice."""

MOST_SOLVED = 64_000_000
"""Largest number of transmissions for the general route (half a gigabyte)."""

OF_FRAMES = "frames:"
"""Prefix of the path of a white image from Record > Folder, which is used only for frames of its size."""

Array = NDArray[Any]


@dataclass(frozen=True)
class FramePart:
    """Position of a part in the full frame: its first pixel (row, column), and the shape of the full frame."""

    corner: tuple[int, int]
    whole: tuple[int, int]

    def cut(self, image: Array, shape: tuple[int, ...]) -> Array:
        """Return the same part of a full image or of a stack of images."""
        (top, left), (rows, columns) = self.corner, shape
        return image[..., top : top + rows, left : left + columns]


def dead_pixels(path: str, part: FramePart, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return the dead pixels of a part of the frame (bool), from the map at ``path``."""
    marked = read_image(path)
    if marked.shape != part.whole:
        raise InputError.expected(
            "dead pixels",
            format_pixels(part.whole),
            format_pixels(marked.shape),
            "choose an image of the size of the frame",
        )
    return np.asarray(part.cut(marked, shape) != 0)


def shares_of(
    settings: MultiplexSettings, modulator: Modulator, part: FramePart | None, shape: Any
) -> Array | Modulator:
    """Return the weight of each sample in each pixel from the file of transmissions.

    Without a file, return ``modulator`` itself, which defines the weights.
    """
    if not settings.transmissions:
        _check_count(modulator.count, shape)
        return modulator
    found = _transmissions(settings.transmissions)
    if part is None:
        part = FramePart(_middle(found.shape[1:], shape), (found.shape[1], found.shape[2]))
    if found.shape[1:] != part.whole:
        raise InputError.expected(
            "transmissions",
            f"shape (N, {part.whole[0]}, {part.whole[1]})",
            found.shape,
            "choose an array with one value per pixel of the frame",
        )
    _check_count(len(found), shape)
    shares = np.asarray(part.cut(found, shape), float)
    if not np.isfinite(shares).all():
        raise InputError.expected("transmissions", "finite numbers", "NaN or infinity", "write 0 for dead pixels")
    return shares


def _check_count(samples: int, shape: tuple[int, ...]) -> None:
    if samples * math.prod(shape) > MOST_SOLVED:
        most = MOST_SOLVED // math.prod(shape)
        raise InputError.expected(
            "samples of the general route",
            f"up to {most} for this frame",
            samples,
            "open a smaller frame, or copy the command and run it in a terminal",
        )


def _transmissions(path: str) -> Array:
    found = map_npy(path)
    if found.ndim != 3 or not found.size:
        raise InputError.expected(
            "transmissions", "shape (N, rows, columns)", found.shape, "choose an array with one plane per sample"
        )
    return found


def _middle(whole: tuple[int, ...], shape: tuple[int, ...]) -> tuple[int, int]:
    return (whole[0] - shape[0]) // 2, (whole[1] - shape[1]) // 2


def scene_behind(settings: MultiplexSettings, modulator: Modulator) -> tuple[Array, Array]:
    """Return a built-in scene ``(N, rows, columns)``, and its frame for the central part of the transmissions."""
    whole = _transmissions(settings.transmissions).shape
    shape = (min(whole[1], SCENE_SIDE), min(whole[2], SCENE_SIDE))
    shares = np.asarray(shares_of(settings, modulator, None, shape))
    drawn = colour_edges(shape) if settings.scene == "edges" else zone_plate(shape, 0.2)
    scene = np.stack([np.roll(drawn[k % 3], 7 * (k // 3), axis=1) for k in range(whole[0])])
    return scene, np.asarray((shares * scene).sum(0))


def at_nodes(scene: Array, nodes: tuple[int, ...]) -> Array:
    """Return a scene at the nodes of the general route, which are at the centres of their cells."""
    places = [(np.arange(n) + 0.5) * size / n - 0.5 for n, size in zip(nodes, scene.shape[1:], strict=True)]
    return _sampled(scene, np.stack(np.meshgrid(*places, indexing="ij"), -1).reshape(-1, 2), nodes)


def at_samples(scene: Array, grid: ViewGrid) -> Array:
    """Return a scene at the sample positions of the views."""
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
    """Return the lattice of a frame, and its source in words.

    It is measured in a white image if there is one (`white_of`), else taken from the camera; a built-in scene is in the
    middle of the sensor.

    Raises
    ------
    InputError
        If the frame is not of this camera, or the white image has another size or no lattice.
    """
    path = white.removeprefix(OF_FRAMES)
    if part is not None and path:
        fit = _measured(path, _stamp(path))
        if fit.shape == part.whole:
            return cropped(fit, shape, part.corner), f"lattice measured in {Path(path).name}"
        if path == white:
            raise InputError.expected(
                "white image",
                f"{format_pixels(part.whole)}, as the frame has",
                format_pixels(fit.shape),
                "choose a white image of the same camera",
            )
    sensor = camera.sensor.shape
    if part is not None and part.whole != sensor:
        raise InputError.expected(
            "frame",
            f"{format_pixels(sensor)}, as the project's camera has",
            format_pixels(part.whole),
            "open a whole frame of this camera",
        )
    corner = _middle(sensor, shape) if part is None else part.corner
    return lattice_of(camera, shape, corner), f"lattice of {camera.name}, {camera.marks['lattice.pitch_um']}"


def _stamp(path: str) -> int:
    with storage_errors(Path(path)):
        return Path(path).stat().st_mtime_ns


@lru_cache(maxsize=2)
def _measured(path: str, _: int) -> LatticeFit:
    """Return the lattice of a white image, or of the mean of a folder of them; cached until the file changes."""
    return fit_lattice(read_average(path))


def lattice_scene(settings: MultiplexSettings, modulator: Modulator, camera: Camera) -> tuple[Array, Array]:
    """Return a built-in light field at every pixel, and its frame behind the modulator on the camera's lattice."""
    if modulator.side != modulator.cell or modulator.views[0] != modulator.views[1]:
        raise InputError.expected(
            "modulator on a lattice",
            "a square super-pixel that samples only views",
            modulator.name,
            "choose a mask or lenslets",
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
    """Return the light in each pixel behind a lenslet: the mean over its area, approximated by a box."""
    from scipy.ndimage import uniform_filter

    return np.asarray(uniform_filter(light, (0, round(lattice.row_pitch_px), round(lattice.pitch_px)), mode="nearest"))


def _scene_shape(modulator: Modulator, camera: Camera) -> tuple[int, int]:
    """Return rows and columns of a scene of a dozen super-pixels, or fewer if there are many views."""
    lattice, sensor = lattice_of(camera), camera.sensor.shape
    pitch = max(lattice.pitch_px, lattice.row_pitch_px)
    most = min(SCENE_CELLS * pitch, math.sqrt(MOST_SHARES / modulator.count))
    if most < FEWEST_CELLS * pitch:
        raise InputError.expected(
            "mask for a built-in scene on this lattice",
            f"up to {int(MOST_SHARES / (FEWEST_CELLS * pitch) ** 2)} views",
            modulator.count,
            "choose a smaller mask, or open a recorded frame",
        )
    return min(sensor[0], round(most)), min(sensor[1], round(most))


CFA_SIDE = 240
SCENE_VALUES = 4_000_000
LARGEST = 1536
"""Largest side of the middle part of an opened image or a live frame that is used (px)."""


@dataclass(frozen=True, eq=False)
class Seen:
    """A recorded frame.

    Attributes
    ----------
    frame
        Frame ``(rows, columns)`` minus the black level.
    words
        Description of the frame.
    truth
        True scene at every pixel; None if unknown.
    part
        Position in the full frame; None for built-in scenes.
    level
        Subtracted black level: a number, or one per pixel.
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
    """Return the frame recorded behind the modulator; parameters as in `iter_reconstruct`."""
    if settings.scene == "live":
        if live is None:
            raise InputError("scene: no live frame yet; connect the camera in Record > Rig (Connect)")
        return _from_live(live[0], live[1], modulator.side, sensor)
    if settings.scene == "image":
        return _from_file(settings, modulator, sensor.black_level if settings.weighted else 0.0)
    frame: Array | None = None
    if settings.route == "lattice" and camera is not None:
        truth, frame = lattice_scene(settings, modulator, camera)
    elif settings.route == "general" and settings.transmissions:
        truth, frame = scene_behind(settings, modulator)
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
            "choose a smaller size, or open a recorded frame",
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
    """Return one plane with a distinct shape for each sample, made from planes of three colours.

    Stokes parameters are fractions of S0, so that the light is physical.
    """
    names = modulator.colours or ("light",)
    planes = np.stack([np.roll(shown[k % 3], 7 * (k // 3), axis=1) for k in range(len(names))])
    if any(name.startswith("S0") for name in names):
        stokes = [not name.startswith("S0") for name in names]
        planes[stokes] = 0.5 * planes[stokes] * shown.mean(0) - 0.1
    return planes


def opened(path: str) -> tuple[Array | None, Array | None, str]:
    """Return an image file as a scene ``(3, rows, columns)`` in 0 … 1 or as a frame, and its description."""
    seen = _opened(path, (1, 1))
    return (None, seen.frame, seen.words) if seen.truth is None else (seen.truth, None, seen.words)


def is_frame(path: str) -> bool:
    """Return whether a file exists and contains grey values, as a sensor records them."""
    from lfcal.frames import open_image

    try:
        open_image(path).close()
    except LfcalError:
        return False
    return True


def _opened(path: str, side: tuple[int, int], dark: float = 0.0) -> Seen:
    """Return the central part of an image file, aligned to super-pixels; ``dark``: black level if none is stated."""
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
    """Return the central part of a frame, aligned to super-pixels, which begin at the corner of the sensor.

    ``first`` is the sensor pixel (row, column) of the frame's first pixel.
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
        words = (
            f"{seen.words}, the middle {_sized(shape)} of {_sized(seen.part.whole)} (a copied command uses all pixels)"
        )
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
    """Return ``frame`` with shot and read noise of a sensor, scaled so that its brightest pixel reaches full scale."""
    scale = sensor.full_well_e / gain / (float(frame.max()) or 1.0)
    electrons = rng.poisson(np.maximum(frame, 0) * scale) + sensor.read_noise_e * rng.standard_normal(frame.shape)
    return np.asarray(electrons / scale)


@dataclass(frozen=True, eq=False)
class Route:
    """Samples ``(N, rows, columns)`` of one route, rms error relative to the range of the scene, and time (s)."""

    name: str
    samples: Array = field(repr=False)
    error: float | None
    seconds: float

    @property
    def words(self) -> str:
        """Name, error and time as one line of text."""
        error = "" if self.error is None else f"error {100 * self.error:.2f} % rms, "
        return f"{self.name}: {error}{format_seconds(self.seconds)}"


@dataclass(frozen=True, eq=False)
class Reconstructions:
    """Reconstructions of one frame by both routes.

    Attributes
    ----------
    spatial, fourier
        The two routes; the general route has no second one.
    truth
        True scene at the same positions; None if unknown.
    frame
        Recorded frame.
    names
        Names of the samples.
    words
        Description of the frame.
    step
        Distance between samples (pixels of the frame).
    origin
        Position (row, column) of the first sample in the frame (pixels). None: samples fill the frame.
    """

    spatial: Route
    fourier: Route | None
    truth: Array | None = field(repr=False)
    frame: Array = field(repr=False)
    names: tuple[str, ...]
    words: str
    step: float = 1.0
    origin: tuple[float, float] | None = None


def iter_reconstruct(
    settings: MultiplexSettings,
    sensor: Sensor,
    live: tuple[Array, tuple[int, int]] | None = None,
    camera: Camera | None = None,
) -> Work[Reconstructions]:
    """Record the scene and reconstruct it by the chosen routes.

    ``live`` is a frame of the camera, with the sensor coordinates (row, column) of its first pixel: super-pixels begin
    at the sensor's corner. ``camera`` states the lattice for the route ``"lattice"``.

    Raises
    ------
    InputError
        If the scene does not match the modulator, or a file does not match the frame.
    """
    modulator = settings.modulator()
    seen = recorded(settings, modulator, sensor, live, camera)
    solve = {"cells": _iter_cells, "general": _iter_general, "lattice": _iter_lattice}[settings.route]
    found: Reconstructions = yield from solve(settings, modulator, seen, sensor, camera)
    return found


def _iter_cells(
    settings: MultiplexSettings, modulator: Modulator, seen: Seen, sensor: Sensor, _: Camera | None
) -> Work[Reconstructions]:
    clock, truth, usable = Clock("reconstruct", 2), seen.truth, _finite(seen, settings)
    samples = modulator.side if truth is not None else None
    yield clock.at(0, f"spatial, {settings.filter}")
    found_by: list[Route] = []
    weights = _weights(settings, seen, sensor)
    spatial = f"Spatial, {settings.filter}" if weights is None else "Spatial, weighted"
    for k, (route, name) in enumerate((("spatial", spatial), ("fourier", "Fourier"))):
        own = None if route == "fourier" else weights
        frame, filtered = (usable, settings.filter) if own is None else (seen.frame, None)
        how: dict[str, Any] = {"route": route, "filter": filtered, "samples": samples}
        corner = np.s_[: 6 * modulator.side[0], : 6 * modulator.side[1]]  # loads compiled parts, not to be timed
        demultiplex(usable[corner], modulator, **how)
        start = time.perf_counter()
        found = demultiplex(frame, modulator, **how, weights=own)
        seconds = time.perf_counter() - start
        error = None if truth is None else rms_error(found, truth, modulator.side)
        found_by.append(Route(name, found, error, seconds))
        yield clock.at(k + 1, "Fourier" if k == 0 else "")
    step = 1.0 if samples is not None else modulator.side[0] / modulator.natural_samples[0]
    spatial_route, fourier_route = found_by
    return Reconstructions(spatial_route, fourier_route, truth, seen.frame, modulator.sample_names, seen.words, step)


def _iter_general(
    settings: MultiplexSettings, modulator: Modulator, seen: Seen, sensor: Sensor, _: Camera | None
) -> Work[Reconstructions]:
    shares = shares_of(settings, modulator, seen.part, seen.frame.shape)
    own = not isinstance(shares, Modulator)
    count = len(shares) if isinstance(shares, np.ndarray) else modulator.count
    spacing = settings.spacing or math.sqrt(count)
    start = time.perf_counter()
    found = yield from iter_demultiplex_generally(
        seen.frame, shares, spacing, weights=_weights(settings, seen, sensor), smoothness=settings.smoothness
    )
    seconds = time.perf_counter() - start
    truth = None if seen.truth is None else at_nodes(seen.truth, found.samples.shape[1:])
    error = None if truth is None else rms_error(found.samples, truth, (1, 1))
    names = tuple(f"sample {k}" for k in range(count)) if own else modulator.sample_names
    counts = f"{found.iterations} iterations, residual {found.residual:.1e}, {found.operations:.1e} multiply-adds"
    route = Route("General", found.samples, error, seconds)
    step = seen.frame.shape[0] / found.samples.shape[1]
    return Reconstructions(route, None, truth, seen.frame, names, f"{seen.words}; {counts}", step)


def _iter_lattice(
    settings: MultiplexSettings, modulator: Modulator, seen: Seen, sensor: Sensor, camera: Camera | None
) -> Work[Reconstructions]:
    assert camera is not None  # the frame was taken with it
    clock, shape = Clock("reconstruct", 2), (seen.frame.shape[0], seen.frame.shape[1])
    yield clock.at(0, "lattice")
    lattice, source = frame_lattice(settings.white, camera, seen.part, shape)
    grid = channel_grid(shape, lattice, modulator.side, spacing_px=None)
    truth = None if seen.truth is None else at_samples(seen.truth, grid)
    weights = _weights(settings, seen, sensor)
    spatial: dict[str, Any] = {"filter": settings.filter} if weights is None else {"weights": weights}
    ways = [("Spatial, weighted" if weights is not None else f"Spatial, {settings.filter}", seen.frame, spatial)]
    words = f"{seen.words}; {source}: {grid.described()}"
    if is_straight(lattice):
        ways.append(("Fourier", _finite(seen, settings), {"route": "fourier"}))
    else:
        words += "; no Fourier route, because the lattice's rows are bent"
    found_by: list[Route | None] = []
    for k, (name, frame, how) in enumerate(ways):
        yield clock.at(k, name)
        start = time.perf_counter()
        found = demultiplex_lattice(frame, lattice, modulator, **how)
        seconds = time.perf_counter() - start
        found_by.append(Route(name, found, None if truth is None else rms_error(found, truth, (1, 1)), seconds))
    yield clock.at(2)
    first, second = (*found_by, None)[:2]
    assert first is not None
    names = modulator.sample_names
    return Reconstructions(first, second, truth, seen.frame, names, words, grid.step_px[1], grid.corner_px)


def _finite(seen: Seen, settings: MultiplexSettings) -> Array:
    """Return a frame for a route without weights, with dead pixels (NaN) set to 0."""
    if settings.dead or settings.weighted:
        return np.where(np.isfinite(seen.frame), seen.frame, np.zeros((), seen.frame.dtype))
    return seen.frame


def _weights(settings: MultiplexSettings, seen: Seen, sensor: Sensor) -> Array | None:
    """Return the weights of a recorded frame; None if all pixels have the same weight."""
    weighted = settings.weighted and seen.truth is None
    if seen.part is None or not (weighted or settings.dead):
        return None
    shape = seen.frame.shape
    dead = dead_pixels(settings.dead, seen.part, shape) if settings.dead else np.zeros(shape, bool)
    if not weighted:
        return np.where(dead, 0.0, 1.0)
    raw = seen.frame + np.asarray(seen.level, np.float32)
    return pixel_weights(raw, sensor, dead=dead, gain=settings.gain, black_level=seen.level)


def rms_error(found: Array, truth: Array, side: tuple[int, int]) -> float:
    """Return the rms error relative to the range of the scene, without a border of four super-pixels or a quarter."""
    cut = [min(4 * s, n // 4) for n, s in zip(truth.shape[1:], side, strict=True)]
    inner = (slice(None), *(slice(c, n - c) for c, n in zip(cut, truth.shape[1:], strict=True)))
    span = float(np.ptp(truth)) or 1.0
    return float(np.sqrt(np.mean((found[inner] - truth[inner]) ** 2))) / span


def shown(found: Reconstructions, sample: int, right: str) -> tuple[Array, Array | None, Array | None]:
    """Return three images: one sample by both routes, and their difference (spatial - Fourier) or the truth.

    With a single route, the second image is None and the truth replaces the difference.

    Sample -1 is the colour image ``(rows, columns, 3)`` in 0 … 1; it requires three samples.
    """
    second = None if found.fourier is None else found.fourier.samples
    truth = found.truth if right == "truth" or second is None else None  # not known of an opened frame
    first = found.spatial.samples
    gap = None if second is None else first - second
    if sample < 0:
        top = max(float(np.percentile(first, 99.5)), 1e-12)
        one, two = _colour(first, top), None if second is None else _colour(second, top)
        if truth is None:
            return one, two, None if gap is None else gap.mean(0)
        return one, two, _colour(truth, top)
    two = None if second is None else second[sample]
    third = truth if truth is not None else gap
    return first[sample], two, None if third is None else third[sample]


def _colour(samples: Array, top: float) -> Array:
    return np.clip(np.moveaxis(samples, 0, -1) / top, 0, 1)
