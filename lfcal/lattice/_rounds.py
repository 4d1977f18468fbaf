"""Single steps of the lattice fit: prepare, centre, flatten, locate."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, as_sensor_frame, format_pixels
from lfcal.lattice._kernels import Support
from lfcal.lattice._micro_image import LensletPlaces, MicroImage, light_of, mean_micro_image, place_lenslets
from lfcal.lattice._model import MIN_PITCH, LatticeModel, class_median, neighbour_mean, neighbour_median
from lfcal.lattice._smooth_field import fit_field
from lfcal.lattice._spectrum import MIN_LENSLETS

__all__ = [
    "FEW",
    "MIN_COUNT",
    "PlacedLenslets",
    "Region",
    "centred",
    "evened",
    "levelled",
    "mean_light",
    "place_all",
    "prepare",
]

Array = NDArray[np.float64]

PLACING_RADIUS = 0.56
"""Radius for locating a lenslet, in pitches: it includes the gaps, but not the neighbours."""

LONE_RADIUS = 0.5
"""Radius for locating one of a few lenslets, most of which lack neighbours on one side, in pitches."""

FEW = 45
"""Number of lenslets below which most are at the edge of the array."""

MIN_COUNT = 7
"""Smallest number of lit lenslets, and of whole ones in the frame."""

CENTRING_ROUNDS = 4
DEAD_LIGHT = 0.5
"""A lenslet with less than this fraction of its neighbours' light, or contrast, is dead."""

DARK_FIELD = 0.05
"""Lenslets with less than this fraction of the brightest tenth are outside the lit field."""

EVENED_FROM = 0.1
"""Light relative to the brightest tenth above which the fall-off of light is corrected."""

MAX_SHIFT = 0.35
"""Largest accepted distance from the lattice point, in pitches."""

MIN_EXPLAINED = 0.08
"""Smallest fraction of a typical lenslet's variance that the mean micro-image must explain."""

MIN_SHARE_EXPLAINED = 0.2
"""Smallest explained fraction of a single lenslet, relative to the typical one; with less it cannot be located."""

NEW_DEAD = 0.1
"""Fraction of newly found dead lenslets above which the mean micro-image is computed again without them."""

EVEN, STEEP = 0.01, 0.1
"""Relative changes of light between lenslets above which positions are corrected, and above which they are not used."""

RIM = 0.3
"""Deviation of a lenslet's light from its neighbourhood above which a part of it may be shaded."""

LIT_AROUND = 0.45
"""Mean contrast around a place, relative to bright lenslets, above which it is in the lit field: 0.4 next to it."""

PARTLY_LIT = 0.6
"""Fraction of working lenslets below which light covers a part of the frame only."""

NARROW = 0.4
"""Fraction of working lenslets below which no distortion is fitted."""

LONE = 0.3
"""Fraction of working lenslets around a place of a partly lit field below which it is not lit."""

INNER = 0.85
"""Fraction of working lenslets among a lenslet and its neighbours above which it is not at the edge of the light."""

MAX_DEAD = 0.4


@dataclass(frozen=True, eq=False, slots=True)
class Region:
    """A disc of the frame: its middle as (x, y), and its radius (pixels)."""

    middle: Array
    reach: float


@dataclass(frozen=True, eq=False, slots=True)
class PlacedLenslets:
    """The lenslets located in one iteration of the fit.

    Attributes
    ----------
    index, places
        ``(n, 2)``: lattice indices (q, r), and measured positions (x, y) (pixels).
    dead
        ``(n,)``: too little light or contrast, or cannot be located.
    noise
        Rms residual of the mean micro-image in the median lenslet, divided by its contrast.
    steep
        ``(n,)``: light varies so much, across or to the neighbours, that the position is wrong.
    """

    index: NDArray[np.intp]
    places: Array
    dead: NDArray[np.bool_]
    noise: float
    steep: NDArray[np.bool_]

    @property
    def narrow(self) -> bool:
        """Whether light covers so small a part of the frame that a distortion cannot be extrapolated from it."""
        return bool((~self.dead).mean() < NARROW and (~self.dead).sum() >= FEW)

    @property
    def sound(self) -> NDArray[np.intp]:
        """Lenslets used for the lattice: not dead, and not at the edge of the lit field, where the light falls off."""
        alive = ~self.dead
        if alive.mean() < PARTLY_LIT:
            # the stop of a partly lit field may shade a part of the outermost ones
            inner = alive & (neighbour_mean(self.index, alive.astype(float), 1) > INNER)
            alive = inner if inner.sum() >= MIN_LENSLETS**2 else alive
        sound = alive & ~self.steep
        # if light falls steeply almost everywhere, no edge can be identified
        return np.flatnonzero(sound if 2 * sound.sum() > alive.sum() else alive)


