"""Light-field frames of scenes with known slopes, rendered ray by ray; shares no code with the estimator.

A ray that passes a lenslet at ``a`` (pixels from its centre) and meets the sensor ``u`` from the micro-image's centre
``c`` crosses the plane of slope w at ``S = c + a + w (u - a / f)``, where f is the slope that the lenslet has in focus.
A scene is a texture and a slope for every S. The first crossing from the lenslets on is seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
Surface = Callable[[Array, Array], Array]
"""Function of the place S (row, column; pixels from the middle of the frame)."""


@dataclass(frozen=True, eq=False)
class Drawn:
    """Frame, white frame, micro-image centres (row, column), and the surface that was drawn."""

    frame: Array
    white: Array
    centres: Array
    surface: Surface
    pitch: float

    def slope(self, rows: Array, columns: Array) -> Array:
        """Return the true slope at places of the frame."""
        middle = (np.array(self.frame.shape) - 1) / 2
        return self.surface(rows - middle[0], columns - middle[1])


def plane(slope: float, down: float = 0.0, right: float = 0.0) -> Surface:
    """Return a plane with a slope at the middle and its change per 100 pixels down and right."""
    return lambda y, x: slope + (down * y + right * x) / 100


def step(left: float, right: float, at: float = 0.0) -> Surface:
    """Return two planes that meet in a vertical edge."""
    return lambda y, x: np.where(x < at, left, right)


def ball(back: float, front: float, radius: float) -> Surface:
    """Return a ball in front of a plane; its slope is ``front`` at the middle, and the plane's at its rim."""

    def surface(y: Array, x: Array) -> Array:
        arm = np.clip(1 - (y**2 + x**2) / radius**2, 0, None)
        return back + (front - back) * np.sqrt(arm)

    return surface


def texture(seed: int = 0, finest: float = 8.0, extent: int = 1024) -> Surface:
    """Return a random texture between 0.1 and 1, of waves from ``finest`` to ten times as long (pixels at S)."""
    k = np.hypot(np.fft.fftfreq(extent)[:, None], np.fft.rfftfreq(extent)[None])
    band = np.where((k <= 1 / finest) & (k >= 0.1 / finest), 1 / np.maximum(k, 1e-9), 0)
    noise = np.fft.rfft2(np.random.default_rng(seed).normal(size=(extent, extent)))
    values = np.fft.irfft2(noise * band, (extent, extent))
    smooth = spline_filter(np.clip(0.55 + 0.2 * values / values.std(), 0.1, 1.0), mode="grid-wrap")

    def shade(y: Array, x: Array) -> Array:
        return np.asarray(map_coordinates(smooth, [y, x], mode="grid-wrap", prefilter=False))

    return shade


