"""A volume seen from any side, at true scale: the brightest value along each ray, and its depth. No Qt.

Planes of the volume are shifted against each other (a shear) so that all rays run along one axis of the array. The
maximum over the shifted planes is then turned on the screen (a warp in two dimensions). All values of a row of the
array have the same weights, which the compiler turns into vector instructions.

This is part of the window rather than of `lfcal.reconstruct`: it makes pictures to look at. From Python, the napari
plug-in shows volumes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, for_each_chunk, njit

__all__ = ["BEGIN", "Projection", "Scene", "Solid", "project", "turned"]

FINEST = 8
"""Most samples to a voxel along a row of the sheared picture."""

MOST_BETWEEN = 4
"""Most steps into which the distance of two planes is divided."""

WORK = 5e8
"""Samples of a sharp picture at most: half a second on one core."""

QUICK = 1.5e7
"""Samples of a picture while the volume is being turned."""


def turned(turn: NDArray[np.float64], across: float, down: float) -> NDArray[np.float64]:
    """Return ``turn`` turned further: the side that faces you moves right and down, by radians."""
    a, b = math.cos(across), math.sin(across)
    c, d = math.cos(down), math.sin(down)
    about_y = np.array([[a, 0, -b], [0, 1, 0], [b, 0, a]])
    about_x = np.array([[1, 0, 0], [0, c, -d], [0, d, c]])
    # rounding adds up over thousands of steps of the mouse: the nearest rotation is taken
    u, _, v = np.linalg.svd(about_x @ about_y @ turn)
    made: NDArray[np.float64] = u @ v
    return made


BEGIN = turned(np.eye(3), math.radians(-35), math.radians(25))
"""Rows: right, down and into the screen, in the volume's x, y and z."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A volume with its place in space.

    Attributes
    ----------
    values
        ``(Z, Y, X)``, finite; between planes that are further apart than others there are some more, so that a ray
        passes none. They lie on the straight line between their neighbours, and change nothing of what is seen.
    depths
        Place of each of these planes, ascending.
    given
        Place of each plane of the volume, as they follow each other in it.
    sides
        Length of a voxel (y, x), in the same unit.
    measured
        Whether the unit is micrometres; else it is a voxel.
    """

    values: NDArray[np.float32]
    depths: NDArray[np.float64]
    given: NDArray[np.float64]
    sides: tuple[float, float]
    measured: bool

    @classmethod
    def of(
        cls, volume: NDArray[Any], depths_um: ArrayLike | None = None, voxel_um: tuple[float, float] | None = None
    ) -> Solid:
        """Place a volume ``(Z, Y, X)``: planes in any order; not-a-number is as dark as its darkest voxel.

        Without depths or voxel size all voxels are cubes.
        """
        if volume.ndim != 3 or 0 in volume.shape:
            raise InputError.expected("volume", "three axes (z, y, x)", volume.shape, "choose another one")
        depths, sides, measured = np.arange(len(volume), dtype=float), (1.0, 1.0), False
        if depths_um is not None and voxel_um is not None:
            depths, sides, measured = np.asarray(depths_um, np.float64), voxel_um, True
        if len(depths) != len(volume) or not np.isfinite(depths).all() or not min(sides) > 0:
            raise InputError.expected("volume", "a depth for each plane", (depths, sides), "correct it")
        values = np.asarray(volume, np.float32)
        known = np.isfinite(values)
        if not known.all():
            low, high = (float(f(values[known])) if known.any() else 0.0 for f in (np.min, np.max))
            values = np.nan_to_num(values, nan=low, posinf=high, neginf=low)
        values, even = _evened(values, depths)
        return cls(values, even, depths, (float(sides[0]), float(sides[1])), measured)

    @cached_property
    def places(self) -> tuple[NDArray[np.float64], ...]:
        """Where the middles of voxels lie along x, y and z, from the middle of the volume."""
        _, rows, columns = self.values.shape
        x = (np.arange(columns) - (columns - 1) / 2) * self.sides[1]
        y = (np.arange(rows) - (rows - 1) / 2) * self.sides[0]
        return x, y, self.depths - self.middle

    @property
    def axes(self) -> tuple[NDArray[np.float64], ...]:
        """Where voxels of the volume lie along x and y, from the first one, and its planes, as they were given."""
        x, y, _ = self.places
        return x - x[0], y - y[0], self.given

    @property
    def middle(self) -> float:
        """Depth of the middle of the volume."""
        low, high = self._along_z
        return (low + high) / 2

    @property
    def _along_z(self) -> tuple[float, float]:
        """Where the volume begins and ends: at its first and last plane; a single one is as thick as a voxel."""
        z = self.depths
        thick = self.sides[1] / 2 if len(z) == 1 else 0.0
        return float(z[0]) - thick, float(z[-1]) + thick

    @cached_property
    def half(self) -> NDArray[np.float64]:
        """Half of its length along x, y and z."""
        low, high = self._along_z
        _, rows, columns = self.values.shape
        return np.array([columns * self.sides[1], rows * self.sides[0], high - low]) / 2

    @cached_property
    def steps(self) -> NDArray[np.float64]:
        """Smallest distance of two neighbours along x, y and z."""
        gaps = np.diff(self.depths)
        return np.array([self.sides[1], self.sides[0], gaps.min() if len(gaps) else self.sides[1]])

    @property
    def radius(self) -> float:
        """Of the sphere about it: however it is turned, it lies within."""
        return float(np.linalg.norm(self.half))

    @cached_property
    def by_columns(self) -> NDArray[np.float32]:
        """The values ``(Z, X, Y)``: for rays along x rows run along y."""
        return np.ascontiguousarray(self.values.transpose(0, 2, 1))

    @cached_property
    def coarse(self) -> Solid:
        """The same with a quarter of the voxels, of 2 x 2 the brightest: quick to turn."""
        _, rows, columns = self.values.shape
        if min(rows, columns) < 4:
            return self
        even = self.values[:, : rows // 2 * 2, : columns // 2 * 2]
        best = np.maximum(even[:, ::2], even[:, 1::2])
        return Solid(
            np.maximum(best[:, :, ::2], best[:, :, 1::2]),
            self.depths,
            self.given,
            (self.sides[0] * rows / (rows // 2), self.sides[1] * columns / (columns // 2)),
            self.measured,
        )

    def place_of(self, plane: int, row: int, column: int) -> NDArray[np.float64]:
        """Return where a voxel of the volume lies (x, y, z), from its middle."""
        return np.array([self.places[0][column], self.places[1][row], self.given[plane] - self.middle])

    def voxel_at(self, place: NDArray[np.float64]) -> tuple[int, int, int]:
        """Return the plane, row and column of the volume that are nearest to a place (x, y, z)."""
        axes = self.given - self.middle, self.places[1], self.places[0]
        plane, row, column = (int(np.argmin(np.abs(axis - at))) for axis, at in zip(axes, place[::-1], strict=True))
        return plane, row, column


def _evened(
    values: NDArray[np.float32], depths: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return planes from near to far, some more where they are far apart; of several at one depth the first."""
    depths, order = np.unique(depths, return_index=True)
    gaps = np.diff(depths)
    counts = np.ones(0, int)
    if len(gaps):
        counts = np.ceil(np.minimum(gaps / gaps.min(), MOST_BETWEEN) - 1e-6).astype(int)
    at = np.concatenate([*(k + np.arange(n) / n for k, n in enumerate(counts)), [len(gaps)]])
    if len(at) == len(order):
        ordered = values if (order == np.arange(len(values))).all() else values[order]
        return np.ascontiguousarray(ordered), depths
    before = at.astype(int)
    share = (at - before).astype(np.float32)[:, None, None]
    after = np.minimum(before + 1, len(gaps))
    return values[order[before]] * (1 - share) + values[order[after]] * share, np.interp(
        at, np.arange(len(depths)), depths
    )


