"""The lattice interface that views need, and lattices of a camera, of a part of the sensor, and of one lens type."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, check_tuple
from lfcal.camera import Camera

__all__ = [
    "CameraLattice",
    "CroppedLattice",
    "FrameLattice",
    "MicroImageLattice",
    "TypeLattice",
    "cropped",
    "lattice_of",
    "type_lattice",
]

Array = NDArray[np.float64]
TypeOf = Callable[[ArrayLike, ArrayLike], NDArray[np.intp]]
"""Function that returns the lens types of the lenslets with the indices q and r."""

INVERSE_PX, INVERSE_ROUNDS = 1e-8, 25
"""Accuracy (pixels) of the lenslet centre when the index of a point is found iteratively."""


class MicroImageLattice(Protocol):
    """Protocol for lattices of micro-images, from which views can be extracted; `LatticeFit` implements it."""

    @property
    def kind(self) -> str:
        """Kind of lattice: ``"square"`` or ``"hexagonal"``."""

    @property
    def pitch_px(self) -> float:
        """Distance between adjacent micro-images along a row (px)."""

    @property
    def row_pitch_px(self) -> float:
        """Distance between adjacent rows of micro-images (px)."""

    @property
    def rotation_rad(self) -> float:
        """Angle (rad) from the +x (column) axis to a row of micro-images, positive towards +y (down)."""

    def basis_px(self) -> Array:
        """Return the lattice vectors (x, y) as rows of a ``(2, 2)`` array (px): along a row, and to the next row."""

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        """Return the centres (row, column), ``(..., 2)``, of micro-images with indices q and r (px).

        The index q counts along a row of the lattice, and r counts the rows.
        """

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return the fractional lattice indices (q, r), ``(..., 2)``, of points of the frame (px)."""


class FrameLattice(MicroImageLattice, Protocol):
    """Protocol for lattices of micro-images that also state the shape of the frames."""

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the frames (px)."""


@dataclass(frozen=True, slots=True)
class CameraLattice:
    """The lattice in a camera's description, on the whole sensor."""

    camera: Camera

    @property
    def kind(self) -> str:
        """Kind of lattice: ``"square"`` or ``"hexagonal"``."""
        return self.camera.lattice.kind

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the sensor (px)."""
        return self.camera.sensor.shape

    @property
    def pitch_px(self) -> float:
        """Distance between adjacent micro-images along a row (px)."""
        return self.camera.pitch_px

    @property
    def row_pitch_px(self) -> float:
        """Distance between adjacent rows of micro-images (px)."""
        return self.camera.lattice.row_step_um / self.camera.sensor.pixel_um

    @property
    def rotation_rad(self) -> float:
        """Angle (rad) from the +x (column) axis to a row of micro-images, positive towards +y (down)."""
        return self.camera.lattice.rotation_rad

    def basis_px(self) -> Array:
        """Return the lattice vectors (x, y) as rows of a ``(2, 2)`` array (px): along a row, and to the next row."""
        return self.camera.lattice.basis_um() / self.camera.sensor.pixel_um

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        """Return the centres (row, column), ``(..., 2)``, of micro-images with indices q and r (px)."""
        return self.camera.pixels(self.camera.periodic.centres_um(q, r))

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return the fractional indices (q, r), ``(..., 2)``, of points of the frame (px); inverse of `centres_px`."""
        points = np.stack(np.broadcast_arrays(np.asarray(row, float), np.asarray(column, float)), axis=-1)
        inverse = np.linalg.inv(self.basis_px())
        index: Array = (points - self.centres_px(0, 0))[..., ::-1] @ inverse
        # a distorted lattice differs little from its basis: each iteration leaves a few per cent of the distance
        for _ in range(INVERSE_ROUNDS):
            off = points - self.centres_px(index[..., 0], index[..., 1])
            index = index + off[..., ::-1] @ inverse
            if not off.size or np.abs(off).max() < INVERSE_PX:
                break
        return index


