"""Import H from calibration files (``.lfc``) of napari-LF, which contain a sparse PSF for each voxel of a lenslet.

A file is HDF5 with the groups ``optics``, ``geometry``, ``radiometry``, ``rayspread`` and ``psf``. ``psf/psf_db`` is a
pickled table ``(x, y, z) -> ((u, v, s, t), coefficient)``: pixel (u, v) behind lenslet (s, t), relative to the lenslet
of the voxel. Each lenslet has n x n voxels.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, centre
from lfcal.base.h5 import H5File
from lfcal.psf._plain_pickle import Record, load_plain
from lfcal.psf._planes import Planes, TransposedPlanes
from lfcal.psf.matrix import PSFMatrix

__all__ = ["open_lfc"]

Splat = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]
"""Rows and columns of the lit pixels, from the first pixel of the voxel's lenslet, and their light."""

MOST_PIXELS = 1 << 12
"""Largest distance of a pixel from its lenslet (pixels); no optics spread light further."""


def open_lfc(path: Path) -> PSFMatrix:
    """Open the PSFs of a napari-LF calibration as an H in float32, whose planes are computed when they are read.

    The period of H is a lenslet of ``nv`` x ``nu`` pixels. All pixels of a voxel have the same pattern, so the image of
    a volume is that of the volume summed over each voxel. The sign of the depths is reversed:
    napari-LF counts them towards the objective.

    Raises
    ------
    FileFormatError, UnsafeFileError
        If the file contains no PSFs (the message states what it contains), or they are damaged.
    """
    with H5File(path) as file:
        name = "psf/psf_db"
        if "psf" not in file or name not in file:
            raise _nothing(file)
        stored = file.values(name, kinds="u")
    where = f"{path}:/{name}"
    table = load_plain(stored.astype(np.uint8).tobytes(), frozenset({"PsfDatabase"}), where)
    if not isinstance(table, Record):
        raise _wrong(where, "a PsfDatabase", type(table).__name__)
    return _Table(table.values, where).matrix(path)


def _nothing(file: H5File) -> FileFormatError:
    """Return the error for a file without PSFs, which states what the file contains."""
    parts = [name for name in ("optics", "geometry", "radiometry", "rayspread") if name in file]
    held = " and ".join(parts) or ", ".join(file.names()[:8]) or "nothing"
    if "rayspread" in file and "rayspread_db" in file.names("rayspread"):
        held += " (ray optics)"
    remedy = "calibrate again in napari-LF with its wave optics model, or simulate the camera from its optics"
    return FileFormatError.expected(str(file.path), "PSFs (psf/psf_db)", f"only {held}", remedy)