class Scene(NamedTuple):
    """How a volume is looked at.

    Attributes
    ----------
    turn
        Rows: right, down and into the screen, in the volume's x, y and z.
    origin
        Middle of the first pixel (down, right), from the middle of the volume.
    pixel
        Length of a pixel.
    shape
        Rows and columns of the picture.
    """

    turn: NDArray[np.float64]
    origin: tuple[float, float]
    pixel: float
    shape: tuple[int, int]


class Projection(NamedTuple):
    """The brightest value along the ray of each pixel, and where it lies; not-a-number off the volume.

    Attributes
    ----------
    values
        ``(rows, columns)``.
    depths
        Depth of it in the volume.
    ahead
        How far into the screen it lies, from the middle of the volume.
    """

    values: NDArray[np.float32]
    depths: NDArray[np.float32]
    ahead: NDArray[np.float32]

    def place_at(self, scene: Scene, row: int, column: int) -> NDArray[np.float64]:
        """Return the place (x, y, z) that is seen at a pixel, from the middle of the volume."""
        down, right = (o + scene.pixel * k for o, k in zip(scene.origin, (row, column), strict=True))
        place: NDArray[np.float64] = np.array([right, down, float(self.ahead[row, column])]) @ scene.turn
        return place


class _Sheared(NamedTuple):
    """The maximum over the shifted planes, and the place of its plane, on a grid of two axes of the volume.

    ``axes``: that of the shifted planes, of rows and of columns; ``first``, ``step``: the first place and the distance
    of places along rows and columns.
    """

    values: NDArray[np.float32]
    planes: NDArray[np.float32]
    axes: tuple[int, int, int]
    first: tuple[float, float]
    step: tuple[float, float]


