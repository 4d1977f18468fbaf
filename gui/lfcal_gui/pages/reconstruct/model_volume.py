"""Content of the volume viewer: rotated volume, three slices or three projections, with one cross. No Qt."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import format_length
from lfcal.reconstruct import UNKNOWN
from lfcal_gui.models import DisplaySettings, Label, Levels, Outline, Overlay, Solid, Viewpoint, levels_of
from lfcal_gui.pages.reconstruct.model_regions import DrawnRegions

MODES = ("3-D", "Slices", "Projections")

MOST_ROWS = 2048
"""Largest number of rows of a side view; deeper volumes are drawn with fewer pixels."""

NEAR, FAR = "#9eabba", "#59636f"
"""Colours of the front and back edges of the volume."""

FRONT = 1e-6

LONGEST = 2.0
"""Largest length of the depth axis in the side views, relative to the longer lateral side."""

THINNEST = 0.25
"""Smallest space for an axis in the side views, relative to the longest axis."""

TILE = 96
"""Largest side of a thumbnail (pixels)."""


QUANTITIES = ("Value", "Uncertainty", "Known")
"""Quantities of a volume with error bars."""

HATCH, GAP = 6, 2
"""Period of the hatching of unknown details, and width of its lines (voxels)."""


def quantity_of(volume: NDArray[Any], maps: Mapping[str, NDArray[Any]], quantity: str) -> NDArray[Any]:
    """Return one of `QUANTITIES` of a ``volume`` ``(Z, Y, X)`` with the ``maps`` of its error bars.

    *Known* is the volume, hatched with not-a-number where nothing is known about details of a voxel's size.
    """
    if quantity == QUANTITIES[0] or not maps:
        return volume
    if quantity == QUANTITIES[1]:
        return maps["sigma"]
    y, x = np.indices(volume.shape[1:])
    hatched = (maps["kappa"] > UNKNOWN) & ((y + x) % HATCH < GAP)
    return np.where(hatched, np.nan, volume)


@dataclass(frozen=True)
class VolumeIntent:
    """Requested view of the volume.

    Attributes
    ----------
    z, y, x
        Position of the cross: plane, row and column.
    mode
        One of `MODES`.
    own_scale
        Whether each depth plane has its own colour scale; else all planes share one.
    by_depth
        Whether the colours of the rotated volume show depth.
    box, cross
        Whether edges and axes are drawn, and whether the cross is drawn.
    truth
        Whether the true volume is also shown, if known.
    display
        Scaling and colour map.
    regions
        Regions that the user drew.
    """

    z: int = 0
    y: int = 0
    x: int = 0
    mode: str = MODES[0]
    own_scale: bool = False
    by_depth: bool = True
    box: bool = True
    cross: bool = True
    truth: bool = True
    display: DisplaySettings = field(default_factory=DisplaySettings)
    regions: DrawnRegions = field(default_factory=DrawnRegions)

    def clamped(self, shape: tuple[int, ...]) -> VolumeIntent:
        """Return the intent with the cross inside a volume of ``shape``."""
        z, y, x = (min(max(v, 0), n - 1) for v, n in zip((self.z, self.y, self.x), shape, strict=True))
        return replace(self, z=z, y=y, x=x)


@dataclass(frozen=True, eq=False)
class Prepared:
    """A volume with data that are computed once.

    Attributes
    ----------
    volume
        Volume ``(Z, Y, X)``.
    solid
        Volume with its position in space.
    most
        Maximum along z, y and x: ``(Y, X)``, ``(Z, X)`` and ``(Z, Y)``.
    brightest
        Plane, row and column of its brightest voxel.
    levels
        Lowest value or zero, whichever is smaller, and highest value.
    depths
        Depth of each plane (µm); not-a-number if unknown.
    tiles
        Thumbnail of each plane.
    shares
        Fraction of all light in each plane.
    """

    volume: NDArray[Any]
    solid: Solid
    most: tuple[NDArray[Any], NDArray[Any], NDArray[Any]]
    brightest: tuple[int, int, int]
    levels: Levels
    depths: NDArray[np.float64]
    tiles: tuple[NDArray[Any], ...]
    shares: NDArray[np.float64]

    @cached_property
    def lengths(self) -> dict[str, float]:
        """Length of each axis in the side views (µm)."""
        lengths = [float(np.ptp(_edges(axis, min(self.solid.sides)))) for axis in self.solid.axes]
        return {**dict(zip("xyz", lengths, strict=True)), "z": lengths[2] * self.squeeze}

    @cached_property
    def squeeze(self) -> float:
        """Factor of the depth axis in the side views: 1, or less for volumes much deeper than wide."""
        x, y, z = (float(np.ptp(_edges(axis, min(self.solid.sides)))) for axis in self.solid.axes)
        wanted = LONGEST * max(x, y) / z
        decade = 10.0 ** math.floor(math.log10(wanted))
        return 1.0 if wanted >= 1 else max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= wanted)

    @cached_property
    def axes(self) -> dict[str, NDArray[np.float64]]:
        """Positions of the voxels along each axis in the side views (µm)."""
        x, y, z = self.solid.axes
        return {"x": x, "y": y, "z": z * self.squeeze}

    @cached_property
    def edges(self) -> dict[str, NDArray[np.float64]]:
        """Both edges of each voxel along each axis in the side views ``(n, 2)`` (µm)."""
        found = {}
        for axis, places in self.axes.items():
            order = np.argsort(places, kind="stable")
            ordered = places[order]
            start, end = _edges(ordered, min(self.solid.sides))
            bounds = np.concatenate([[start], (ordered[1:] + ordered[:-1]) / 2, [end]])
            found[axis] = np.empty((len(places), 2))
            found[axis][order] = np.stack([bounds[:-1], bounds[1:]], axis=1)
        return found

    def words_at(self, z: int, y: int, x: int) -> str:
        """Return position and value of a voxel as text."""
        depth = f" ({format_length(float(self.solid.given[z]))})" if self.solid.measured else ""
        return f"plane {z}{depth}, y {y}, x {x}: {self.volume[z, y, x]:.4g} counts"


def prepare(
    volume: NDArray[Any], depths_um: NDArray[np.float64] | None, voxel_um: tuple[float, float] | None
) -> Prepared:
    """Return the data needed to show a volume ``(Z, Y, X)`` from any side."""
    solid = Solid.of(volume, depths_um, voxel_um)
    known = np.isfinite(volume)
    whole = volume if known.all() else np.where(known, volume, -np.inf)
    z, y, x = (int(k) for k in np.unravel_index(int(np.argmax(whole)), volume.shape))
    low, high = levels_of(volume)
    most = whole.max(0), whole.max(1), whole.max(2)
    _ = solid.by_columns, solid.coarse.by_columns  # made here, in the background
    depths = solid.given if solid.measured else np.full(len(volume), np.nan)
    light = np.array([np.clip(np.nan_to_num(plane), 0, None).sum(dtype=float) for plane in volume])
    tiles = tuple(_small(plane) for plane in volume)
    return Prepared(
        volume, solid, most, (z, y, x), (min(low, 0.0), high), depths, tiles, light / max(light.sum(), 1e-300)
    )


def _small(plane: NDArray[Any]) -> NDArray[Any]:
    """Return a thumbnail of at most about `TILE` pixels per side, with the maximum of each block."""
    step = max(1, -(-max(plane.shape) // TILE))
    rows, columns = (max(1, n // step) * min(step, n) for n in plane.shape)
    blocks = plane[:rows, :columns].reshape(-1, min(step, plane.shape[0]), columns).max(1)
    small: NDArray[Any] = blocks.reshape(len(blocks), -1, min(step, plane.shape[1])).max(2)
    return small


class ViewCell(NamedTuple):
    """Place of one of the three views: the axes across and down, and its left, top, width and height (pixels)."""

    across: str
    down: str
    rect: tuple[int, int, int, int]


LAYOUTS = (
    ("x z", "y z", {"xy": "xy 0 0", "xz": "xz 0 1", "yz": "zy 1 0"}),
    ("x z", "y x", {"xy": "xy 0 *", "xz": "zx 1 1", "yz": "zy 1 0"}),
    ("x y", "y z", {"xy": "xy * 0", "xz": "xz 0 1", "yz": "yz 1 1"}),
    ("x x y", "yz", {"xy": "xy 0 *", "xz": "xz 1 *", "yz": "yz 2 *"}),
    ("xz", "y x y", {"xy": "xy * 0", "xz": "zx * 1", "yz": "zy * 2"}),
)
"""Columns and rows of each layout by the axes that must fit, and the axes, column and row of each view."""


def arrange(lengths: Mapping[str, float], room: tuple[int, int], gap: int) -> tuple[dict[str, ViewCell], float]:
    """Return the places of the three views of a volume in ``room`` (width, height), and the size of a pixel (µm).

    All views have one scale. Of the `LAYOUTS`, the one with the largest views is chosen.
    """
    least = THINNEST * max(lengths.values())
    axes = {axis: max(length, least) for axis, length in lengths.items()}
    best: tuple[dict[str, ViewCell], float] = {}, math.inf
    for across, down, views in LAYOUTS:
        parts = [[max(axes[axis] for axis in part) for part in line.split()] for line in (across, down)]
        lines = [_spread(part, size, gap) for part, size in zip(parts, room, strict=True)]
        cells = {key: _cell(words, lines) for key, words in views.items()}
        # the scale at which every view fits its place
        needed = [(lengths[one.across] / one.rect[2], lengths[one.down] / one.rect[3]) for one in cells.values()]
        pixel = max(max(both) for both in needed)
        if pixel < best[1]:
            best = cells, pixel
    return best


def _spread(parts: list[float], room: int, gap: int) -> list[tuple[int, int]]:
    """Return first and last pixel, exclusive, of parts that fill ``room`` pixels with gaps between them."""
    room = max(len(parts), room - gap * (len(parts) - 1))
    ends = np.rint(np.concatenate([[0.0], np.cumsum(parts)]) * (room / sum(parts))).astype(int).tolist()
    return [(start + k * gap, end + k * gap) for k, (start, end) in enumerate(pairwise(ends))]


def _cell(words: str, lines: list[list[tuple[int, int]]]) -> ViewCell:
    axes, *places = words.split()
    (left, right), (top, bottom) = (
        (line[0][0], line[-1][1]) if place == "*" else line[int(place)]
        for place, line in zip(places, lines, strict=True)
    )
    return ViewCell(axes[0], axes[1], (left, top, right - left, bottom - top))


class Side(NamedTuple):
    """An image at true scale: values, position of its first pixel (down, across), and side of a pixel."""

    values: NDArray[Any]
    origin: tuple[float, float]
    pixel: float


def side(intent: VolumeIntent, shown: Prepared, key: str, cell: ViewCell) -> Side:
    """Return the slice ``key`` through the cross, or the maxima along the third axis."""
    volume, places, (across, down, _) = shown.volume, shown.axes, cell
    left_out = "zyx".index(({*"xyz"} - {*key}).pop())
    if intent.mode == MODES[2]:
        image = shown.most[left_out]
    else:
        image = np.take(volume, (intent.z, intent.y, intent.x)[left_out], left_out)
    # the rows are the earlier of both axes in the volume
    image = image.T if "zyx".index(across) < "zyx".index(down) else image
    pixel = max(min(shown.solid.sides), float(np.ptp(places["z"])) / MOST_ROWS)
    return _even(image, places[down], places[across], pixel)


def _even(image: NDArray[Any], down: NDArray[np.float64], across: NDArray[np.float64], pixel: float) -> Side:
    """Return ``image``, whose rows and columns may be unevenly spaced, resampled to square pixels (nearest)."""
    rows, top = _nearest(down, pixel)
    columns, left = _nearest(across, pixel)
    return Side(image[np.ix_(rows, columns)], (top, left), pixel)


def _edges(places: NDArray[np.float64], pixel: float) -> tuple[float, float]:
    """Return where voxels begin and end: half a step beyond the outer ones; a single one is as long as a pixel."""
    ordered = np.sort(places)
    gaps = np.diff(ordered) if len(ordered) > 1 else np.array([pixel])
    return float(ordered[0] - gaps[0] / 2), float(ordered[-1] + gaps[-1] / 2)


def _nearest(places: NDArray[np.float64], pixel: float) -> tuple[NDArray[np.intp], float]:
    """Return the index of the nearest of ``places`` for each pixel, and the position of the first pixel."""
    order = np.argsort(places, kind="stable")
    ordered = places[order]
    start, end = _edges(ordered, pixel)
    count = max(1, round((end - start) / pixel))
    first = start + (end - start - (count - 1) * pixel) / 2
    at = first + pixel * np.arange(count)
    return order[np.searchsorted((ordered[1:] + ordered[:-1]) / 2, at + 1e-9 * pixel)], float(first)


def box_of(solid: Solid, turn: NDArray[np.float64]) -> tuple[Overlay, ...]:
    """Return the edges of the box around a volume; the back edges come first and are darker."""
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    seen = (signs * solid.half) @ turn.T
    farthest = int(np.argmax(seen[:, 2]))
    edges = []
    for a in range(8):
        for b in range(a + 1, 8):
            if np.abs(signs[a] - signs[b]).sum() == 2:
                behind = farthest in (a, b)
                line = Outline(seen[[a, b]][:, [1, 0]], FAR if behind else NEAR, behind, closed=False, width=1)
                edges.append((not behind, line))
    return tuple(line for _, line in sorted(edges, key=lambda edge: edge[0]))


def marks_at(solid: Solid, turn: NDArray[np.float64], place: NDArray[np.float64], colour: str) -> tuple[Overlay, ...]:
    """Return lines through a point along the axes of the volume, from end to end."""
    ends = []
    for axis in range(3):
        line = np.array([place, place])
        line[:, axis] = (-solid.half[axis], solid.half[axis])
        ends.append(Outline((line @ turn.T)[:, [1, 0]], colour, closed=False, width=1))
    return tuple(ends)


def axes_in(scene: Viewpoint, corner: tuple[float, float], length: float) -> tuple[Overlay, ...]:
    """Return the three named axes around a point of the image; an axis towards the viewer has zero length."""
    middle = np.array(corner)
    found: list[Overlay] = []
    for axis, name in enumerate("xyz"):
        end = middle + length * scene.turn[[1, 0], axis]
        found.append(Outline(np.array([middle, end]), NEAR, closed=False, rimmed=True))
        # a name beyond the end of a short axis stays readable
        found.append(Label((middle + 1.35 * length * _away(scene.turn[[1, 0], axis]))[None], name))
    return tuple(found)


def _away(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    long = float(np.hypot(*direction))
    return direction if long > 0.3 else direction * (0.3 / long) if long > FRONT else np.array([0.3, 0.3])
