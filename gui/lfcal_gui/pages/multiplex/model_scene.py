"""Frames of the Multiplexing page, reconstructed by both routes. No Qt."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, Work, format_seconds
from lfcal.camera import Camera, Sensor
from lfcal.multiplex import (
    Modulator,
    channel_grid,
    demultiplex,
    demultiplex_lattice,
    is_straight,
    iter_demultiplex_generally,
    pixel_weights,
)
from lfcal_gui.pages.multiplex import model_routes as routes
from lfcal_gui.pages.multiplex.model import MultiplexSettings
from lfcal_gui.pages.multiplex.model_frames import Seen, recorded

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
        """Name, error and time as one line of text."""
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


def iter_reconstruct(
    settings: MultiplexSettings,
    sensor: Sensor,
    live: tuple[Array, tuple[int, int]] | None = None,
    camera: Camera | None = None,
) -> Work[Reconstructions]:
    """Record the scene and reconstruct it by the routes chosen.

    ``live`` is a frame of the camera, with the sensor coordinates (row, column) of its first pixel: super-pixels begin
    at the sensor's corner. ``camera`` states the lattice for the route by lattice.

    Raises
    ------
    InputError
        If the scene does not fit the modulator, or a file not the frame.
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
    settings: MultiplexSettings, modulator: Modulator, seen: Seen, sensor: Sensor, camera: Camera | None
) -> Work[Reconstructions]:
    assert camera is not None  # the frame was taken with it
    clock, shape = Clock("reconstruct", 2), (seen.frame.shape[0], seen.frame.shape[1])
    yield clock.at(0, "lattice")
    lattice, source = routes.frame_lattice(settings.white, camera, seen.part, shape)
    grid = channel_grid(shape, lattice, modulator.side, spacing_px=None)
    truth = None if seen.truth is None else routes.at_samples(seen.truth, grid)
    weights = _weights(settings, seen, sensor)
    spatial: dict[str, Any] = {"filter": settings.filter} if weights is None else {"weights": weights}
    ways = [("Spatial, weighted" if weights is not None else f"Spatial, {settings.filter}", seen.frame, spatial)]
    words = f"{seen.words}; {source}: {grid.described()}"
    if is_straight(lattice):
        ways.append(("Fourier", _finite(seen, settings), {"route": "fourier"}))
    else:
        words += "; no Fourier route, as its rows are bent"
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
    """Return the weights of a recorded frame, None where all pixels count alike."""
    weighted = settings.weighted and seen.truth is None
    if seen.part is None or not (weighted or settings.dead):
        return None
    shape = seen.frame.shape
    dead = routes.dead_pixels(settings.dead, seen.part, shape) if settings.dead else np.zeros(shape, bool)
    if not weighted:
        return np.where(dead, 0.0, 1.0)
    raw = seen.frame + np.asarray(seen.level, np.float32)
    return pixel_weights(raw, sensor, dead=dead, gain=settings.gain, black_level=seen.level)


def rms_error(found: Array, truth: Array, side: tuple[int, int]) -> float:
    """Return the rms error over the scene's range, away from the border by four super-pixels or a quarter."""
    cut = [min(4 * s, n // 4) for n, s in zip(truth.shape[1:], side, strict=True)]
    inner = (slice(None), *(slice(c, n - c) for c, n in zip(cut, truth.shape[1:], strict=True)))
    span = float(np.ptp(truth)) or 1.0
    return float(np.sqrt(np.mean((found[inner] - truth[inner]) ** 2))) / span


def shown(found: Reconstructions, sample: int, right: str) -> tuple[Array, Array | None, Array | None]:
    """Return three pictures: one sample by both routes, and their difference (spatial - Fourier) or the truth.

    With a single route the second picture is None, and the truth replaces the difference.

    Sample -1 is the colour picture ``(rows, columns, 3)`` in 0 … 1; it requires three samples.
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