def project(solid: Solid, scene: Scene, *, quick: bool = False) -> Projection:
    """Look at a volume: the brightest value along each ray; ``quick``: coarser, while it is being turned."""
    most = QUICK if quick else WORK
    effort = _effort(solid, scene, most)
    if quick and _cost(solid, scene, effort) > most:
        solid = solid.coarse
        effort = _effort(solid, scene, most)
    while effort.rows < 4 and _cost(solid, scene, effort) > most:
        effort = effort._replace(rows=effort.rows * math.sqrt(2))
    return _warped(_sheared(solid, scene, effort), solid, scene)


class _Effort(NamedTuple):
    """How close samples are: ``rows`` (pixels apart), samples to a voxel along rows, and along the rays."""

    rows: float
    columns: int
    along: int


def _effort(solid: Solid, scene: Scene, most: float) -> _Effort:
    """Return the closest samples that are not too many: at best half a pixel, and a third of a voxel along rays."""
    main, _, across = _axes(solid, scene.turn)
    ahead = np.abs(scene.turn[2]) / solid.steps
    voxel = solid.sides[1 - across] * _shown(scene, across)
    columns = min(FINEST, max(1, math.ceil(2 * voxel / scene.pixel)))
    # along the axis of the array there is nothing to see between two voxels
    along = 1 + round(2 * float(np.delete(ahead, main).max() / ahead[main]))
    half = (columns + 1) // 2
    tried = [
        _Effort(0.5, columns, along),
        _Effort(0.5, columns, min(along, 2)),
        _Effort(1.0, half, min(along, 2)),
        _Effort(1.0, half, 1),
        _Effort(1.0, 1, 1),
    ]
    return next((one for one in tried if _cost(solid, scene, one) <= most), tried[-1])


def _cost(solid: Solid, scene: Scene, effort: _Effort) -> float:
    """Return how many values are looked at where all of it is seen."""
    main, down, across = _axes(solid, scene.turn)
    rows = 2 * solid.half[down] * _shown(scene, down) / (effort.rows * scene.pixel)
    # between two planes values are of eight voxels rather than of four
    planes = len(solid.places[main]) * (2 * effort.along - 1)
    return float(rows * planes * len(solid.places[across]) * effort.columns)


