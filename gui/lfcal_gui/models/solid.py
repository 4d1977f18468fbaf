"""Projection of a volume from any side at true scale: brightest value along each ray, and its depth. No Qt.

Planes of the volume are shifted relative to each other (a shear) so that all rays run along one axis of the array. The
maximum over the shifted planes is then mapped to the screen (a two-dimensional warp). All values of a row of the
array have the same weights, so that the compiler can vectorise the loop.

This module is part of the window instead of `lfcal.reconstruct`, because it only displays. From Python, the napari
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

FINEST = 8
"""Largest number of samples per voxel along a row of the sheared image."""

MOST_BETWEEN = 4
"""Largest number of steps between two planes."""

WORK = 5e8
"""Largest number of samples of a sharp image (half a second on one core)."""

QUICK = 1.5e7
"""Largest number of samples of an image while the volume is being rotated."""


def turned(turn: NDArray[np.float64], across: float, down: float) -> NDArray[np.float64]:
    """Return the rotation ``turn`` followed by a rotation of the front side right and down (rad)."""
    a, b = math.cos(across), math.sin(across)
    c, d = math.cos(down), math.sin(down)
    about_y = np.array([[a, 0, -b], [0, 1, 0], [b, 0, a]])
    about_x = np.array([[1, 0, 0], [0, c, -d], [0, d, c]])
    # use the nearest rotation, since rounding adds up over thousands of mouse steps
    u, _, v = np.linalg.svd(about_x @ about_y @ turn)
    made: NDArray[np.float64] = u @ v
    return made


BEGIN = turned(np.eye(3), math.radians(-35), math.radians(25))
"""Initial rotation; rows: right, down and into the screen, in the volume's x, y and z."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A volume with its position in space.

    Attributes
    ----------
    values
        Finite values ``(Z, Y, X)``. Between planes that are farther apart than others, interpolated planes are added,
        so that no ray misses a voxel. They do not change the projection.
    depths
        Depth of each of these planes, ascending.
    given
        Depth of each plane of the volume, in its original order.
    sides
        Length of a voxel (y, x), in the same unit.
    measured
        Whether the unit is micrometres; else it is the voxel.
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
        """Return a volume ``(Z, Y, X)``, with planes in any order; NaN becomes as dark as the darkest voxel.

        Without depths or voxel size all voxels are cubes.
        """
        if volume.ndim != 3 or 0 in volume.shape:
            raise InputError.expected("volume", "three axes (z, y, x)", volume.shape, "choose another volume")
        depths, sides, measured = np.arange(len(volume), dtype=float), (1.0, 1.0), False
        if depths_um is not None and voxel_um is not None:
            depths, sides, measured = np.asarray(depths_um, np.float64), voxel_um, True
        if len(depths) != len(volume) or not np.isfinite(depths).all():
            got = f"{len(depths)} depths for {len(volume)} planes" if np.isfinite(depths).all() else "NaN or infinity"
            raise InputError.expected("depths of the volume", "a depth for each plane", got, "choose another volume")
        if not min(sides) > 0:
            got = f"{sides[0]:g} x {sides[1]:g} µm"
            raise InputError.expected("voxels of the volume", "sides above 0 µm", got, "choose another volume")
        values = np.asarray(volume, np.float32)
        known = np.isfinite(values)
        if not known.all():
            low, high = (float(f(values[known])) if known.any() else 0.0 for f in (np.min, np.max))
            values = np.nan_to_num(values, nan=low, posinf=high, neginf=low)
        values, even = _evened(values, depths)
        return cls(values, even, depths, (float(sides[0]), float(sides[1])), measured)

    @cached_property
    def places(self) -> tuple[NDArray[np.float64], ...]:
        """Positions of the voxel centres along x, y and z, relative to the centre of the volume."""
        _, rows, columns = self.values.shape
        x = (np.arange(columns) - (columns - 1) / 2) * self.sides[1]
        y = (np.arange(rows) - (rows - 1) / 2) * self.sides[0]
        return x, y, self.depths - self.middle

    @property
    def axes(self) -> tuple[NDArray[np.float64], ...]:
        """Positions of the voxels along x and y relative to the first one, and the depths of the planes as given."""
        x, y, _ = self.places
        return x - x[0], y - y[0], self.given

    @property
    def middle(self) -> float:
        """Depth of the centre of the volume."""
        low, high = self._along_z
        return (low + high) / 2

    @property
    def _along_z(self) -> tuple[float, float]:
        """Smallest and largest depth, of the first and the last plane. A single plane is as thick as a voxel."""
        z = self.depths
        thick = self.sides[1] / 2 if len(z) == 1 else 0.0
        return float(z[0]) - thick, float(z[-1]) + thick

    @cached_property
    def half(self) -> NDArray[np.float64]:
        """Half lengths of the volume along x, y and z."""
        low, high = self._along_z
        _, rows, columns = self.values.shape
        return np.array([columns * self.sides[1], rows * self.sides[0], high - low]) / 2

    @cached_property
    def steps(self) -> NDArray[np.float64]:
        """Smallest distance between neighbours along x, y and z."""
        gaps = np.diff(self.depths)
        return np.array([self.sides[1], self.sides[0], gaps.min() if len(gaps) else self.sides[1]])

    @property
    def radius(self) -> float:
        """Radius of the circumscribed sphere."""
        return float(np.linalg.norm(self.half))

    @cached_property
    def by_columns(self) -> NDArray[np.float32]:
        """The values ``(Z, X, Y)``, whose rows run along y, for rays along x."""
        return np.ascontiguousarray(self.values.transpose(0, 2, 1))

    @cached_property
    def coarse(self) -> Solid:
        """The volume with a quarter of the voxels (maximum of 2 x 2), for fast rotation."""
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
        """Return the position (x, y, z) of a voxel relative to the centre of the volume."""
        return np.array([self.places[0][column], self.places[1][row], self.given[plane] - self.middle])

    def voxel_at(self, place: NDArray[np.float64]) -> tuple[int, int, int]:
        """Return the plane, row and column of the voxel nearest to a position (x, y, z)."""
        axes = self.given - self.middle, self.places[1], self.places[0]
        plane, row, column = (int(np.argmin(np.abs(axis - at))) for axis, at in zip(axes, place[::-1], strict=True))
        return plane, row, column