def prepare(white: ArrayLike, dark: ArrayLike | float) -> NDArray[np.float32]:
    """Return the white image minus its dark level as float32, or raise an error if it cannot be used."""
    image = as_sensor_frame("white image", white)
    level = np.asarray(dark, np.float32)
    if level.ndim:
        level = as_sensor_frame("dark frame for the white image", level)
        if level.shape != image.shape:
            raise InputError.expected(
                "dark frame for the white image",
                format_pixels(image.shape),
                format_pixels(level.shape),
                "record both with the same sensor settings",
            )
    if min(image.shape) < MIN_LENSLETS * MIN_PITCH:
        raise InputError.expected(
            "white image",
            f"at least {MIN_LENSLETS * MIN_PITCH:g} px per side",
            format_pixels(image.shape),
            "use the whole frame",
        )
    return levelled(image - level)


def mean_light(image: NDArray[np.float32], model: LatticeModel, index: NDArray[np.intp], workers: int | None) -> Array:
    """Return the mean sample value within half a pitch of each lenslet."""
    count, total, _ = light_of(image, model.places(index), 0.5 * min(model.pitch, model.row_pitch), workers).T
    mean: Array = total / np.maximum(count, 1)
    return mean


def _top(values: Array) -> float:
    """Return the typical value of bright lenslets, even if few are lit: the 90th percentile of the lit ones."""
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0
    # a few specks of dirt or hot pixels are brighter than any lenslet
    highest = float(np.sort(values)[-1 - min(len(values) - 1, max(3, len(values) // 100))])
    return float(np.percentile(values[values >= min(highest, 0.3 * highest)], 90))


def _dim(values: Array, around: Array) -> NDArray[np.bool_]:
    """Return which lenslets have far less light than the median ``around`` them or bright ones."""
    result: NDArray[np.bool_] = (values < DEAD_LIGHT * around) | (values < DARK_FIELD * _top(values))
    return result


def _fall_of_light(index: NDArray[np.intp], around: Array) -> Array:
    """Return the relative growth of the light ``around`` per q and per r ``(n, 2)``."""
    place = index - index.min(0) + 2
    grid = np.full(place.max(0) + 3, np.nan)
    grid[place[:, 0], place[:, 1]] = around
    fall = np.zeros((len(index), 2))
    # two lenslets in each direction, because medians of nearer ones share lenslets
    for axis, (i, j) in enumerate(((2, 0), (0, 2))):
        before, after = grid[place[:, 0] - i, place[:, 1] - j], grid[place[:, 0] + i, place[:, 1] + j]
        known = 1.0 * np.isfinite(before) + np.isfinite(after)
        change = np.where(np.isfinite(after), after, around) - np.where(np.isfinite(before), before, around)
        fall[:, axis] = change / np.maximum(2 * known, 1) / np.maximum(around, 1e-300)
    return fall


def _lenslets_of(image: NDArray[np.float32], model: LatticeModel, near: Region | None = None) -> NDArray[np.intp]:
    """Return the lenslets completely in the frame, or those in a region."""
    index = model.whole((image.shape[0], image.shape[1]))
    if len(index) < MIN_COUNT:
        raise InputError.expected(
            "white image", f"at least {MIN_COUNT} complete lenslets", len(index), "use a larger part of the frame"
        )
    if near is None:
        return index
    away = model.places(index) - near.middle
    inside: NDArray[np.intp] = index[np.hypot(*away.T) <= near.reach]
    return inside if len(inside) >= MIN_LENSLETS**2 else index


def _support(model: LatticeModel, share: float) -> Support:
    """Return the ellipse about a lenslet with half axes of ``share`` pitches: a circle for round cells."""
    across = model.row_pitch * (2 / math.sqrt(3) if model.kind == "hexagonal" else 1.0)
    return Support.along(model.along, share * model.pitch, share * across)


def centred(image: NDArray[np.float32], model: LatticeModel, workers: int | None, near: Region) -> LatticeModel:
    """Shift the lattice to the point of best symmetry of the mean micro-image, so that linear fits start close.

    Only lenslets in ``near`` are used.
    """
    support = _support(model, PLACING_RADIUS)
    for _ in range(CENTRING_ROUNDS):
        index = _lenslets_of(image, model, near)
        light = mean_light(image, model, index, workers)
        # dead lenslets would blur the mean towards a flat patch
        scales = np.where(_dim(light, class_median(index, light)), 0, light)
        micro = mean_micro_image(image, model.places(index), scales, support.radius + 1.5, workers)
        shift = micro.off_centre(support)
        limit = min(model.pitch, model.row_pitch) / 4
        model = model.moved(np.clip(shift, -limit, limit))
        if np.hypot(*shift) < 0.02:
            break
    return model


def _surface(points: Array, light: Array, shape: tuple[int, int], degree: int) -> NDArray[np.float32]:
    """Return the smooth ``light`` on every pixel, normalised to 1: a polynomial, or the exponential of one.

    A polynomial follows the edge of a shadow better, the exponential a strong fall-off such as that of a beam.
    """
    known = np.maximum(light, DARK_FIELD)
    plain, steep = fit_field(points, light, shape, degree), fit_field(points, np.log(known), shape, degree)
    found = plain.at(*points.T), np.exp(np.minimum(steep.at(*points.T), 1.0))
    miss = [np.minimum(np.abs(values / known - 1), RIM).mean() for values in found]
    if miss[0] <= miss[1]:
        return plain.frame()
    return np.exp(np.minimum(steep.frame(), 1.0))


def evened(
    image: NDArray[np.float32], model: LatticeModel, lenslets: PlacedLenslets, workers: int | None
) -> NDArray[np.float32]:
    """Divide by the smooth fall-off of light, which would shift the positions to the brighter side."""
    index = lenslets.index[~lenslets.dead]
    light = mean_light(image, model, index, workers)
    points = model.places(index)[:, ::-1]
    # a quartic through few lenslets would follow each one
    degree = 4 if len(index) > 150 else 1
    top = float(np.percentile(light, 90))
    surface = _surface(points, light / top, (image.shape[0], image.shape[1]), degree) * top
    # outside the lit field the surface is arbitrary: leave the image dark there
    return (image / np.where(surface < EVENED_FROM * top, top, surface)).astype(np.float32)


def place_all(
    image: NDArray[np.float32], model: LatticeModel, workers: int | None, near: Region | None = None
) -> PlacedLenslets:
    """Locate every lenslet, or those in a region, with the mean micro-image of working ones."""
    index = _lenslets_of(image, model, near)
    light = mean_light(image, model, index, workers)
    around = class_median(index, light)
    dead = _dim(light, around)
    support = _support(model, LONE_RADIUS if len(dead) - dead.sum() < FEW else PLACING_RADIUS)
    centres = model.places(index)
    for _ in range(2):
        before = dead
        micro, placed = _located(image, centres, np.where(dead, 0, light), support, workers)
        dead = before | _lost(index, placed, model)
        # lenslets without light pass for dim ones if a pedestal remains, and blur the mean micro-image
        if dead.sum() - before.sum() < NEW_DEAD * len(dead):
            break
    explained = float(np.median(placed.explained[~dead])) if not dead.all() else 0.0
    # outside the lit field there is only noise, where positions are meaningless
    dead |= placed.explained < MIN_SHARE_EXPLAINED * explained
    dead |= _astray(index, ~dead)
    _check_found(index, placed, dead, explained)
    noise = math.sqrt(max(1 - explained, 0.0) / explained)
    if len(dead) - dead.sum() < FEW:
        # positions without a lenslet are no fall-off of light
        around = neighbour_median(index, np.where(dead, np.nan, light))
    fall = _fall_of_light(index, around) @ np.linalg.inv(model.basis()).T
    slope = np.hypot(*fall.T) * model.pitch
    steep = slope > STEEP
    steep |= np.abs(light - around) > RIM * around
    draw = np.where((~steep & (slope > EVEN))[:, None], micro.draw(support) * fall, 0.0)
    places = centres + placed.shifts - draw
    return PlacedLenslets(index, places, dead, noise, steep)


def _located(
    image: NDArray[np.float32], centres: Array, scales: Array, support: Support, workers: int | None
) -> tuple[MicroImage, LensletPlaces]:
    """Return the mean micro-image about ``centres``, and every lenslet located with it."""
    micro = mean_micro_image(image, centres, scales, support.radius + 1.5, workers).symmetric()
    return micro, place_lenslets(image, centres, micro, support, workers)


def _lost(index: NDArray[np.intp], placed: LensletPlaces, model: LatticeModel) -> NDArray[np.bool_]:
    """Return which lenslets are too far from their lattice point, or have too little contrast."""
    distance = np.nan_to_num(np.hypot(*placed.shifts.T), nan=np.inf)
    lost = ~np.isfinite(placed.gains) | (distance > MAX_SHIFT * min(model.pitch, model.row_pitch))
    # dirt may transmit light but reduce contrast
    gains = np.where(np.isfinite(placed.gains), placed.gains, 0.0)
    return np.asarray(lost | _dim(gains, class_median(index, gains)))


def _astray(index: NDArray[np.intp], alive: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return lenslets of a partly lit field without working neighbours: noise that resembles a micro-image."""
    if alive.mean() >= PARTLY_LIT or alive.sum() < FEW:
        return np.zeros(len(alive), bool)
    return np.asarray(neighbour_mean(index, alive.astype(float), 1) < LONE)


def _check_found(index: NDArray[np.intp], placed: LensletPlaces, dead: NDArray[np.bool_], explained: float) -> None:
    """Raise `InputError` if too few lenslets are lit, too many of these are dead, or they differ too much."""
    gains = np.where(np.isfinite(placed.gains), placed.gains, 0.0)
    reach = 1 if len(dead) - dead.sum() < FEW else 2
    lit = neighbour_mean(index, np.clip(gains / _top(gains), 0, 1), reach) >= LIT_AROUND
    gone = float(dead[lit].mean()) if lit.any() else 1.0
    if (~dead).sum() >= MIN_COUNT and gone <= MAX_DEAD and explained >= MIN_EXPLAINED:
        return
    raise InputError.expected(
        "white image",
        f"micro-images of at least {MIN_COUNT} lenslets and of at least {100 * (1 - MAX_DEAD):.0f} % of the lit ones, "
        f"and a mean micro-image that explains at least {100 * MIN_EXPLAINED:.0f} % of their variance",
        f"{(~dead).sum()} lenslets, {100 * (1 - gone):.0f} % of the lit ones, {100 * explained:.0f} % of the variance",
        "record an evenly lit image of the lenslets",
    )


MOSAIC_BLOCKS = 4
"""Number of blocks along each side of the frame that must show the same colour filter mosaic."""

MOSAIC_CONTRAST = 0.04
"""Relative brightness difference of the four pixels above which they have colour filters."""

MOSAIC_SCATTER = 0.3
"""Largest scatter of the difference from block to block, as a fraction of itself."""


def levelled(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the image without the gains of a 2 x 2 mosaic, if there is one: it would beat with the pitch.

    The four subgrids of evenly lit lenslets are equally bright, unless they have different colour filters.
    """
    rows, columns = (n // (2 * MOSAIC_BLOCKS) * 2 for n in image.shape)
    whole = image[: rows * MOSAIC_BLOCKS, : columns * MOSAIC_BLOCKS]
    cells = whole.reshape(MOSAIC_BLOCKS, rows // 2, 2, MOSAIC_BLOCKS, columns // 2, 2)
    means = np.nan_to_num(cells.mean((1, 4), dtype=np.float64)).transpose(0, 2, 1, 3).reshape(-1, 2, 2)
    light = means.mean((1, 2))
    if not light.sum() > 0:
        return image
    gains = means.sum(0) / light.sum()
    unlike = float(np.abs(gains - 1).max())
    scatter = np.abs(means - gains * light[:, None, None]).max((1, 2))
    # filters are the same everywhere; a beat between lattice and pixels is not
    if (
        unlike < MOSAIC_CONTRAST
        or gains.min() <= 0
        or float(scatter.mean()) > MOSAIC_SCATTER * unlike * float(light.mean())
    ):
        return image
    even_light = image.copy()
    for row, column in np.ndindex(2, 2):
        even_light[row::2, column::2] /= np.float32(gains[row, column])
    return even_light