def _shown(scene: Scene, axis: int) -> float:
    """Return how long a unit along an axis of the volume is on the screen."""
    return math.sqrt(max(1e-12, 1 - scene.turn[2, axis] ** 2))


def _axes(solid: Solid, turn: NDArray[np.float64]) -> tuple[int, int, int]:
    """Return the axis (of x, y, z) along which planes are shifted, and those of rows and columns of each plane.

    Between two planes a ray moves on by at most a voxel along the others.
    """
    main = int(np.argmax(np.abs(turn[2]) / solid.steps))
    return (main, *((2, 1), (2, 0), (1, 0))[main])


class _Grid(NamedTuple):
    """Where the rows and columns of the sheared picture lie: the first ones, their distances, and how many."""

    first: tuple[float, float]
    step: tuple[float, float]
    shape: tuple[int, int]


def _grid(solid: Solid, scene: Scene, effort: _Effort, lean: tuple[float, float]) -> _Grid:
    """Return the part of the sheared picture that is seen, a column to a voxel."""
    main, *both = _axes(solid, scene.turn)
    voxel = solid.sides[1 - both[1]]
    step = effort.rows * scene.pixel / _shown(scene, both[0]), voxel
    # the corners of the picture, and how far planes are shifted
    corners = np.linalg.solve(scene.turn[:2][:, both], _corners(scene))
    # where nothing is turned its rows lie on those of the screen, its columns on those of the volume
    anchor = corners[0, 0], solid.places[both[1]][0]
    first, shape = [], []
    for k, axis in enumerate(both):
        far = solid.half[axis] + abs(lean[k]) * solid.half[main]
        begin = max(-far, corners[k].min() - 2 * step[k])
        end = min(far, corners[k].max() + 2 * step[k])
        first.append(float(anchor[k] + math.floor((begin - anchor[k]) / step[k]) * step[k]))
        shape.append(max(1, math.ceil((end - first[k]) / step[k]) + 1))
    return _Grid((first[0], first[1]), step, (shape[0], shape[1]))


def _stops(solid: Solid, main: int, parts: int) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float64]]:
    """Return where along an axis values are taken: plane before it, share of the next one, place.

    Between two planes are ``parts - 1`` others, and there is one at each end of the volume.
    """
    along = solid.places[main]
    last = len(along) - 1
    at = np.concatenate([[0], np.arange(last * parts + 1) / parts, [last]])
    places = np.interp(at, np.arange(last + 1), along)
    places[[0, -1]] = -solid.half[main], solid.half[main]
    before = at.astype(np.int64)
    return before, (at - before).astype(np.float32), places


def _sheared(solid: Solid, scene: Scene, effort: _Effort) -> _Sheared:
    """Return the maximum over the planes, shifted so that all rays run along one axis of the array."""
    main, rows, columns = _axes(solid, scene.turn)
    ahead = scene.turn[2]
    lean = float(ahead[rows] / ahead[main]), float(ahead[columns] / ahead[main])
    grid, fine = _grid(solid, scene, effort, lean), effort.columns
    height, width = grid.shape
    values = np.full((height, fine, width), -np.inf, np.float32)
    planes = np.zeros((height, fine, width), np.float32)
    data = solid.by_columns if main == 0 else solid.values
    stops = _stops(solid, main, effort.along)
    reach = float(solid.half[rows]), float(solid.half[columns])
    down, across = solid.places[rows], float(solid.places[columns][0])

    def some(start: int, stop: int) -> None:
        _shear(
            data, main == 2, stops, down, across, reach, lean, (*grid.first, *grid.step), values, planes, start, stop
        )

    for_each_chunk(some, height)
    whole = [np.ascontiguousarray(a.transpose(0, 2, 1)).reshape(height, width * fine) for a in (values, planes)]
    return _Sheared(whole[0], whole[1], (main, rows, columns), grid.first, (grid.step[0], grid.step[1] / fine))