def _evened(
    values: NDArray[np.float32], depths: NDArray[np.float64]
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """Return planes and depths from near to far, with planes interpolated in large gaps.

    Of several planes at the same depth, the first is used.
    """
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


class Viewpoint(NamedTuple):
    """Viewpoint of a projection.

    Attributes
    ----------
    turn
        Rows: right, down and into the screen, in the volume's x, y and z.
    origin
        Centre of the first pixel (down, right), relative to the centre of the volume.
    pixel
        Side of a pixel.
    shape
        Rows and columns of the picture.
    """

    turn: NDArray[np.float64]
    origin: tuple[float, float]
    pixel: float
    shape: tuple[int, int]


class Projection(NamedTuple):
    """Brightest value along the ray of each pixel, and its position; not-a-number outside the volume.

    Attributes
    ----------
    values
        Brightest values ``(rows, columns)``.
    depths
        Their depths in the volume.
    ahead
        Their distances into the screen from the centre of the volume.
    """

    values: NDArray[np.float32]
    depths: NDArray[np.float32]
    ahead: NDArray[np.float32]

    def place_at(self, scene: Viewpoint, row: int, column: int) -> NDArray[np.float64]:
        """Return the position (x, y, z) seen at a pixel, relative to the centre of the volume."""
        down, right = (o + scene.pixel * k for o, k in zip(scene.origin, (row, column), strict=True))
        place: NDArray[np.float64] = np.array([right, down, float(self.ahead[row, column])]) @ scene.turn
        return place


class _Pixels(NamedTuple):
    """The brightest values, and their positions along the axis of the planes."""

    values: NDArray[np.float32]
    planes: NDArray[np.float32]


class _Rays(NamedTuple):
    """Shifts of the planes relative to each other, and geometry of the sheared image.

    Attributes
    ----------
    facing
        Whether planes run along the array's first axis.
    before, share, places
        Samples along the rays: index of the plane before each, weight of the next plane, and position.
    down
        Positions of the rows of a plane.
    across
        Position of the first voxel of a row.
    reach
        Half lengths of the volume along the other two axes.
    lean
        Shifts of a plane along these axes, per unit of its position.
    first, step
        First position and spacing of the rows and columns of the sheared image, with one column per voxel.
    """

    facing: bool
    before: NDArray[np.int64]
    share: NDArray[np.float32]
    places: NDArray[np.float64]
    down: NDArray[np.float64]
    across: float
    reach: tuple[float, float]
    lean: tuple[float, float]
    first: tuple[float, float]
    step: tuple[float, float]


class _Screen(NamedTuple):
    """Mapping from screen pixels to the sheared image.

    Attributes
    ----------
    inverse
        Matrix that converts (right, down) on the screen to rows and columns of the sheared image.
    turn
        Components of right, down and into the screen along the axis of the planes, and along z.
    first, step
        First position and spacing of rows and columns of the sheared image.
    origin, pixel
        Centre of the first pixel (down, right), and side of a pixel.
    middle
        Depth of the centre of the volume.
    """

    inverse: NDArray[np.float64]
    turn: NDArray[np.float64]
    first: tuple[float, float]
    step: tuple[float, float]
    origin: tuple[float, float]
    pixel: float
    middle: float


def project_solid(solid: Solid, scene: Viewpoint, *, quick: bool = False) -> Projection:
    """Return the maximum of a volume along each ray; if ``quick``, the result is coarser, for use during rotation."""
    most = QUICK if quick else WORK
    effort = _effort(solid, scene, most)
    if quick and _cost(solid, scene, effort) > most:
        solid = solid.coarse
        effort = _effort(solid, scene, most)
    while effort.rows < 4 and _cost(solid, scene, effort) > most:
        effort = effort._replace(rows=effort.rows * math.sqrt(2))
    rays, shape = _rays(solid, scene, effort)
    pixels = _sheared(solid, scene, rays, (shape[0], effort.columns, shape[1]))
    return _warped(pixels, solid, scene, rays.first, (rays.step[0], rays.step[1] / effort.columns))


class _Effort(NamedTuple):
    """Sampling: distance of ``rows`` (pixels), samples per voxel along rows, and samples per plane along the rays."""

    rows: float
    columns: int
    along: int


def _effort(solid: Solid, scene: Viewpoint, most: float) -> _Effort:
    """Return the finest sampling with at most ``most`` samples.

    It is at best half a pixel across the rays, and a third of a voxel along them.
    """
    main, _, across = _axes(solid, scene.turn)
    ahead = np.abs(scene.turn[2]) / solid.steps
    voxel = solid.sides[1 - across] * _shown(scene, across)
    columns = min(FINEST, max(1, math.ceil(2 * voxel / scene.pixel)))
    # along an axis of the array, values between two voxels change nothing
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


def _cost(solid: Solid, scene: Viewpoint, effort: _Effort) -> float:
    """Return the number of values to evaluate if the whole volume is visible."""
    main, down, across = _axes(solid, scene.turn)
    rows = 2 * solid.half[down] * _shown(scene, down) / (effort.rows * scene.pixel)
    # between two planes a value takes eight voxels instead of four
    planes = len(solid.places[main]) * (2 * effort.along - 1)
    return float(rows * planes * len(solid.places[across]) * effort.columns)


def _shown(scene: Viewpoint, axis: int) -> float:
    """Return the length on the screen of a unit vector along an axis of the volume."""
    return math.sqrt(max(1e-12, 1 - scene.turn[2, axis] ** 2))


def _axes(solid: Solid, turn: NDArray[np.float64]) -> tuple[int, int, int]:
    """Return the axis (of x, y, z) along which planes are shifted, and the axes of rows and columns of each plane.

    From one plane to the next, a ray moves by at most one voxel along the other axes.
    """
    main = int(np.argmax(np.abs(turn[2]) / solid.steps))
    return (main, *((2, 1), (2, 0), (1, 0))[main])


def _rays(solid: Solid, scene: Viewpoint, effort: _Effort) -> tuple[_Rays, tuple[int, int]]:
    """Return the shifts of the planes, and the shape of the visible part of the sheared image."""
    main, *both = _axes(solid, scene.turn)
    ahead = scene.turn[2] / scene.turn[2, main]
    voxel = solid.sides[1 - both[1]]
    step = effort.rows * scene.pixel / _shown(scene, both[0]), voxel
    # the corners of the picture, and the shift of the planes
    corners = np.linalg.solve(scene.turn[:2][:, both], _corners(scene))
    # without rotation, its rows match those of the screen, its columns those of the volume
    across = float(solid.places[both[1]][0])
    anchor = float(corners[0, 0]), across
    first, shape = [], []
    for k, axis in enumerate(both):
        far = solid.half[axis] + abs(ahead[axis]) * solid.half[main]
        begin = max(-far, corners[k].min() - 2 * step[k])
        end = min(far, corners[k].max() + 2 * step[k])
        first.append(float(anchor[k] + math.floor((begin - anchor[k]) / step[k]) * step[k]))
        shape.append(max(1, math.ceil((end - first[k]) / step[k]) + 1))
    reach, lean = ((float(of[both[0]]), float(of[both[1]])) for of in (solid.half, ahead))
    stops, down = _stops(solid, main, effort.along), solid.places[both[0]]
    return _Rays(main == 2, *stops, down, across, reach, lean, (first[0], first[1]), step), (shape[0], shape[1])


def _stops(solid: Solid, main: int, parts: int) -> tuple[NDArray[np.int64], NDArray[np.float32], NDArray[np.float64]]:
    """Return the samples along an axis: plane before each, weight of the next plane, and position.

    There are ``parts - 1`` samples between two planes, and one at each end of the volume.
    """
    along = solid.places[main]
    last = len(along) - 1
    at = np.concatenate([[0], np.arange(last * parts + 1) / parts, [last]])
    places = np.interp(at, np.arange(last + 1), along)
    places[[0, -1]] = -solid.half[main], solid.half[main]
    before = at.astype(np.int64)
    return before, (at - before).astype(np.float32), places


def _sheared(solid: Solid, scene: Viewpoint, rays: _Rays, shape: tuple[int, int, int]) -> _Pixels:
    """Return the maximum over the planes, shifted so that all rays run along one axis of the array.

    ``shape`` is the number of rows, of samples per voxel, and of voxels.
    """
    found = _Pixels(np.full(shape, -np.inf, np.float32), np.zeros(shape, np.float32))
    data = solid.by_columns if _axes(solid, scene.turn)[0] == 0 else solid.values
    for_each_chunk(lambda start, stop: _shear(data, rays, found, start, stop), shape[0])
    height, fine, width = shape
    whole = (np.ascontiguousarray(one.transpose(0, 2, 1)).reshape(height, width * fine) for one in found)
    return _Pixels(*whole)


def _corners(scene: Viewpoint) -> NDArray[np.float64]:
    """Return the corners of the image ``(2, 4)``: right and down."""
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
    """Store the maximum of ``into`` and a row between two rows; the loop is simple enough to be vectorised."""
    low, right = weights
    one = np.float32(1)
    a, b, c, d = (one - low) * (one - right), (one - low) * right, low * (one - right), low * right
    for q in range(into.size):
        value = a * upper[q] + b * upper[q + 1] + c * lower[q] + d * lower[q + 1]
        more = value > into[q]
        planes[q] = plane if more else planes[q]
        into[q] = value if more else into[q]


@njit()
def _shear(data: NDArray[np.float32], rays: _Rays, found: _Pixels, start: int, stop: int) -> None:
    """Compute rows of the sheared image."""
    mixed, down = np.empty(data.shape[2], data.dtype), rays.down
    for r in range(start, stop):
        for n in range(rays.before.size):
            s, share, ahead = rays.before[n], rays.share[n], rays.places[n]
            at = rays.first[0] + r * rays.step[0] + rays.lean[0] * ahead
            if not (-rays.reach[0] <= at <= rays.reach[0]):
                continue
            k = min(max(np.searchsorted(down, at, side="right") - 1, 0), max(down.size - 2, 0))
            after = min(k + 1, down.size - 1)
            gap = down[after] - down[k]
            low = np.float32(min(max((at - down[k]) / gap, 0.0), 1.0) if gap > 0 else 0.0)
            upper = data[s, k] if rays.facing else data[k, s]
            lower = data[s, after] if rays.facing else data[after, s]
            if share > 0:
                upper_next = data[s + 1, k] if rays.facing else data[k, s + 1]
                lower_next = data[s + 1, after] if rays.facing else data[after, s + 1]
                _mix(upper, upper_next, lower, lower_next, (share, low), mixed)
                upper = lower = mixed
                low = np.float32(0)
            _take(upper, lower, (low, ahead), rays, found.values[r], found.planes[r])


@njit()
def _take(
    upper: NDArray[np.float32],
    lower: NDArray[np.float32],
    at: tuple[np.float32, float],
    rays: _Rays,
    values: NDArray[np.float32],
    planes: NDArray[np.float32],
) -> None:
    """Store the maximum of a row between two others; ``at`` is the weight of the lower row, and the plane."""
    (low, ahead), voxel = at, rays.step[1]
    fine, width = values.shape
    last, plane = upper.size - 1, np.float32(ahead)
    for p in range(fine):
        left = rays.first[1] + rays.lean[1] * ahead + p * voxel / fine
        column = (left - rays.across) / voxel
        whole = math.floor(column)
        c0, c1 = max(0, -whole), min(width, last - whole)
        if c1 > c0:
            a, b = c0 + whole, c1 + whole + 1
            weights = low, np.float32(column - whole)
            _brighter(upper[a:b], lower[a:b], weights, plane, values[p, c0:c1], planes[p, c0:c1])
        for q, j in ((c0 - 1, 0), (c1, last)):  # the outermost voxels end half a voxel beyond their middles
            if 0 <= q < width and abs(left + q * voxel) <= rays.reach[1]:
                value = (np.float32(1) - low) * upper[j] + low * lower[j]
                if value > values[p, q]:
                    values[p, q], planes[p, q] = value, plane


@njit()
def _mix(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    c: NDArray[np.float32],
    d: NDArray[np.float32],
    shares: tuple[np.float32, np.float32],
    into: NDArray[np.float32],
) -> None:
    """Interpolate between four rows; ``shares`` are the weights of the second and fourth, and of the last two."""
    one, (right, low) = np.float32(1), shares
    for q in range(into.size):
        into[q] = (one - low) * ((one - right) * a[q] + right * b[q]) + low * ((one - right) * c[q] + right * d[q])


def _warped(
    pixels: _Pixels, solid: Solid, scene: Viewpoint, first: tuple[float, float], step: tuple[float, float]
) -> Projection:
    """Return the projection on the screen; ``first`` and ``step`` describe rows and columns of the sheared image."""
    main, rows, columns = _axes(solid, scene.turn)
    inverse = np.asarray(np.linalg.inv(scene.turn[:2][:, [rows, columns]]), np.float64)
    turn = np.ascontiguousarray(scene.turn[:, [main, 2]])
    screen = _Screen(inverse, turn, first, step, scene.origin, scene.pixel, solid.middle)
    found = Projection(*(np.empty(scene.shape, np.float32) for _ in range(3)))
    for_each_chunk(lambda start, stop: _warp(pixels, screen, found, start, stop), scene.shape[0])
    return found


@njit()
def _warp(pixels: _Pixels, screen: _Screen, found: Projection, start: int, stop: int) -> None:
    """Compute rows of the projection."""
    height, width = pixels.values.shape
    inverse, turn = screen.inverse, screen.turn
    for r in range(start, stop):
        b = screen.origin[0] + r * screen.pixel
        for q in range(found.values.shape[1]):
            a = screen.origin[1] + q * screen.pixel
            u = (inverse[0, 0] * a + inverse[0, 1] * b - screen.first[0]) / screen.step[0]
            v = (inverse[1, 0] * a + inverse[1, 1] * b - screen.first[1]) / screen.step[1]
            found.values[r, q] = found.depths[r, q] = found.ahead[r, q] = np.nan
            if not (0 <= u <= height - 1 and 0 <= v <= width - 1):
                continue
            value, at = _between(pixels, u, v)
            far = (at - a * turn[0, 0] - b * turn[1, 0]) / turn[2, 0]
            found.values[r, q], found.ahead[r, q] = value, far
            found.depths[r, q] = screen.middle + a * turn[0, 1] + b * turn[1, 1] + far * turn[2, 1]


@njit()
def _between(pixels: _Pixels, row: float, column: float) -> tuple[float, float]:
    """Return the value interpolated between the nearest pixels with values, and the plane of the nearest one."""
    height, width = pixels.values.shape
    i, j = min(int(row), max(height - 2, 0)), min(int(column), max(width - 2, 0))
    total, weight, best, at = 0.0, 0.0, 0.0, np.nan
    for y, down in ((i, 1 - row + i), (i + 1, row - i)):
        for x, across in ((j, 1 - column + j), (j + 1, column - j)):
            w = down * across
            if w <= 0 or y >= height or x >= width or pixels.values[y, x] == -np.inf:
                continue
            total += w * pixels.values[y, x]
            weight += w
            if w > best:
                best, at = w, float(pixels.planes[y, x])
    if weight < 0.5:
        return np.nan, np.nan
    return total / weight, at