@dataclass(frozen=True, slots=True)
class CroppedLattice:
    """The lattice ``whole`` on smaller frames of ``shape``, which show only a part of its frames.

    ``origin`` is the position (row, column) of the first pixel of the smaller frames in the frames of ``whole``.
    """

    whole: FrameLattice
    shape: tuple[int, int]
    origin: tuple[int, int]

    @property
    def kind(self) -> str:
        """Kind of lattice: ``"square"`` or ``"hexagonal"``."""
        return self.whole.kind

    @property
    def pitch_px(self) -> float:
        """Distance between adjacent micro-images along a row (px)."""
        return self.whole.pitch_px

    @property
    def row_pitch_px(self) -> float:
        """Distance between adjacent rows of micro-images (px)."""
        return self.whole.row_pitch_px

    @property
    def rotation_rad(self) -> float:
        """Angle (rad) from the +x (column) axis to a row of micro-images, positive towards +y (down)."""
        return self.whole.rotation_rad

    def basis_px(self) -> Array:
        """Return the lattice vectors (x, y) as rows of a ``(2, 2)`` array (px): along a row, and to the next row."""
        return self.whole.basis_px()

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        """Return the centres (row, column), ``(..., 2)``, of micro-images with indices q and r (px)."""
        centres: Array = self.whole.centres_px(q, r) - np.array(self.origin, float)
        return centres

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return the fractional lattice indices (q, r), ``(..., 2)``, of points of the frame (px)."""
        return self.whole.lenslet_at(np.asarray(row) + self.origin[0], np.asarray(column) + self.origin[1])


@dataclass(frozen=True, slots=True)
class TypeLattice:
    """Lattice of the lenslets of one of three types: hexagonal, with sqrt(3) times the pitch, and rotated by -30°.

    Lenslet (Q, R) of this lattice is lenslet (q, r) = ``(first + 2 Q + R, R - Q)`` of the lattice ``every``, which
    contains all lenslets; lenslet ``(first, 0)`` is of this type. The type depends on ``(q - r) mod 3``, which steps of
    (2, -1) and (1, 1) do not change.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import TypeLattice, lattice_of
    >>> one = TypeLattice(lattice_of(preset("r29")), first=0)
    >>> print(f"{one.pitch_px / one.every.pitch_px:.3f}", one.among([(0, 0), (1, 0), (2, 0), (3, 0)]))
    1.732 [(0, 0), (1, 1)]
    """

    every: FrameLattice
    first: int

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the frames (px)."""
        return self.every.shape

    @property
    def kind(self) -> str:
        """Kind of lattice, always ``"hexagonal"``."""
        return "hexagonal"

    @property
    def pitch_px(self) -> float:
        """Distance between adjacent micro-images along a row of this lattice (px)."""
        return float(np.hypot(*self.basis_px()[0]))

    @property
    def row_pitch_px(self) -> float:
        """Distance between adjacent rows of this lattice (px)."""
        return abs(float(np.linalg.det(self.basis_px()))) / self.pitch_px

    @property
    def rotation_rad(self) -> float:
        """Angle (rad) from the +x (column) axis to a row of this lattice, positive towards +y (down)."""
        x, y = self.basis_px()[0]
        return math.atan2(y, x)

    def basis_px(self) -> Array:
        """Return the lattice vectors (x, y) as rows of a ``(2, 2)`` array (px): along a row, and to the next row."""
        basis: Array = np.array([[2.0, -1.0], [1.0, 1.0]]) @ self.every.basis_px()
        return basis

    def centres_px(self, q: ArrayLike, r: ArrayLike) -> Array:
        """Return the centres (row, column), ``(..., 2)``, of micro-images (px); ``q`` and ``r`` are Q and R."""
        along, across = np.asarray(q), np.asarray(r)
        return self.every.centres_px(self.first + 2 * along + across, across - along)

    def lenslet_at(self, row: ArrayLike, column: ArrayLike) -> Array:
        """Return the fractional indices (Q, R) of this lattice, ``(..., 2)``, of points of the frame (px)."""
        return self._type_indices(*np.moveaxis(self.every.lenslet_at(row, column), -1, 0))

    def among(self, lenslets: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
        """Return the indices (Q, R) of the lenslets among ``lenslets`` (q, r) that are of this type."""
        mine = [(q, r) for q, r in lenslets if (q - r - self.first) % 3 == 0]
        return [(int(i), int(j)) for i, j in (self._type_indices(np.asarray(q), np.asarray(r)) for q, r in mine)]

    def _type_indices(self, q: NDArray[Any], r: NDArray[Any]) -> Array:
        return np.stack([(q - self.first - r) / 3, (q - self.first + 2 * r) / 3], axis=-1)


def lattice_of(
    camera: Camera, shape: Sequence[int] | None = None, origin: tuple[int, int] | None = None
) -> FrameLattice:
    """Return the micro-image lattice in a camera description, for frames of the complete sensor or of a part of it.

    Parameters
    ----------
    camera
        Description of the camera; no white image is required.
    shape
        Shape ``(rows, columns)`` of the frames. None: the shape of the sensor.
    origin
        Sensor position (row, column) of the first pixel of the frames, if they show only a part of the sensor. None:
        the frames show the complete sensor.

    Raises
    ------
    InputError
        If ``origin`` is None and ``shape`` differs from the shape of the sensor, or the frames extend beyond it.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import lattice_of
    >>> lattice = lattice_of(preset("bench"))
    >>> print(lattice.kind, round(lattice.pitch_px, 1), lattice.shape, lattice.centres_px(0, [0, 1]).round(2).tolist())
    hexagonal 11.0 (320, 320) [[159.5, 159.5], [169.03, 165.0]]
    """
    whole = CameraLattice(camera)
    return cropped(whole, whole.shape if shape is None else shape, origin)


def cropped(lattice: FrameLattice, shape: Sequence[int], origin: tuple[int, int] | None = None) -> FrameLattice:
    """Return ``lattice`` for the part of its frames that has this ``shape`` and begins at ``origin`` (row, column).

    If ``origin`` is None, ``shape`` must be the shape of the lattice, and ``lattice`` is returned.

    Raises
    ------
    InputError
        As in `lattice_of`.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import cropped, lattice_of
    >>> whole = lattice_of(preset("bench"))
    >>> part = cropped(whole, (40, 60), origin=(10, 20))
    >>> print(whole.centres_px(0, 0).round(1).tolist(), part.centres_px(0, 0).round(1).tolist())
    [159.5, 159.5] [149.5, 139.5]
    """
    part = (int(shape[0]), int(shape[1]))
    first = first_pixel(lattice.shape, part, origin)
    return lattice if origin is None else CroppedLattice(lattice, part, first)


def first_pixel(sensor: Sequence[int], shape: Sequence[int], origin: tuple[int, int] | None = None) -> tuple[int, int]:
    """Return ``origin``, the sensor position (row, column) of the first pixel of frames, after checking it.

    If ``origin`` is None, frames of ``shape`` must show the whole ``sensor`` (rows, columns), and (0, 0) is returned.

    Raises
    ------
    InputError
        As in `lattice_of`.
    """
    rows, columns = shape
    if origin is None:
        if (rows, columns) == tuple(sensor):
            return 0, 0
        raise InputError.expected(
            "frame",
            f"the {_by(sensor)} of the sensor",
            _by((rows, columns)),
            "give a whole frame, or the sensor row and column of its first pixel (--origin ROW,COLUMN)",
        )
    top, left = check_tuple("origin of the frame (row, column)", origin, 2, at_least=0, integer=True)
    if top + rows > sensor[0] or left + columns > sensor[1]:
        raise InputError.expected(
            "frame",
            f"a part of the {_by(sensor)} of the sensor",
            f"{_by((rows, columns))} starting at row {top}, column {left}",
            "correct its origin, or choose the camera that recorded it",
        )
    return top, left


def _by(shape: Sequence[int]) -> str:
    return f"{shape[0]} rows and {shape[1]} columns"


def type_lattice(lattice: FrameLattice, type_of: TypeOf, lens_type: int) -> TypeLattice:
    """Return the lenslets of one of three types as a separate, hexagonal lattice.

    ``type_of`` is a function that returns the types of lenslets (q, r): `LensTypes.type_of` or
    `LensletLattice.type_of`. ``lens_type`` is 0, 1 or 2.

    Raises
    ------
    InputError
        If the lattice is not hexagonal, or not exactly one of the lenslets (0, 0), (1, 0) and (2, 0) is of this type.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import TypeLattice, lattice_of, type_lattice
    >>> camera = preset("r29")
    >>> far: TypeLattice = type_lattice(lattice_of(camera), camera.lattice.type_of, 2)
    >>> print(f"{far.pitch_px:.1f} px, of all types {camera.pitch_px:.1f} px")
    54.9 px, of all types 31.7 px
    """
    found = [q for q in range(3) if lattice.kind == "hexagonal" and int(type_of(q, 0)) == lens_type]
    if len(found) != 1:
        raise InputError.expected(
            "lattice",
            f"a hexagonal lattice with a lens type {lens_type}",
            f"a {lattice.kind} lattice without it",
            "leave the lens types out",
        )
    return TypeLattice(lattice, found[0])