def _corners(scene: Scene) -> NDArray[np.float64]:
    """Return the corners of the picture: right and down ``(2, 4)``."""
    (top, left), (rows, columns) = scene.origin, scene.shape
    right, bottom = left + (columns - 1) * scene.pixel, top + (rows - 1) * scene.pixel
    return np.array([[left, right, left, right], [top, top, bottom, bottom]])


@njit()
def _brighter(
    upper: NDArray[np.float32],
    lower: NDArray[np.float32],
    weights: tuple[np.float32, np.float32],
    plane: np.float32,
    into: NDArray[np.float32],
    planes: NDArray[np.float32],
) -> None:
    """Take what is brighter between two rows; simple enough for the compiler to make vector instructions of it."""
    low, right = weights
    one = np.float32(1)
    a, b, c, d = (one - low) * (one - right), (one - low) * right, low * (one - right), low * right
    for q in range(into.size):
        value = a * upper[q] + b * upper[q + 1] + c * lower[q] + d * lower[q + 1]
        more = value > into[q]
        planes[q] = plane if more else planes[q]
        into[q] = value if more else into[q]


@njit()
def _shear(
    data: NDArray[np.float32],
    facing: bool,
    stops: tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float64]],
    down: NDArray[np.float64],
    across: float,
    reach: tuple[float, float],
    lean: tuple[float, float],
    grid: tuple[float, float, float, float],
    values: NDArray[np.float32],
    planes: NDArray[np.float32],
    start: int,
    stop: int,
) -> None:
    """Fill rows of the sheared picture; ``facing``: planes are those of the array's first axis."""
    mixed = np.empty(data.shape[2], data.dtype)
    for r in range(start, stop):
        for n in range(stops[0].size):
            s, share, ahead = stops[0][n], stops[1][n], stops[2][n]
            at = grid[0] + r * grid[2] + lean[0] * ahead
            if not (-reach[0] <= at <= reach[0]):
                continue
            k = min(max(np.searchsorted(down, at, side="right") - 1, 0), max(down.size - 2, 0))
            after = min(k + 1, down.size - 1)
            gap = down[after] - down[k]
            low = np.float32(min(max((at - down[k]) / gap, 0.0), 1.0) if gap > 0 else 0.0)
            upper = data[s, k] if facing else data[k, s]
            lower = data[s, after] if facing else data[after, s]
            if share > 0:
                upper_next = data[s + 1, k] if facing else data[k, s + 1]
                lower_next = data[s + 1, after] if facing else data[after, s + 1]
                _mix(upper, upper_next, lower, lower_next, share, low, mixed)
                upper = lower = mixed
                low = np.float32(0)
            begin = grid[1] + lean[1] * ahead
            _take(upper, lower, low, np.float32(ahead), begin, across, grid[3], reach[1], values[r], planes[r])


@njit()
def _take(
    upper: NDArray[np.float32],
    lower: NDArray[np.float32],
    low: np.float32,
    plane: np.float32,
    begin: float,
    across: float,
    voxel: float,
    reach: float,
    values: NDArray[np.float32],
    planes: NDArray[np.float32],
) -> None:
    """Take what is brighter of a row that is shifted; ``begin``, ``across``: places of the first pixel and voxel."""
    fine, width = values.shape
    last = upper.size - 1
    for p in range(fine):
        left = begin + p * voxel / fine
        column = (left - across) / voxel
        whole = math.floor(column)
        c0, c1 = max(0, -whole), min(width, last - whole)
        if c1 > c0:
            a, b = c0 + whole, c1 + whole + 1
            weights = low, np.float32(column - whole)
            _brighter(upper[a:b], lower[a:b], weights, plane, values[p, c0:c1], planes[p, c0:c1])
        for q, j in ((c0 - 1, 0), (c1, last)):  # half a voxel beyond the middles of the outermost ones
            if 0 <= q < width and abs(left + q * voxel) <= reach:
                value = (np.float32(1) - low) * upper[j] + low * lower[j]
                if value > values[p, q]:
                    values[p, q], planes[p, q] = value, plane


