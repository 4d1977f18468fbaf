"""Lenslet array as seen on the sensor, and the cell of its lattice."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_choice, check_length, check_number, check_tuple, check_type, format_count
from lfcal.camera.distortion import LatticeDistortion

__all__ = ["LensType", "LensletLattice", "Vector", "cell_corners", "cell_neighbours", "cell_size"]

Array = NDArray[np.float64]
Vector = tuple[float, float]

GAPLESS_SHARE = 0.995
"""Ratio of clear diameter to cell diameter above which lenslets leave no gaps: 5e-5 of the light is lost."""


@dataclass(frozen=True, slots=True)
class LensType:
    """A type of lenslet, with its focal length.

    Attributes
    ----------
    focal_length_um
        Focal length (µm).
    depth_range
        Virtual depths (near, far) between which this type is used, as stated by the manufacturer; None if unknown.

    Examples
    --------
    >>> from lfcal.camera import LensType
    >>> for v in (2.0, 3.0, 5.0):
    ...     print(v, round(LensType.focused_at(v, gap_um=300.0).focal_length_um, 1))
    2.0 600.0
    3.0 450.0
    5.0 375.0
    >>> print(round(LensType(600.0).focus_depth(gap_um=300.0), 3))
    2.0
    """

    focal_length_um: float
    depth_range: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        check_length("lenslet focal length (µm)", self.focal_length_um)
        if self.depth_range is not None:
            near, far = check_tuple("virtual depths, near and far", self.depth_range, 2)
            object.__setattr__(self, "depth_range", (near, far))
            check_number("virtual depth, far", far, above=near, remedy="choose a far end beyond the near end")

    @classmethod
    def focused_at(
        cls, virtual_depth: float, gap_um: float, depth_range: tuple[float, float] | None = None
    ) -> LensType:
        """Return the lens type that is in focus at the virtual depth v: 1/f = (1 - 1/v) / gap.

        ``gap_um`` is the distance from the lenslets to the sensor (µm). A virtual depth of ``math.inf`` means that the
        lenslets are focused at infinity (f = gap), as in a light-field microscope. Virtual depths from 0 to 1 raise
        `InputError`.
        """
        # lenslet equation 1/f = 1/B - 1/a with a = v B: between 0 and 1 the focal length would be negative
        if virtual_depth in (0, 1) or 0 < virtual_depth < 1:
            raise InputError.expected(
                "virtual depth in focus",
                "a value above 1 or below 0",
                virtual_depth,
                "give such a value, or inf for lenslets that are focused at infinity",
            )
        return cls(gap_um / (1.0 - 1.0 / virtual_depth), depth_range)

    def focus_depth(self, gap_um: float) -> float:
        """Return the virtual depth at which this type is in focus, for a sensor ``gap_um`` (µm) behind the lenslets."""
        inverse = 1.0 - gap_um / self.focal_length_um
        return math.inf if inverse == 0 else 1.0 / inverse


@dataclass(frozen=True, slots=True)
class LensletLattice:
    """Square or hexagonal lenslet array with one or three lens types.

    Distances are those of the micro-image lattice on the sensor, as in a white image and in the calibration by the
    manufacturer. The lenslets themselves are closer together by the factor `Camera.lattice_scale`.

    Attributes
    ----------
    kind
        Kind of lattice: ``"square"``, or ``"hexagonal"`` with odd rows shifted by half a pitch.
    pitch_um
        Distance between adjacent micro-image centres in a row (µm).
    gap_um
        Distance B from the lenslets to the sensor (µm).
    types
        One or three lens types. In a hexagonal array with three types, adjacent lenslets have different types, and the
        lenslet at the offset has type 0.
    rotation_rad
        Angle (rad) from the sensor's +x axis to a row, positive from +x towards +y (downwards).
    offset_um
        Centre (x, y) of a type-0 micro-image relative to the sensor's centre (µm), x to the right, y downwards.
    clear_um
        Clear diameter of a lenslet (µm). Like the pitch, it refers to the micro-image lattice: multiply a value stated
        by the manufacturer by `Camera.lattice_scale`. Lenslets with a given diameter are round and truncated at the
        edges of their cells. If the diameter is that of the cell (square: sqrt(2) pitch; hexagonal: 2/sqrt(3) pitch),
        the array has no gaps. None: squares without gaps or, in a hexagonal array, discs whose diameter is the pitch.
    row_pitch_um
        Distance between adjacent rows (µm), for example as measured in a white image. None: the ideal distance (square:
        pitch; hexagonal: sqrt(3)/2 pitch).
    type_step
        Type of the lenslet that follows a type-0 lenslet in its row, in the direction of ``rotation_rad``: 1, or 2 if
        the types are numbered in the other direction.
    shear_rad
        Shear of the lattice (rad): relative to the previous row, each row is shifted along its direction by an
        additional ``tan(shear)`` times the row distance.
    distortion
        Distortion of the micro-image lattice on the sensor, in µm from the sensor's centre. None: no distortion.
        `centres_um`, `lenslet_at` and `lenslets_within` include it; pitch, period and `basis_um` are those of the
        undistorted lattice. `local` returns the lattice at a point.

    Raises
    ------
    InputError
        If a value is invalid: for example, three types in a square array, a clear diameter above 1.5 pitches, or a
        shear of 0.2 or more.

    Examples
    --------
    >>> from lfcal.camera import LensletLattice, LensType
    >>> lattice = LensletLattice("hexagonal", 100.0, 500.0, tuple(LensType.focused_at(v, 500.0) for v in (2, 3, 5)))
    >>> print([round(length, 1) for length in lattice.period_um])
    [173.2, 300.0]
    >>> centres, types = lattice.lenslets_within(110.0, 10.0, (0.0, 0.0))
    >>> print(centres.tolist(), types.tolist())
    [[-100.0, 0.0], [0.0, 0.0], [100.0, 0.0]] [2, 0, 1]
    """

    kind: str = "hexagonal"
    pitch_um: float = 174.35
    gap_um: float = 871.75
    types: tuple[LensType, ...] = (LensType(1000.0),)
    rotation_rad: float = 0.0
    offset_um: tuple[float, float] = (0.0, 0.0)
    clear_um: float | None = None
    row_pitch_um: float | None = None
    type_step: int = 1
    shear_rad: float = 0.0
    distortion: LatticeDistortion | None = None

    def __post_init__(self) -> None:
        """Check every value."""
        check_choice("lenslet lattice", self.kind, ("square", "hexagonal"))
        check_length("lenslet pitch (µm)", self.pitch_um)
        check_length("lenslet-sensor gap (µm)", self.gap_um)
        check_number("lattice rotation (rad)", self.rotation_rad)
        object.__setattr__(self, "offset_um", check_tuple("lattice offset (x, y) (µm)", self.offset_um, 2))
        check_type("lens types", self.types, (tuple, list))
        object.__setattr__(self, "types", tuple(self.types))
        for kind in self.types:
            check_type("lens type", kind, LensType)
        # arrays of three types are hexagonal, with different types as neighbours
        if len(self.types) not in (1, 3) or (len(self.types) == 3 and self.kind == "square"):
            raise InputError.expected(
                "lens types",
                "one type, or three types on a hexagonal array",
                f"{format_count(len(self.types), 'type', 'types')} on a {self.kind} array",
                "change the types or the array",
            )
        if self.row_pitch_um is not None:
            check_number("row pitch (µm)", self.row_pitch_um, at_least=self.pitch_um / 50, at_most=50 * self.pitch_um)
        check_number("shear of the lattice (rad)", self.shear_rad, above=-0.2, below=0.2)
        if self.clear_um is not None:
            gapless = f"lenslets without gaps measure {self.cell_um[1]:.6g} µm from corner to corner"
            check_number("clear diameter (µm)", self.clear_um, above=0, at_most=1.5 * self.pitch_um, remedy=gapless)
        check_number("step of lens types along a row", self.type_step, at_least=1, at_most=2, integer=True)
        if self.distortion is not None:
            check_type("distortion of the lattice", self.distortion, LatticeDistortion)

    @property
    def row_step_um(self) -> float:
        """Distance between adjacent rows (µm), stated or ideal."""
        if self.row_pitch_um is not None:
            return self.row_pitch_um
        return self.pitch_um * (math.sqrt(3) / 2 if self.kind == "hexagonal" else 1.0)

    @property
    def clear_diameter_um(self) -> float:
        """Clear diameter of a lenslet (µm), at most that of the circle around its cell; the side of gapless squares."""
        if self.clear_um is None or self.edge_to_edge:
            return self.pitch_um
        return min(self.clear_um, self.cell_um[1])

    @property
    def cell_um(self) -> tuple[float, float]:
        """Diameters (µm) of the largest circle in a lenslet's cell and of the circle around the cell.

        The cell consists of the points that are closer to this lenslet than to any other.
        """
        sides, across = cell_size(*self._upright_um)
        return min(sides), across

    @property
    def edge_to_edge(self) -> bool:
        """Whether the lenslets are squares without gaps."""
        return self.kind == "square" and self.gapless

    @property
    def gapless(self) -> bool:
        """Whether the lenslets fill their cells: squares without gaps, or discs that reach the corners of the cells.

        Discs that are smaller by at most 0.5 % count as reaching the corners.
        """
        if self.clear_um is None and self.kind == "square":
            return True
        return (self.pitch_um if self.clear_um is None else self.clear_um) >= GAPLESS_SHARE * self.cell_um[1]

    @property
    def fill_factor(self) -> float:
        """Fraction of the area of the array that the clear apertures of the lenslets cover, 0 to 1."""
        if self.gapless:
            return 1.0
        radius, cell = self.clear_diameter_um / 2, self.pitch_um * self.row_step_um
        # the segments outside the sides do not overlap, because the cell's corners lie on one circle
        cut = [math.acos(side / (2 * radius)) for side in cell_size(*self._upright_um)[0] if side < 2 * radius]
        beyond = sum(2 * (angle - math.sin(2 * angle) / 2) for angle in cut)
        return radius**2 * (math.pi - beyond) / cell

    @property
    def period_um(self) -> tuple[float, float]:
        """Rectangular period ``(y, x)`` of the array (µm), after which the lens types also repeat.

        The periods are measured along and across the lenslet rows. If the lenslet rows are closer to the rows of the
        sensor than to its columns, x is the period along them; otherwise, y is. Shear and distortion are neglected.
        """
        across, along = self.row_step_um, self.pitch_um
        # odd rows are shifted by half a pitch, so a rectangular cell takes two rows; three types repeat every third
        # lenslet
        if self.kind == "hexagonal":
            across, along = 2 * across, len(self.types) * along
        return (along, across) if self.quarter_turns % 2 else (across, along)

    @property
    def quarter_turns(self) -> int:
        """Number of quarter turns from the sensor's +x axis to the lenslet rows, rounded to the nearest integer."""
        return round(self.rotation_rad / (math.pi / 2))

    @property
    def tilt_rad(self) -> float:
        """Angle (rad) from the nearest sensor axis to the lenslet rows, positive from +x towards +y."""
        return self.rotation_rad - self.quarter_turns * math.pi / 2

    def basis_um(self) -> NDArray[np.float64]:
        """Return the undistorted basis vectors ``[[ax, ay], [bx, by]]`` (µm): along a row, and to the next row."""
        upright = np.array(self._upright_um)
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        # image y points down, so this turns from +x towards +y: clockwise on the screen
        turn = np.array([[c, s], [-s, c]])
        basis: NDArray[np.float64] = upright @ turn
        return basis

    @property
    def _upright_um(self) -> tuple[Vector, Vector]:
        """Vectors of `basis_um` for rows along +x."""
        lean = self.pitch_um / 2 if self.kind == "hexagonal" else 0.0
        return (self.pitch_um, 0.0), (lean + self.row_step_um * math.tan(self.shear_rad), self.row_step_um)

    def centres_um(self, q: ArrayLike, r: ArrayLike) -> NDArray[np.float64]:
        """Return the centres (x, y), ``(..., 2)``, of the micro-images q in rows r, in µm from the sensor's centre."""
        index = np.stack(np.broadcast_arrays(np.asarray(q, float), np.asarray(r, float)), axis=-1)
        centres: NDArray[np.float64] = index @ self.basis_um() + np.array(self.offset_um)
        return centres if self.distortion is None else self.distortion.apply(centres)

    def lenslet_at(self, xy_um: ArrayLike) -> NDArray[np.float64]:
        """Return fractional lattice indices (q, r), ``(..., 2)``, of points (x, y) (µm); inverse of `centres_um`."""
        points = np.asarray(xy_um, float)
        straight = points if self.distortion is None else self.distortion.invert(points)
        index: NDArray[np.float64] = (straight - np.array(self.offset_um)) @ np.linalg.inv(self.basis_um())
        return index

    def in_cell(self, x_um: ArrayLike, y_um: ArrayLike) -> NDArray[np.bool_]:
        """Return whether points are in the cell of a lenslet; ``x_um`` and ``y_um`` (µm) are relative to its centre."""
        points = np.stack(np.broadcast_arrays(np.asarray(x_um, float), np.asarray(y_um, float)), -1)
        others = cell_neighbours(self.basis_um())
        inside: NDArray[np.bool_] = (np.abs(points @ others.T) <= (others**2).sum(-1) / 2).all(-1)
        return inside

    def local(self, about_um: tuple[float, float]) -> LensletLattice:
        """Return an undistorted lattice that approximates this one near ``about_um``.

        ``about_um`` is a point (x, y) in µm from the sensor's centre. Pitch, row pitch, rotation and shear are those at
        the nearest type-0 lenslet, whose centre becomes the offset. An undistorted lattice is returned unchanged. Use
        this method to compute periods, wave vectors and rotations of a distorted lattice.
        """
        if self.distortion is None:
            return self
        near = np.rint(self.lenslet_at(about_um)).astype(np.intp)
        # the nearest lenslet of type 0 is at most one step away
        steps = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]) + near
        zero = steps[self.type_of(steps[:, 0], steps[:, 1]) == 0]
        distance = np.hypot(*(self.centres_um(zero[:, 0], zero[:, 1]) - np.array(about_um)).T)
        index = zero[int(np.argmin(distance))]
        straight = index @ self.basis_um() + np.array(self.offset_um)
        a, b = self.basis_um() @ self.distortion.jacobian(straight).T
        pitch = float(np.hypot(*a))
        x, y = self.distortion.apply(straight)
        row = float(a[0] * b[1] - a[1] * b[0]) / pitch
        lean = float(a @ b) / pitch - (pitch / 2 if self.kind == "hexagonal" else 0.0)
        turn = math.atan2(a[1], a[0])
        return replace(
            self,
            pitch_um=pitch,
            row_pitch_um=row,
            # not reduced to half a turn: the stated rotation may be larger
            rotation_rad=self.rotation_rad + math.remainder(turn - self.rotation_rad, 2 * math.pi),
            shear_rad=math.atan(lean / row),
            offset_um=(float(x), float(y)),
            clear_um=self.clear_of(pitch),
            distortion=None,
        )

    def clear_of(self, pitch_um: float) -> float | None:
        """Return `clear_um` for this lattice with another pitch, ``pitch_um`` (µm); None if `clear_um` is None.

        The diameter of lenslets without gaps scales with the pitch. Lenslets with gaps keep their diameter, limited to
        1.5 times the new pitch.
        """
        if self.clear_um is None or not self.gapless:
            return None if self.clear_um is None else min(self.clear_um, 1.5 * pitch_um)
        return self.clear_um * pitch_um / self.pitch_um

    def scaled(self, factor: float) -> LensletLattice:
        """Return a copy scaled in the sensor plane by ``factor`` about its centre, with the same gap and types."""
        x, y = self.offset_um
        return replace(
            self,
            pitch_um=factor * self.pitch_um,
            row_pitch_um=None if self.row_pitch_um is None else factor * self.row_pitch_um,
            offset_um=(factor * x, factor * y),
            clear_um=None if self.clear_um is None else factor * self.clear_um,
            distortion=None if self.distortion is None else self.distortion.scaled(factor),
        )

    def type_of(self, q: ArrayLike, r: ArrayLike) -> NDArray[np.intp]:
        """Return the lens types of the lenslets (q, r): ``type_step (q - r) mod 3`` for three types, otherwise 0."""
        # moving one lenslet along b changes the type by -1, so all six neighbours differ
        return np.mod(self.type_step * (np.asarray(q, np.intp) - np.asarray(r, np.intp)), len(self.types))

    def type_at(self, xy_um: ArrayLike) -> NDArray[np.intp]:
        """Return the lens type, ``(...)``, of the lenslet nearest to each point (x, y), ``(..., 2)`` (µm)."""
        points = np.asarray(xy_um, float)
        near = np.rint(self.lenslet_at(points)).astype(np.intp)
        steps = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)])
        # in a hexagonal array, the nearest lenslet is among the neighbours of the rounded index
        around = near[..., None, :] + steps
        centres = self.centres_um(around[..., 0], around[..., 1])
        nearest = np.square(centres - points[..., None, :]).sum(-1).argmin(-1)
        best = np.take_along_axis(around, nearest[..., None, None], axis=-2)[..., 0, :]
        return self.type_of(best[..., 0], best[..., 1])

    def lenslets_within(
        self, half_width_um: float, half_height_um: float, about_um: tuple[float, float] = (0.0, 0.0)
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return centres (x, y), ``(n, 2)`` (µm), and types, ``(n,)``, of the lenslets in a box about ``about_um``.

        The box extends from the point ``about_um`` (x, y) by ``half_width_um`` to the left and to the right, and by
        ``half_height_um`` up and down. All coordinates are in µm relative to the sensor's centre.
        """
        # the box's outline in lattice indices, with a margin of one cell: a rotated lattice's index range is larger
        # than the box, and that of a distorted one is not largest at the corners
        side = np.linspace(-1, 1, 9)
        outline = [(a, b) for a in side for b in (-1, 1)] + [(a, b) for a in (-1, 1) for b in side]
        index = self.lenslet_at(np.array(outline) * (half_width_um, half_height_um) + np.array(about_um))
        lo, hi = np.floor(index.min(0)).astype(int) - 1, np.ceil(index.max(0)).astype(int) + 1
        q, r = np.meshgrid(np.arange(lo[0], hi[0] + 1), np.arange(lo[1], hi[1] + 1))
        centres = self.centres_um(q.ravel(), r.ravel())
        inside = (np.abs(centres[:, 0] - about_um[0]) <= half_width_um) & (
            np.abs(centres[:, 1] - about_um[1]) <= half_height_um
        )
        return centres[inside], self.type_of(q.ravel(), r.ravel())[inside]


RIGHT_ANGLE = 1e-9
"""Cosine of the angle between the shortest vectors below which the cell is a rectangle."""


def cell_neighbours(basis: ArrayLike) -> Array:
    """Return the vectors from a lattice point to the neighbours whose cells share a side with its cell.

    Of each opposite pair of neighbours, only one is included: two in all for a rectangular cell, three for a hexagonal
    one.

    Parameters
    ----------
    basis
        Two basis vectors of the lattice as rows, ``(2, 2)``.

    Returns
    -------
    ndarray
        Vectors (x, y), ``(2 or 3, 2)``, in the unit of ``basis``, by increasing angle from +x towards +y within half a
        turn. Together with their negatives, they are the vectors to all these neighbours.
    """
    vectors = np.array(basis, float)
    # normalised, because squares of lengths could overflow
    unit = float(np.abs(vectors).max())
    short, long = vectors / unit
    # Gauss's reduction: the shortest vectors, at 60 to 90 degrees
    steps = 1.0
    while abs(steps) >= 1:
        if short @ short > long @ long:
            short, long = long, short
        steps = np.rint(short @ long / (short @ short))
        long = long - steps * short
    if short @ long < 0:
        long = -long
    if short[0] * long[1] < short[1] * long[0]:
        short, long = long, short
    if short @ long <= RIGHT_ANGLE * np.hypot(*short) * np.hypot(*long):
        return unit * np.array([short, long])
    return unit * np.array([short, long, long - short])


def cell_corners(basis: ArrayLike) -> Array:
    """Return the corners (x, y), ``(4 or 6, 2)``, of the cell about a lattice point, relative to this point.

    The order is that of increasing angle, in the direction from +x towards +y. ``basis`` contains two basis vectors of
    the lattice as rows. All corners have the same distance from the lattice point.
    """
    unit = float(np.abs(np.array(basis, float)).max())
    half = cell_neighbours(basis) / unit
    around = np.concatenate([half, -half, half[:1]])
    pairs = np.stack([around[:-1], around[1:]], axis=1)
    squares = (pairs**2).sum(-1, keepdims=True) / 2
    corners: Array = unit * np.linalg.solve(pairs, squares)[..., 0]
    return corners


@lru_cache(maxsize=256)
def cell_size(a: Vector, b: Vector) -> tuple[tuple[float, ...], float]:
    """Return the distances between opposite sides of the cell of a lattice, and its corner-to-corner diameter.

    ``a`` and ``b`` are two basis vectors of the lattice. There are two distances for a rectangular cell and three for a
    hexagonal one.
    """
    sides = np.hypot(*cell_neighbours((a, b)).T)
    return tuple(sides.tolist()), 2 * float(np.hypot(*cell_corners((a, b))[0]))