class _Table:
    """The table of one file."""

    def __init__(self, values: dict[str, Any], where: str) -> None:
        self._values, self._where = values, where
        self._nu, self._nv = self._count("nu"), self._count("nv")
        self._share = self._count("supersample_factor")
        if self._share > min(self._nu, self._nv):
            raise _wrong(where, f"up to {min(self._nu, self._nv)} voxels across a lenslet", self._share)
        self._depths = -self._z_coords()

    def matrix(self, path: Path) -> PSFMatrix:
        """Return H."""
        keys = np.ndindex(self._share, self._share, self._depths.size)
        planes = _SplatPlanes({key: self._splat(key) for key in keys}, (self._nv, self._nu), self._share)
        return PSFMatrix(planes, depths=self._depths, provenance=self._provenance(path))

    def _splat(self, key: tuple[int, ...]) -> Splat:
        """Return the pixels that a voxel lights."""
        at, light = (_table(self._values, f"psf_{name}").get(key) for name in ("coordinates", "coefficients"))
        wanted = f"(u, v, s, t) and a finite coefficient for each pixel of voxel {key}"
        if not isinstance(at, np.ndarray) or not isinstance(light, np.ndarray):
            raise _wrong(self._where, wanted, "none")
        good = at.ndim == 2 and at.shape[1:] == (4,) and at.dtype.kind in "iu" and light.shape == at.shape[:1]
        if not good or light.dtype.kind != "f" or not np.isfinite(light).all():
            raise _wrong(self._where, wanted, f"shapes {at.shape} and {light.shape}")
        # the absolute value of the smallest integer overflows
        near = at.size == 0 or (int(at.min()) >= -MOST_PIXELS and int(at.max()) <= MOST_PIXELS)
        u, v, s, t = (at if near else np.zeros((1, 4))).astype(np.int64).T
        reach = max(int(np.abs(t).max(initial=0)) * self._nv, int(np.abs(s).max(initial=0)) * self._nu)
        if not near or reach > MOST_PIXELS:
            raise _wrong(self._where, "pixels near their lenslet", "pixels far beyond any sensor")
        return t * self._nv + v, s * self._nu + u, light.astype(np.float32)

    def _z_coords(self) -> NDArray[np.float64]:
        given = self._values.get("z_coords")
        numbers = list(given) if isinstance(given, list | tuple | np.ndarray) else []
        good = bool(numbers) and all(_finite(v) for v in numbers)
        if not good or len({float(v) for v in numbers}) < len(numbers):
            raise _wrong(self._where, "z_coords, a depth for each plane", given)
        return np.array(numbers, np.float64)

    def _count(self, name: str) -> int:
        value = self._values.get(name)
        if not isinstance(value, int | float) or value != value // 1 or not 1 <= value <= 1000:
            raise _wrong(self._where, f"{name}, a whole number from 1 to 1000", value)
        return int(value)

    def _provenance(self, path: Path) -> dict[str, Any]:
        share = self._share
        notes = [f"the {share} x {share} voxels of each lenslet were spread over its {self._nv} x {self._nu} pixels"]
        lens = [(self._nv - 1) / 2, (self._nu - 1) / 2]
        return {"imported": path.name, "lens_centre": lens, "notes": notes}


def _finite(value: object) -> bool:
    """Return whether a value is a finite number in the range of floats."""
    try:
        return isinstance(value, int | float | np.integer | np.floating) and math.isfinite(value)
    except OverflowError:
        return False


def _table(values: dict[str, Any], name: str) -> dict[Any, Any]:
    found = values.get(name)
    return found if isinstance(found, dict) else {}


def _wrong(where: str, wanted: str, got: object) -> FileFormatError:
    return FileFormatError.expected(where, wanted, got, "get the file from its source again")


class _SplatPlanes:
    """Planes made from splats ``(x, y, z)`` of the voxels of a lenslet when they are read."""

    def __init__(self, splats: dict[tuple[int, ...], Splat], period: tuple[int, int], share: int) -> None:
        ny, nx = period
        self._splats = splats
        # a pixel belongs to the voxel that contains its centre
        self._rows, self._columns = ((2 * np.arange(n) + 1) * share // (2 * n) for n in period)
        reach = [0, 0]
        for (x, y, _), splat in splats.items():
            for axis, (lit, own) in enumerate(((splat[0], self._rows == y), (splat[1], self._columns == x))):
                at = np.flatnonzero(own)[[0, -1]]
                reach[axis] = max(reach[axis], int(np.abs(lit[:, None] - at).max(initial=0)))
        nz = len(splats) // share**2
        self.shape = (nz, ny, nx, 2 * reach[0] + 1, 2 * reach[1] + 1)
        self.dtype = np.dtype(np.float32)

    def plane(self, z: int) -> NDArray[np.float32]:
        """Return plane ``z`` as a new array."""
        plane = np.empty(self.shape[1:], np.float32)
        for y, x in np.ndindex(*plane.shape[:2]):
            plane[y, x] = self.cutout(z, y, x)
        return plane

    def cutout(self, z: int, y: int, x: int) -> NDArray[np.float32]:
        """Return the pattern of one position as a new array."""
        nt, ns = self.shape[3:]
        rows, columns, light = self._splats[int(self._columns[x]), int(self._rows[y]), z]
        pattern = np.zeros((nt, ns), np.float32)
        np.add.at(pattern, (rows - y + centre(nt), columns - x + centre(ns)), light)
        return pattern

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix."""
        return TransposedPlanes(self)
