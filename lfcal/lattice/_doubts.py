"""Checks whether a frame with a lattice is a white image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.lattice._model import class_light, neighbour_median
from lfcal.lattice._smooth_field import fit_field

__all__ = ["Evenness", "check_white", "evenness"]

Array = NDArray[np.float64]

SHARED_LIMIT = 0.10
"""Limit of the light variation that neighbouring lenslets share (rms, relative) for a white image. Measured: a real
white image 0.000; simulated ones with 15 % scatter, three lens types, a gradient of 70 % or a fall-off of 80 % up to
0.03; a real light field 0.2; simulated specimens 0.13 to 0.4."""

SHARED_NOTE = 0.04
SCATTER_NOTE = 0.18
"""Scatter of single lenslets that is reported; arrays scatter by a few percent."""

JITTER_NOTE = 0.02
"""Residual (pitches) that is reported if noise does not explain it."""

JITTER_NOISE = 1.0
"""Ratio of residual (pixels) to noise (per contrast) that noise cannot explain: 0.13 to 0.21 with noise alone, above 2
for cells of a tissue."""

REACH = 3
"""Number of lenslets on each side that form the surroundings."""

LIT = 0.25
"""Smallest light of a lenslet to be evaluated, relative to the brightest tenth."""


@dataclass(frozen=True, slots=True)
class Evenness:
    """Uniformity of the light of lenslets, relative to their surroundings.

    Attributes
    ----------
    shared
        Root of the mean product of neighbours' deviations, caused by objects larger than a lenslet.
    scatter
        Rms deviation of single lenslets.
    """

    shared: float
    scatter: float


def evenness(index: NDArray[np.intp], light: Array, alive: NDArray[np.bool_], places: Array) -> Evenness:
    """Return the uniformity of the ``light`` ``(n,)`` of lenslets.

    The shared variation excludes differences between classes of lenslets (`class_light`), such as dimmer alternate
    rows.

    Parameters
    ----------
    index
        ``(n, 2)``: lattice indices (q, r).
    light
        ``(n,)``: mean sample values.
    alive
        ``(n,)``: lenslets to evaluate.
    places
        ``(n, 2)``: centres (row, column) of the lenslets (pixels).
    """
    even = np.where(alive, light / _smooth(light, alive, places), np.nan)
    bright = alive & (light > LIT * np.percentile(light[alive], 90))
    own, away = (_away(index, values, bright) for values in (even / class_light(index, even), even))
    shared = min(_shared(index, own), _shared(index, away))
    away = away[np.isfinite(away)]
    return Evenness(shared, math.sqrt(float(np.mean(away**2))) if away.size else 0.0)


def _shared(index: NDArray[np.intp], away: Array) -> float:
    """Return the root of the mean product of the deviations ``(n,)`` of neighbours."""
    place = index - index.min(0)
    grid = np.full(place.max(0) + 1, np.nan)
    grid[place[:, 0], place[:, 1]] = away
    products = np.concatenate([(grid[1:] * grid[:-1]).ravel(), (grid[:, 1:] * grid[:, :-1]).ravel()])
    products = products[np.isfinite(products)]
    return math.sqrt(max(float(products.mean()), 0.0)) if products.size else 0.0


def _away(index: NDArray[np.intp], even: Array, bright: NDArray[np.bool_]) -> Array:
    """Return the relative deviation ``(n,)`` of ``bright`` lenslets from their surroundings; NaN for others."""
    around = neighbour_median(index, even, REACH)
    lit = bright & (around > 0)
    # a speck of dirt or a bright bead does not make the field uneven: limit its weight
    result: Array = np.where(lit, np.clip(even / np.where(lit, around, 1) - 1, -1, 1), np.nan)
    return result


def _smooth(light: Array, alive: NDArray[np.bool_], places: Array) -> Array:
    """Return the light fall-off at every lenslet; its mean if there are too few lenslets for a surface."""
    shape = (int(places[:, 0].max()) + 1, int(places[:, 1].max()) + 1)
    if alive.sum() < 150:
        return np.full(len(light), float(np.median(light[alive])))
    surface = fit_field(places[alive], light[alive], shape).at(places[:, 0], places[:, 1])
    return np.maximum(surface, 0.05 * float(np.percentile(light[alive], 90)))


def check_white(even: Evenness, residual_px: float, noise: float, pitch: float) -> tuple[str, ...]:
    """Raise an error for frames that cannot be white images; return other doubts, one line each.

    Parameters
    ----------
    even
        Uniformity of the light, as returned by `evenness`.
    residual_px
        Residual of the lattice (px rms).
    noise
        Rms residual of the mean micro-image, divided by its contrast.
    pitch
        Pitch (pixels).

    Raises
    ------
    InputError
        If the light shows objects: a specimen or another scene.
    """
    if even.shared > SHARED_LIMIT:
        raise InputError.expected(
            "white image",
            f"groups of lenslets equally bright to {100 * SHARED_LIMIT:.0f} %",
            f"{100 * even.shared:.0f} %, as in the image of a specimen or another scene",
            "take an evenly lit image without a specimen",
        )
    notes = []
    if even.shared > SHARED_NOTE:
        notes.append(f"uneven light: groups of lenslets differ by {100 * even.shared:.0f} %; check the light path")
    if even.scatter > SCATTER_NOTE:
        notes.append(
            f"light differs from lenslet to lenslet by {100 * even.scatter:.0f} %; check that this is a white image"
        )
    if residual_px > JITTER_NOTE * pitch and residual_px > JITTER_NOISE * noise:
        notes.append(
            f"micro-images deviate by {residual_px:.2g} px from any smooth lattice, more than noise explains; "
            "is this a white image of lenslets?"
        )
    return tuple(notes)
