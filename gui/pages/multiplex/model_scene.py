"""Scenes of the Multiplexing page, recorded behind the modulator and reconstructed by both routes. No Qt."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gui.pages.multiplex.model import MultiplexSettings
from lfcal.camera import Sensor
from lfcal.errors import FileFormatError, InputError
from lfcal.multiplex.demultiplexing import demultiplex, multiplex
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
        The routes.
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
    """

    spatial: Route
    fourier: Route
    truth: Array | None = field(repr=False)
    frame: Array = field(repr=False)
    names: tuple[str, ...]
    words: str
    step: float = 1.0


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
    from lfcal.frames.formats.opening import open_image, read_image

    try:
        image = open_image(path)
    except FileFormatError as error:
        try:
            planes = np.stack([read_image(path, colour=c) for c in "RGB"])
        except (FileFormatError, InputError):
            raise error from None
        scene = _middle(planes)
        return scene / (float(scene.max()) or 1.0), None, "colour image"
    try:
        frame, cfa = image.read(0), str(image.metadata.get("cfa", ""))
        black = image.metadata.get("black_level", 0.0)
    finally:
        image.close()
    offset = float(np.mean(black)) if np.size(black) else 0.0
    return None, _middle(frame) - offset, f"frame with filters {cfa}" if cfa else "frame"


def _middle(image: Array) -> NDArray[np.float32]:
    """Return the middle part, beginning at a multiple of 12 px so that patterns of 2, 3, 4 and 6 px stay in step."""
    start = [max(0, n - LARGEST) // 2 // 12 * 12 for n in image.shape[-2:]]
    return np.asarray(image[..., start[0] : start[0] + LARGEST, start[1] : start[1] + LARGEST], np.float32)


def noisy(frame: Array, sensor: Sensor, gain: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return ``frame`` with shot and read noise of a sensor whose full scale its brightest pixel fills."""
    scale = sensor.full_well_e / gain / (float(frame.max()) or 1.0)
    electrons = rng.poisson(np.maximum(frame, 0) * scale) + sensor.read_noise_e * rng.standard_normal(frame.shape)
    return np.asarray(electrons / scale)


def iter_reconstruct(
    settings: MultiplexSettings, sensor: Sensor, live: tuple[Array, tuple[int, int]] | None = None
) -> Work[Reconstructions]:
    """Record the scene and reconstruct it by the spatial and by the Fourier route.

    ``live`` is a frame of the camera and the sensor's pixel (row, column) that its first one is: super-pixels begin at
    the sensor's corner.

    Raises
    ------
    InputError
        If the scene does not fit the modulator.
    """
    clock = Clock("reconstruct", 3)
    yield clock.at(0, "scene")
    modulator = settings.modulator()
    truth, frame, words = _recorded(settings, modulator, sensor, live)
    samples = modulator.side if truth is not None else None
    yield clock.at(1, f"spatial, {settings.filter}")
    routes = []
    weights = _weights(settings, frame, sensor)
    spatial = f"Spatial, {settings.filter}" if weights is None else "Spatial, weighted"
    for k, (route, name) in enumerate((("spatial", spatial), ("fourier", "Fourier"))):
        own = {} if weights is None or route == "fourier" else {"weights": weights}
        how: dict[str, Any] = {"route": route, "filter": None if own else settings.filter, "samples": samples}
        corner = np.s_[: 6 * modulator.side[0], : 6 * modulator.side[1]]  # loads compiled parts, not to be timed
        demultiplex(frame[corner], modulator, **how)
        start = time.perf_counter()
        found = demultiplex(frame, modulator, **how, **own)
        seconds = time.perf_counter() - start
        routes.append(Route(name, found, None if truth is None else rms_error(found, truth, modulator.side), seconds))
        yield clock.at(k + 2, "Fourier" if k == 0 else "")
    step = 1.0 if samples is not None else modulator.side[0] / modulator.natural_samples[0]
    return Reconstructions(routes[0], routes[1], truth, frame, modulator.sample_names, words, step)


def _weights(settings: MultiplexSettings, frame: Array, sensor: Sensor) -> Array | None:
    """Return the weights of a recorded frame, None where all pixels count alike."""
    if not settings.weighted or settings.scene not in ("image", "live"):
        return None
    return pixel_weights(frame + sensor.black_level, sensor, gain=settings.gain)


def from_live(frame: Array, first: tuple[int, int], side: tuple[int, int], black: float) -> Array:
    """Return the middle part of a live frame, less the black level, that begins with a whole super-pixel."""
    start = [max(0, n - LARGEST) // 2 for n in frame.shape]
    start = [s + -(s + f) % p for s, f, p in zip(start, first, side, strict=True)]
    part = frame[start[0] : start[0] + LARGEST, start[1] : start[1] + LARGEST]
    return np.asarray(part, np.float32) - np.float32(black)


def _recorded(
    settings: MultiplexSettings,
    modulator: Modulator,
    sensor: Sensor,
    live: tuple[Array, tuple[int, int]] | None,
) -> tuple[Array | None, Array, str]:
    truth: Array | None = None
    frame: Array | None = None
    words = "built-in scene"
    if settings.scene == "live":
        if live is None:
            raise InputError("scene: no live frame yet; switch the live view of the Acquire page on")
        frame, words = from_live(*live, modulator.side, sensor.black_level), "live frame"
    elif settings.scene == "image":
        if not settings.image:
            raise InputError("scene: no image yet; open one, or choose a built-in scene")
        truth, frame, words = opened(settings.image)
        if truth is not None and modulator.count != len(truth):
            raise InputError.expected(
                "opened image",
                "a grey frame recorded behind this modulator",
                words,
                "choose colour filters, or open a grey frame",
            )
    else:
        truth = scene_of(settings.scene, modulator)
    if frame is None and truth is not None:
        frame = multiplex(truth, modulator)
        if settings.noise:
            frame, words = noisy(frame, sensor, settings.gain, np.random.default_rng(1)), f"{words} with camera noise"
    assert frame is not None  # an opened image is one or the other
    return truth, frame, f"{words}, {frame.shape[1]} × {frame.shape[0]} px"


def rms_error(found: Array, truth: Array, side: tuple[int, int]) -> float:
    """Return the rms error over the scene's range, away from the border by four super-pixels or a quarter."""
    cut = [min(4 * s, n // 4) for n, s in zip(truth.shape[1:], side, strict=True)]
    inner = (slice(None), *(slice(c, n - c) for c, n in zip(cut, truth.shape[1:], strict=True)))
    span = float(np.ptp(truth)) or 1.0
    return float(np.sqrt(np.mean((found[inner] - truth[inner]) ** 2))) / span


def shown(found: Reconstructions, sample: int, right: str) -> tuple[Array, Array, Array]:
    """Return three pictures: one sample by both routes, and their difference (spatial - Fourier) or the truth.

    Sample -1 is all colours at once, ``(rows, columns, 3)`` in 0 … 1, where there are three samples.
    """
    truth = found.truth if right == "truth" else None  # not known of an opened frame
    if sample < 0:
        top = max(float(np.percentile(found.spatial.samples, 99.5)), 1e-12)
        one, two = (_colour(route.samples, top) for route in (found.spatial, found.fourier))
        if truth is None:
            return one, two, (found.spatial.samples - found.fourier.samples).mean(0)
        return one, two, _colour(truth, top)
    one, two = found.spatial.samples[sample], found.fourier.samples[sample]
    return one, two, one - two if truth is None else truth[sample]


def _colour(samples: Array, top: float) -> Array:
    return np.clip(np.moveaxis(samples, 0, -1) / top, 0, 1)
