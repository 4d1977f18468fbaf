"""Scenes of the Multiplexing page, recorded behind the modulator and reconstructed by both routes. No Qt."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gui.pages.multiplex import model_routes as routes
from gui.pages.multiplex.model import MultiplexSettings
from gui.pages.multiplex.model_routes import Part
from lfcal.camera import Camera, Sensor
from lfcal.errors import FileFormatError, InputError
from lfcal.multiplex.demultiplexing import demultiplex, multiplex
from lfcal.multiplex.general import iter_demultiplex_generally
from lfcal.multiplex.lattice import channel_grid, demultiplex_lattice
from lfcal.multiplex.modulator import Modulator
from lfcal.multiplex.scenes import colour_edges, filament_light_field, view_edges, zone_plate
from lfcal.multiplex.sensor_noise import pixel_weights
from lfcal.progress import Clock, Work
from lfcal.units import format_seconds

__all__ = ["Reconstructions", "Route", "iter_reconstruct", "opened", "scene_of", "shown"]

CFA_SIDE = 240
SCENE_VALUES = 4_000_000
FEWEST_CELLS = 6
LARGEST = 1536
"""Side of the middle part taken of an opened image (px)."""

Array = NDArray[Any]


@dataclass(frozen=True, eq=False)
class Route:
    """Samples ``(N, rows, columns)`` by one route, rms error as a share of the scene's range, and seconds."""

    name: str
    samples: Array = field(repr=False)
    error: float | None
    seconds: float

    @property
    def words(self) -> str:
        """Name, error and time in a line."""
        error = "" if self.error is None else f"error {100 * self.error:.2f} % rms, "
        return f"{self.name}: {error}{format_seconds(self.seconds)}"


@dataclass(frozen=True, eq=False)
class Reconstructions:
    """Both routes of one frame.

    Attributes
    ----------
    spatial, fourier
        The routes; the general one has no second.
    truth
        The scene at the same places, None where it is not known.
    frame
        What the sensor recorded.
    names
        Of the samples.
    words
        What was recorded.
    step
        Pixels of the frame from one sample to the next.
    origin
        Place (row, column) of the first sample on the frame (pixels); None: samples fill the frame.
    """

    spatial: Route
    fourier: Route | None
    truth: Array | None = field(repr=False)
    frame: Array = field(repr=False)
    names: tuple[str, ...]
    words: str
    step: float = 1.0
    origin: tuple[float, float] | None = None


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
    """Return as many planes as a direction has samples, unlike in their shapes, from those of three colours.

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
    return _opened(path)[:3]


def _opened(path: str, dark: float = 0.0) -> tuple[Array | None, Array | None, str, Part]:
    """Return the same, and which part of the file it is; ``dark`` is the level of no light where it states none."""
    from lfcal.frames.formats.opening import open_image, read_image

    try:
        image = open_image(path)
    except FileFormatError as error:
        try:
            planes = np.stack([read_image(path, colour=c) for c in "RGB"])
        except (FileFormatError, InputError):
            raise error from None
        scene = _middle(planes)
        return scene / (float(scene.max()) or 1.0), None, "colour image", _part(planes.shape)
    try:
        frame, cfa = image.read(0), str(image.metadata.get("cfa", ""))
        black = image.metadata.get("black_level", dark)
    finally:
        image.close()
    offset = float(np.mean(black)) if np.size(black) else 0.0
    return None, _middle(frame) - offset, f"frame with filters {cfa}" if cfa else "frame", _part(frame.shape)


def _middle(image: Array) -> NDArray[np.float32]:
    """Return the middle part, beginning at a multiple of 12 px so that patterns of 2, 3, 4 and 6 px stay in step."""
    start = _part(image.shape).corner
    return np.asarray(image[..., start[0] : start[0] + LARGEST, start[1] : start[1] + LARGEST], np.float32)


def _part(shape: tuple[int, ...]) -> Part:
    rows, columns = shape[-2:]
    return Part((max(0, rows - LARGEST) // 2 // 12 * 12, max(0, columns - LARGEST) // 2 // 12 * 12), (rows, columns))


def noisy(frame: Array, sensor: Sensor, gain: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return ``frame`` with shot and read noise of a sensor whose full scale its brightest pixel fills."""
    scale = sensor.full_well_e / gain / (float(frame.max()) or 1.0)
    electrons = rng.poisson(np.maximum(frame, 0) * scale) + sensor.read_noise_e * rng.standard_normal(frame.shape)
    return np.asarray(electrons / scale)