def draw(
    shape: tuple[int, int],
    pitch: float,
    surface: Surface,
    *,
    kind: str = "hexagonal",
    rotation: float = 0.0,
    focus: tuple[float, ...] = (3.0,),
    shade: Surface | None = None,
    fill: float = 0.96,
    apertures: int = 5,
    level: float = 2000.0,
    noise: float = 0.0,
    flat: bool = False,
    pupil: float | None = None,
    offset: tuple[float, float] = (0.3, -0.2),
    span: tuple[float, float] | None = None,
    seed: int = 0,
) -> Drawn:
    """Draw a frame whose lenslets are in focus at slopes ``focus``, by type ``(q - r) mod 3`` if there are three.

    ``fill`` is the diameter of the lenslets and of their micro-images (pitches), ``apertures`` the number of rays
    across a lenslet, ``noise`` its standard deviation at full ``level`` (of the level; shot noise), ``flat`` leaves
    the vignetting out, ``pupil`` is the diameter of the main lens's image in a micro-image (pitches; None: no main lens
    limits the rays), and ``span`` are the slopes between which the scene lies (default: from the surface).
    """
    shade = texture(seed) if shade is None else shade
    centres, types, own, u = _cells(shape, pitch, kind, rotation, offset)
    middle = (np.array(shape) - 1) / 2
    base = centres[own] - middle
    arm = np.hypot(*np.moveaxis(u, -1, 0)) / (fill * pitch / 2)
    white = np.where(arm <= 1, 1 - (0.0 if flat else 0.35) * arm**2, 0.0)
    light, lit = np.zeros(shape), np.zeros(shape)
    grid = (np.arange(apertures) + 0.5) / apertures * 2 - 1
    rays = [(y, x) for y in grid for x in grid if y * y + x * x <= 1]
    inverse = 1 / np.array(focus, float)
    focal = inverse[types[own] if len(focus) == 3 else np.zeros(shape, int)]
    y, x = np.mgrid[: shape[0], : shape[1]] - middle[:, None, None]
    seen = surface(y, x)
    low, high = (float(seen.min()), float(seen.max())) if span is None else span
    for ray in rays:
        a = np.array(ray) * fill * pitch / 2
        start, along = base + a, u - focal[..., None] * a
        w = _crossing(surface, start, along, low, high)
        place = start + w[..., None] * along
        passed = 1.0 if pupil is None else np.hypot(*np.moveaxis(along, -1, 0)) <= pupil * pitch / 2
        light += passed * shade(place[..., 0], place[..., 1])
        lit += passed
    frame = level * white * light / len(rays)
    white = white * lit / len(rays)
    rng = np.random.default_rng(seed + 1)
    frame = frame + noise * np.sqrt(np.maximum(frame, 0) * level) * rng.normal(size=shape)
    return Drawn(frame, level * white, centres, surface, pitch)


def _crossing(surface: Surface, start: Array, along: Array, low: float, high: float) -> Array:
    """Return the smallest w at which ``start + w along`` is on the surface."""
    if high - low < 1e-9:
        return np.full(start.shape[:2], low)
    steps = np.linspace(low - 0.05, high + 0.05, 40)
    before = np.full(start.shape[:2], np.inf)
    found = np.full(start.shape[:2], np.nan)
    for k, w in enumerate(steps):
        place = start + w * along
        gap = surface(place[..., 0], place[..., 1]) - w
        hit = np.isnan(found) & (gap <= 0)
        share = np.where(before < np.inf, before, 0) / np.where(before < np.inf, np.maximum(before - gap, 1e-9), 1)
        found[hit] = (steps[max(k - 1, 0)] + share * (w - steps[max(k - 1, 0)]))[hit]
        before = gap
    return np.where(np.isnan(found), steps[-1], found)


def _cells(
    shape: tuple[int, int], pitch: float, kind: str, rotation: float, offset: tuple[float, float]
) -> tuple[Array, NDArray[np.intp], NDArray[np.intp], Array]:
    """Return the centres, their types, the number of each pixel's centre, and the pixels from their centres."""
    turn = np.array([[math.cos(rotation), math.sin(rotation)], [-math.sin(rotation), math.cos(rotation)]])
    hexagonal = kind == "hexagonal"
    basis = np.array([[pitch, 0.0], [pitch / 2, pitch * math.sqrt(3) / 2] if hexagonal else [0.0, pitch]]) @ turn
    reach = int(1.6 * max(shape) / pitch) + 4
    q, r = (v.ravel() for v in np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)))
    places = (np.stack([q, r], axis=-1) @ basis)[:, ::-1] + (np.array(shape) - 1) / 2 + np.array(offset)
    near = ((places > -2 * pitch) & (places < np.array(shape) + 2 * pitch)).all(1)
    centres, types = places[near], np.mod(q - r, 3)[near]
    pixels = np.stack(np.mgrid[: shape[0], : shape[1]], axis=-1).astype(float)
    own = np.asarray(cKDTree(centres).query(pixels.reshape(-1, 2))[1], np.intp).reshape(shape)
    return centres, types, own, pixels - centres[own]
