"""Content of the volume viewer: rotated volume, three slices or three projections, with one cross. No Qt."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import format_length
from lfcal_gui.models import DisplaySettings, Label, Levels, Outline, Overlay, Solid, Viewpoint, levels_of

MODES = ("3-D", "Slices", "Projections")

MOST_ROWS = 2048
"""Largest number of rows of a side view; deeper volumes are drawn with fewer pixels."""

NEAR, FAR = "#9eabba", "#59636f"
"""Colours of the front and back edges of the volume."""

FRONT = 1e-6

TILE = 96
"""Largest side of a thumbnail (pixels)."""


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
        Maximum along z, y and x.
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
    most = whole.max(0), whole.max(1), whole.max(2).T
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


class Side(NamedTuple):
    """An image at true scale: values, position of its first pixel (down, across), and side of a pixel."""

    values: NDArray[Any]
    origin: tuple[float, float]
    pixel: float


def sides(intent: VolumeIntent, shown: Prepared) -> dict[str, Side]:
    """Return slices through the cross, or maxima along each axis: from the front (xy) and from two sides."""
    volume, (x, y, z) = shown.volume, shown.solid.axes
    if intent.mode == MODES[2]:
        xy, xz, yz = shown.most
    else:
        xy, xz, yz = volume[intent.z], volume[:, intent.y], volume[:, :, intent.x].T
    pixel = max(min(shown.solid.sides), float(np.ptp(z)) / MOST_ROWS)
    return {"xy": _even(xy, y, x, pixel), "xz": _even(xz, z, x, pixel), "yz": _even(yz, y, z, pixel)}


def _even(image: NDArray[Any], down: NDArray[np.float64], across: NDArray[np.float64], pixel: float) -> Side:
    """Return ``image``, whose rows and columns may be unevenly spaced, resampled to square pixels (nearest)."""
    rows, top = _nearest(down, pixel)
    columns, left = _nearest(across, pixel)
    return Side(image[np.ix_(rows, columns)], (top, left), pixel)


def _nearest(places: NDArray[np.float64], pixel: float) -> tuple[NDArray[np.intp], float]:
    """Return the index of the nearest of ``places`` for each pixel, and the position of the first pixel."""
    order = np.argsort(places, kind="stable")
    ordered = places[order]
    gaps = np.diff(ordered)
    before, after = (gaps[0], gaps[-1]) if len(gaps) else (pixel, pixel)
    start, end = ordered[0] - before / 2, ordered[-1] + after / 2
    count = max(1, round((end - start) / pixel))
    first = start + (end - start - (count - 1) * pixel) / 2
    at = first + pixel * np.arange(count)
    return order[np.searchsorted((ordered[1:] + ordered[:-1]) / 2, at + 1e-9 * pixel)], float(first)


def box_of(solid: Solid, turn: NDArray[np.float64]) -> tuple[Overlay, ...]:
    """Return the visible edges of a volume; back edges come first and are darker."""
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