def iter_reconstruct(
    settings: MultiplexSettings,
    sensor: Sensor,
    live: tuple[Array, tuple[int, int]] | None = None,
    camera: Camera | None = None,
) -> Work[Reconstructions]:
    """Record the scene and reconstruct it by the routes chosen.

    ``live`` is a frame of the camera and the sensor's pixel (row, column) that its first one is: super-pixels begin at
    the sensor's corner. ``camera`` states the lattice of that route.

    Raises
    ------
    InputError
        If the scene does not fit the modulator, or a file not the frame.
    """
    modulator = settings.modulator()
    seen = _recorded(settings, modulator, sensor, live, camera)
    solve = {"cells": _iter_cells, "general": _iter_general, "lattice": _iter_lattice}[settings.route]
    found: Reconstructions = yield from solve(settings, modulator, seen, sensor, camera)
    return found


@dataclass(frozen=True, eq=False)
class _Seen:
    """A frame, its scene where known, words about it, and of what it is a part."""

    truth: Array | None
    frame: Array
    words: str
    part: Part | None


def _iter_cells(
    settings: MultiplexSettings, modulator: Modulator, seen: _Seen, sensor: Sensor, _: Camera | None
) -> Work[Reconstructions]:
    clock, frame, truth = Clock("reconstruct", 2), seen.frame, seen.truth
    samples = modulator.side if truth is not None else None
    yield clock.at(0, f"spatial, {settings.filter}")
    found_by = []
    weights = _weights(settings, seen, sensor)
    spatial = f"Spatial, {settings.filter}" if weights is None else "Spatial, weighted"
    for k, (route, name) in enumerate((("spatial", spatial), ("fourier", "Fourier"))):
        own = {} if weights is None or route == "fourier" else {"weights": weights}
        how: dict[str, Any] = {"route": route, "filter": None if own else settings.filter, "samples": samples}
        corner = np.s_[: 6 * modulator.side[0], : 6 * modulator.side[1]]  # loads compiled parts, not to be timed
        demultiplex(frame[corner], modulator, **how)
        start = time.perf_counter()
        found = demultiplex(frame, modulator, **how, **own)
        seconds = time.perf_counter() - start
        error = None if truth is None else rms_error(found, truth, modulator.side)
        found_by.append(Route(name, found, error, seconds))
        yield clock.at(k + 1, "Fourier" if k == 0 else "")
    step = 1.0 if samples is not None else modulator.side[0] / modulator.natural_samples[0]
    return Reconstructions(*found_by, truth, frame, modulator.sample_names, seen.words, step)


def _iter_general(
    settings: MultiplexSettings, modulator: Modulator, seen: _Seen, sensor: Sensor, _: Camera | None
) -> Work[Reconstructions]:
    shares = routes.shares_of(settings, modulator, seen.part, seen.frame.shape)
    own = not isinstance(shares, Modulator)
    count = len(shares) if isinstance(shares, np.ndarray) else modulator.count
    spacing = settings.spacing or math.sqrt(count)
    start = time.perf_counter()
    found = yield from iter_demultiplex_generally(
        seen.frame, shares, spacing, weights=_weights(settings, seen, sensor), smoothness=settings.smoothness
    )
    seconds = time.perf_counter() - start
    truth = None if seen.truth is None else routes.at_nodes(seen.truth, found.samples.shape[1:])
    error = None if truth is None else rms_error(found.samples, truth, (1, 1))
    names = tuple(f"sample {k}" for k in range(count)) if own else modulator.sample_names
    told = f"{found.iterations} iterations, residual {found.residual:.1e}, {found.operations:.1e} multiply-adds"
    route = Route("General", found.samples, error, seconds)
    step = seen.frame.shape[0] / found.samples.shape[1]
    return Reconstructions(route, None, truth, seen.frame, names, f"{seen.words}; {told}", step)