@njit()
def _mix(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    right: np.float32,
    low: np.float32,
    into: NDArray[np.float32],
) -> None:
    """Write what lies between four rows."""
    one = np.float32(1)
    for q in range(into.size):
        into[q] = (one - low) * ((one - right) * a[q] + right * b[q]) + low * ((one - right) * c[q] + right * d[q])


def _warped(sheared: _Sheared, solid: Solid, scene: Scene) -> Projection:
    main, rows, columns = sheared.axes
    inverse = np.asarray(np.linalg.inv(scene.turn[:2][:, [rows, columns]]), np.float64)
    found = Projection(*(np.empty(scene.shape, np.float32) for _ in range(3)))

    def some(start: int, stop: int) -> None:
        _warp(
            sheared.values,
            sheared.planes,
            inverse,
            np.ascontiguousarray(scene.turn[:, [main, 2]]),
            (*sheared.first, *sheared.step),
            (scene.origin[1], scene.origin[0], scene.pixel),
            solid.middle,
            found.values,
            found.depths,
            found.ahead,
            start,
            stop,
        )

    for_each_chunk(some, scene.shape[0])
    return found


@njit()
def _warp(
    source: NDArray[np.float32],
    planes: NDArray[np.float32],
    inverse: NDArray[np.float64],
    turn: NDArray[np.float64],
    grid: tuple[float, float, float, float],
    screen: tuple[float, float, float],
    middle: float,
    values: NDArray[np.float32],
    depths: NDArray[np.float32],
    ahead: NDArray[np.float32],
    start: int,
    stop: int,
) -> None:
    """Fill rows of the screen: values between the four nearest of the sheared picture, the place of the nearest one.

    ``turn``: what the screen's right, down and ahead are along the axis of the planes, and along z.
    """
    height, width = source.shape
    for r in range(start, stop):
        b = screen[1] + r * screen[2]
        for q in range(values.shape[1]):
            a = screen[0] + q * screen[2]
            u = (inverse[0, 0] * a + inverse[0, 1] * b - grid[0]) / grid[2]
            v = (inverse[1, 0] * a + inverse[1, 1] * b - grid[1]) / grid[3]
            values[r, q] = depths[r, q] = ahead[r, q] = np.nan
            if not (0 <= u <= height - 1 and 0 <= v <= width - 1):
                continue
            value, at = _between(source, planes, u, v)
            far = (at - a * turn[0, 0] - b * turn[1, 0]) / turn[2, 0]
            values[r, q], ahead[r, q] = value, far
            depths[r, q] = middle + a * turn[0, 1] + b * turn[1, 1] + far * turn[2, 1]


@njit()
def _between(
    source: NDArray[np.float32], planes: NDArray[np.float32], row: float, column: float
) -> tuple[float, float]:
    """Return the value between the four nearest pixels that have one, and the plane of the nearest of these."""
    height, width = source.shape
    i, j = min(int(row), max(height - 2, 0)), min(int(column), max(width - 2, 0))
    total, weight, best, at = 0.0, 0.0, 0.0, np.nan
    for y, down in ((i, 1 - row + i), (i + 1, row - i)):
        for x, across in ((j, 1 - column + j), (j + 1, column - j)):
            w = down * across
            if w <= 0 or y >= height or x >= width or source[y, x] == -np.inf:
                continue
            total += w * source[y, x]
            weight += w
            if w > best:
                best, at = w, float(planes[y, x])
    if weight < 0.5:
        return np.nan, np.nan
    return total / weight, at
