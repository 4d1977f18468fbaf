"""Frames of a Fourier light-field microscope, drawn ray by ray; `draw` shares no code with lfcal.

The point q of the pupil plane (µm from the axis) receives rays with the sine |q| M/(n f) in the object, by the sine
condition. The Fourier lens turns the point X0 at which a ray crosses the focal plane of the objective into its
direction, M X0/f. A lenslet at c of focal length F bends it by -(q - c)/F, and the sensor is at the distance B:

    p = q + B (M X0/f - (q - c)/F),        X0 = X - z q/|q| tan θ,        n sin θ = |q| M/f.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, PupilLenslets, Sensor, preset
from tests.lattice.plenoptic_scenes import texture

Array = NDArray[np.float64]
Surface = Callable[[Array, Array], Array]
"""Function of the position (down, right) in the object (µm)."""


@dataclass(frozen=True)
class Instrument:
    """Microscope: lengths in µm, centres of the lenslets (down, right), and the pixel (row, column) of the axis.

    ``fourier`` is the focal length of the Fourier lens, ``focal`` that of the lenslets.
    """

    magnification: float
    index: float
    fourier: float
    centres: Sequence[tuple[float, float]]
    focal: float
    clear: float
    gap: float
    pixel: float
    axis: tuple[float, float]


def draw(
    at: Instrument,
    shape: tuple[int, int],
    surface: Surface,
    shade: Surface,
    *,
    field: float,
    rays: int = 5,
    level: float = 2000.0,
    noise: float = 0.0,
    reach: float = 100.0,
    vignetting: bool = False,
    seed: int = 0,
) -> Array:
    """Draw a frame ``(rows, columns)``; an aperture of radius ``field`` (µm) in the native image limits the field.

    The surface is between the depths ±``reach`` (µm), ``rays`` is their number across a lenslet, and ``noise`` the
    standard deviation at full ``level`` (of the level; shot noise). ``vignetting`` darkens lenslets off the axis.
    """
    frame = np.zeros(shape)
    grid = (np.arange(rays) + 0.5) / rays * 2 - 1
    some = [(y, x) for y in grid for x in grid if y * y + x * x <= 1]
    # the edge of the field is imaged in focus, except for lenslets with another focal length
    half = int(field * at.magnification / at.fourier * at.gap / at.pixel + abs(1 - at.gap / at.focal) * at.clear) + 3
    for centre in at.centres:
        c = np.array(centre)
        gain = 1 / (1 + 0.3 * (np.hypot(*c) / 2500.0) ** 2) if vignetting else 1.0
        low = np.maximum(np.rint(np.array(at.axis) + c / at.pixel).astype(int) - half, 0)
        part = tuple(slice(a, max(a, min(a + 2 * half + 1, n))) for a, n in zip(low, shape, strict=True))
        pixels = np.stack(np.mgrid[part], axis=-1) - np.array(at.axis)
        for ray in some:
            q = c + np.array(ray) * at.clear / 2
            start = ((pixels * at.pixel - q) / at.gap + (q - c) / at.focal) * at.fourier / at.magnification
            sine = q * at.magnification / (at.index * at.fourier)
            slant = sine / np.sqrt(1 - sine @ sine)
            inside = np.hypot(*np.moveaxis(start, -1, 0)) <= field
            z = _crossing(surface, start, slant, reach)
            place = start + z[..., None] * slant
            frame[part] += gain / len(some) * np.where(inside, shade(place[..., 0], place[..., 1]), 0)
    frame *= level
    rng = np.random.default_rng(seed + 1)
    return frame + noise * np.sqrt(frame * level) * rng.normal(size=shape)


def _crossing(surface: Surface, start: Array, slant: Array, reach: float) -> Array:
    """Return the smallest depth, from the camera on, at which a ray meets the surface."""
    found, before = np.full(start.shape[:2], np.nan), np.full(start.shape[:2], np.nan)
    steps = np.linspace(-reach, reach, 25)
    for last, z in zip([steps[0], *steps], steps, strict=False):
        place = start + z * slant
        left = surface(place[..., 0], place[..., 1]) - z
        hit = np.isnan(found) & (left <= 0)
        share = np.where(np.isfinite(before), before / np.maximum(before - left, 1e-12), 0.0)
        found[hit] = (last + share * (z - last))[hit]
        before = left
    return np.where(np.isnan(found), reach, found)


SIDE = 400
PIXEL = 19.5
STEP_UM = PIXEL / 8.0
"""Object length that is imaged onto a pixel: 20x, and a relay of 0.4."""

FIELD_UM = 150.0
AXIS_UM = (-50.0, 30.0)
RING = tuple((2500 * math.sin(k * math.pi / 3 + 0.1), 2500 * math.cos(k * math.pi / 3 + 0.1)) for k in range(6))
CENTRES = ((0.0, 0.0), *RING)

SURFACES: dict[str, Surface] = {
    "plane": lambda y, x: 12.0 + 0 * y,
    "far plane": lambda y, x: 36.0 + 0 * y,
    "slant": lambda y, x: 0.1 * y - 0.05 * x,
    "step": lambda y, x: np.where(x < 0, -20.0, 15.0),
    "ball": lambda y, x: 20 - 35 * np.sqrt(np.clip(1 - (y**2 + x**2) / 110**2, 0, None)),
}


def instrument(centres: Any = CENTRES, **more: Any) -> Instrument:
    axis = tuple((SIDE - 1) / 2 + v / PIXEL for v in AXIS_UM)
    known = {"focal": 60e3, "clear": 2500.0, "gap": 60e3, "pixel": PIXEL, "axis": axis}
    return Instrument(**{"magnification": 20.0, "index": 1.0, "fourier": 150e3, "centres": centres, **known, **more})


def camera_of(at: Instrument) -> Camera:
    centres = tuple((x, y) for y, x in at.centres)
    lenslets = PupilLenslets(centres, at.fourier, at.gap, (at.focal,), at.clear, offset_um=AXIS_UM[::-1])
    return replace(preset("flfm_20x05"), lattice=lenslets, sensor=Sensor((SIDE, SIDE), at.pixel))


def scene(at: Instrument, surface: Surface, **how: Any) -> NDArray[np.float64]:
    shade = texture()
    how = {"noise": 0.01, "vignetting": True, "reach": 40.0, **how}
    return draw(at, (SIDE, SIDE), surface, lambda y, x: shade(y / STEP_UM, x / STEP_UM), field=FIELD_UM, **how)


def white_of(at: Instrument) -> NDArray[np.float64]:
    def uniform(y: Any, x: Any) -> Any:
        return 1 + 0 * y

    return draw(at, (SIDE, SIDE), lambda y, x: 0 * y, uniform, field=FIELD_UM, vignetting=True, reach=1.0)