def _iter_lattice(
    settings: MultiplexSettings, modulator: Modulator, seen: _Seen, _: Sensor, camera: Camera | None
) -> Work[Reconstructions]:
    assert camera is not None  # the frame was taken with it
    clock, frame = Clock("reconstruct", 2), seen.frame
    lattice = routes.part_lattice(camera, seen.part, (frame.shape[0], frame.shape[1]))
    grid = channel_grid(frame.shape, lattice, modulator.side, spacing_px=None)
    truth = None if seen.truth is None else routes.at_samples(seen.truth, grid)
    found_by = []
    for k, (route, name) in enumerate((("spatial", f"Spatial, {settings.filter}"), ("fourier", "Fourier"))):
        yield clock.at(k, name)
        start = time.perf_counter()
        found = demultiplex_lattice(frame, lattice, modulator, route=route, filter=settings.filter)
        seconds = time.perf_counter() - start
        found_by.append(Route(name, found, None if truth is None else rms_error(found, truth, (1, 1)), seconds))
    yield clock.at(2)
    words = f"{seen.words}; lattice of {camera.name}: {grid.described()}"
    names = modulator.sample_names
    return Reconstructions(*found_by, truth, frame, names, words, grid.step_px[1], grid.corner_px)


def _weights(settings: MultiplexSettings, seen: _Seen, sensor: Sensor) -> Array | None:
    """Return the weights of a recorded frame, None where all pixels count alike."""
    if seen.part is None or not (settings.weighted or settings.dead):
        return None
    shape = seen.frame.shape
    dead = routes.dead_pixels(settings.dead, seen.part, shape) if settings.dead else np.zeros(shape, bool)
    if not settings.weighted:
        return np.where(dead, 0.0, 1.0)
    return pixel_weights(seen.frame + sensor.black_level, sensor, dead=dead, gain=settings.gain)


def _live_corner(shape: tuple[int, ...], first: tuple[int, int], side: tuple[int, int]) -> tuple[int, int]:
    start = [max(0, n - LARGEST) // 2 for n in shape]
    top, left = (s + -(s + f) % p for s, f, p in zip(start, first, side, strict=True))
    return top, left


def from_live(frame: Array, first: tuple[int, int], side: tuple[int, int], black: float) -> Array:
    """Return the middle part of a live frame, less the black level, that begins with a whole super-pixel."""
    top, left = _live_corner(frame.shape, first, side)
    return np.asarray(frame[top : top + LARGEST, left : left + LARGEST], np.float32) - np.float32(black)


def _recorded(
    settings: MultiplexSettings,
    modulator: Modulator,
    sensor: Sensor,
    live: tuple[Array, tuple[int, int]] | None,
    camera: Camera | None,
) -> _Seen:
    if settings.scene == "live":
        if live is None:
            raise InputError("scene: no live frame yet; switch the live view of the Acquire page on")
        (image, first), side = live, modulator.side
        top, left = _live_corner(image.shape, first, side)
        part = Part((first[0] + top, first[1] + left), sensor.shape)
        return _seen(None, from_live(image, first, side, sensor.black_level), "live frame", part)
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
    return _seen(truth, frame, words, None)


def _from_file(settings: MultiplexSettings, modulator: Modulator, dark: float) -> _Seen:
    if not settings.image:
        raise InputError("scene: no image yet; open one, or choose a built-in scene")
    truth, frame, words, part = _opened(settings.image, dark)
    if truth is None:
        assert frame is not None  # an opened image is one or the other
        return _seen(None, frame, words, part)
    only_frames = settings.route == "lattice" or (settings.route == "general" and settings.transmissions)
    if only_frames or modulator.count != len(truth):
        raise InputError.expected(
            "opened image",
            "a grey frame recorded behind this modulator",
            words,
            "choose colour filters, or open a grey frame",
        )
    return _seen(truth, multiplex(truth, modulator), words, part)


def _seen(truth: Array | None, frame: Array, words: str, part: Part | None) -> _Seen:
    return _Seen(truth, frame, f"{words}, {frame.shape[1]} × {frame.shape[0]} px", part)


def rms_error(found: Array, truth: Array, side: tuple[int, int]) -> float:
    """Return the rms error over the scene's range, away from the border by four super-pixels or a quarter."""
    cut = [min(4 * s, n // 4) for n, s in zip(truth.shape[1:], side, strict=True)]
    inner = (slice(None), *(slice(c, n - c) for c, n in zip(cut, truth.shape[1:], strict=True)))
    span = float(np.ptp(truth)) or 1.0
    return float(np.sqrt(np.mean((found[inner] - truth[inner]) ** 2))) / span


def shown(found: Reconstructions, sample: int, right: str) -> tuple[Array, Array | None, Array | None]:
    """Return three pictures: one sample by both routes, and their difference (spatial - Fourier) or the truth.

    Where there is one route there is no second picture, and the truth in place of a difference.

    Sample -1 is all colours at once, ``(rows, columns, 3)`` in 0 … 1, where there are three samples.
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
