"""The light of lenslets outside their windows.

A window a few pixels wider than the spot misses one or two percent of a lenslet's light. This light decreases only as
1/r^3 and would need wide windows. The missing amount is known: the light that the lenslet transmits minus the light
in its window. Its distribution is that of a uniformly lit lenslet of the same type, computed once on a wide window.
Tails come from the edge of the aperture and hardly depend on how it is lit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.simulate.engines._kernels import (
    LightTarget,
    MainLensField,
    Optics,
    Split,
    fill_disc,
    mask_from_table,
    respond,
)
from lfcal.simulate.engines._lenslets import SPOT
from lfcal.simulate.engines._nodes import fitted_rule
from lfcal.simulate.engines._polygon import area
from lfcal.simulate.engines._tail_kernels import add_tails
from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.engines.masks import RING
from lfcal.simulate.engines.tables import (
    LensTable,
    aperture_outline,
    aperture_radius,
    aperture_tables,
    tail_px,
    zoom_of,
)
from lfcal.simulate.scene import Scene

__all__ = ["Tail", "tail_of"]

F4 = NDArray[np.float32]

FINE = 2
"""Samples of a cell's table for each sample of the aperture, so that the lenslet lies on them."""

NODES = 2.2
"""Nodes per pixel of the wide window; 2 are sufficient for the band of the intensity."""


@dataclass(frozen=True, slots=True)
class Tail:
    """Distribution of the light of one lens type outside its windows.

    Attributes
    ----------
    pattern
        ``(m, m)`` pixels about the spot, 0 inside its window: fractions of the light outside the window.
    edge
        Ratio of the light that a lenslet transmits to that in its samples, which soften its edge slightly.
    share
        Fraction of a uniformly lit lenslet's light that pixels receive outside its window.
    by_window
        Whether the light in a window determines the missing light. This fails for pixels with gaps between them, which
        receive an unrepresentative fraction of a small spot.
    """

    pattern: F4
    edge: float
    share: float
    by_window: bool

    def add(self, spots: NDArray[Any], width: int, image: NDArray[Any]) -> float:
        """Add the light outside windows of ``width`` to the cutouts (positions, rows, columns); return its sum."""
        passed = self.edge * spots["energy_in"]
        lacking = np.maximum(passed - spots["energy_out"], 0.0) if self.by_window else self.share * passed
        return self._spread(spots, lacking, width, image)

    def add_far(self, spots: NDArray[Any], gain: float, width: int, image: NDArray[Any]) -> float:
        """Add the tails of lenslets whose windows miss the cutout; ``energy_in`` comes from uniform light."""
        return self._spread(spots, gain * self.share * spots["energy_in"], width, image)

    def _spread(self, spots: NDArray[Any], lacking: NDArray[np.float64], width: int, image: NDArray[Any]) -> float:
        add_tails(spots, lacking, self.pattern, (self.pattern.shape[0] - width) // 2, image)
        return float(lacking.sum()) * float(self.pattern.sum(dtype=np.float64))


def tail_of(scene: Scene, sampling: Sampling, lens: LensTable, kind: int) -> Tail:
    """Return the tail of a lens type behind windows of ``lens``, for uniform light from a distant source."""
    px, spread = scene.reduced_pixel_um, scene.wavelength_um * scene.reduced_gap_um
    beyond = tail_px(sampling)
    width = lens.width + 2 * beyond
    radius = aperture_radius(scene)
    band = 2 * radius * px / spread
    dx = px / max(1.0, math.ceil(2 * width * px * px / spread) / 2)
    half = math.ceil(radius / dx) + RING
    level, dtype = dx * dx * px / spread, lens.field.re.dtype
    aperture = aperture_tables(
        scene, dx, (half + 1) * dx * math.sqrt(2), lens.aperture.bend, level, dtype.type, kind=kind, fine=FINE
    )
    rule = fitted_rule(max(2, math.ceil(NODES * band)), band)
    zoom = zoom_of(rule, width, px, 2 * math.pi / spread * dx * np.arange(half + 1), dtype.type)
    n = 2 * half + 1
    even = MainLensField(np.ones((n, n), dtype), np.zeros((n, n), dtype), dx)
    image, grid = np.zeros((1, width, width), dtype), np.zeros((0, 0, 0), dtype)
    spots = np.zeros(1, SPOT)
    spots["row"] = spots["col"] = n // 2
    share = (spread / (dx * px)) ** 2
    flat = Optics(1 / spread, share, 1.0, 0.0, 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), np.ones(5))
    respond(even, aperture, zoom, flat, spots, LightTarget(image, grid, grid, np.zeros((0, 4), np.int64)))
    pattern = image[0].astype(np.float64)
    window = slice(beyond, beyond + lens.width)
    exact = _area(scene)
    # rounding and the rule of the nodes leave about 1e-4: limit it to the light that exists
    outside = max(exact - float(pattern[window, window].sum()), 1e-6 * exact)
    pattern[window, window] = 0
    pattern /= max(outside, float(pattern.sum()))
    share = scene.pixel_fill**2 * outside / exact
    return Tail(pattern.astype(dtype), exact / _sampled_area(lens, spread / px), share, scene.pixel_fill == 1)


def _area(scene: Scene) -> float:
    if scene.round_lenslets:
        return math.pi * scene.clear_radius_um**2
    return abs(area(aperture_outline(scene)))


def _sampled_area(lens: LensTable, spread_per_px: float) -> float:
    """Return the area that an aperture has by its samples (µm²)."""
    n, dx = 2 * lens.half + 1, lens.field.dx_um
    mask = Split(*np.zeros((2, n, n), lens.field.re.dtype))
    (mask_from_table if lens.aperture.cell.size else fill_disc)(lens.aperture, dx, 0.0, 0.0, mask)
    total = float(np.square(mask.re, dtype=np.float64).sum() + np.square(mask.im, dtype=np.float64).sum())
    return (spread_per_px / dx) ** 2 * total
