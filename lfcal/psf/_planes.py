"""Sources of the values of H, one depth plane at a time: an array, a file, or the transpose of either."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lfcal.base import MAX_SAMPLE, FileFormatError, InputError, check_psf_shape
from lfcal.base.h5 import H5Data

__all__ = [
    "ArrayPlanes",
    "DatasetPlanes",
    "DerivedPlanes",
    "FilePlanes",
    "Planes",
    "ScaledPlanes",
    "TransposedPlanes",
    "as_planes",
    "as_stored",
]

Index = tuple[int | slice, ...]


@runtime_checkable
class Planes(Protocol):
    """The planes of one matrix ``(nz, ny, nx, nt, ns)``; returned arrays must not be modified."""

    shape: tuple[int, int, int, int, int]
    dtype: np.dtype[Any]

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as ``(ny, nx, nt, ns)``."""
        ...

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return the single pattern ``(nt, ns)`` of one position."""
        ...

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix, computed when they are read."""
        ...


@runtime_checkable
class DerivedPlanes(Protocol):
    """Planes that are computed from others: scaled, transposed, or in another order."""

    base: Planes


class ArrayPlanes:
    """Planes of an array or memory map."""

    def __init__(self, array: NDArray[Any]) -> None:
        self.array = array
        self.shape = _five(array.shape)
        self.dtype = array.dtype

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as a view."""
        view: NDArray[Any] = self.array[z]
        return view

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return one pattern as a view."""
        pattern: NDArray[Any] = self.array[z, y, x]
        return pattern

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix."""
        return TransposedPlanes(self)


class FilePlanes(ArrayPlanes):
    """Planes of an array or memory map from a file, whose values are checked when they are read."""

    def __init__(self, array: NDArray[Any], path: Path) -> None:
        super().__init__(array)
        self.path = path

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as a view; raise `FileFormatError` if it contains NaN or infinity."""
        plane = super().plane(z)
        _check_finite(plane, f"{self.path}, plane {z}")
        return plane

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return one pattern as a view; raise `FileFormatError` if it contains NaN or infinity."""
        pattern = super().cutout(z, y, x)
        _check_finite(pattern, f"{self.path}, position ({z}, {y}, {x})")
        return pattern


class DatasetPlanes:
    """Planes of an HDF5 dataset; the last plane read is kept, so memory is bounded by one plane."""

    def __init__(self, data: H5Data) -> None:
        self.dataset = data
        self.shape = _five(data.shape)
        self.dtype = data.dtype
        # threads share the kept plane: no other thread may replace it while it is being filled
        self._lock = threading.RLock()
        self._kept: tuple[int, NDArray[Any]] | None = None

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z``, read through all filters and checksums."""
        from lfcal.psf._chunk_codec import parallel_read

        with self._lock:
            if self._kept is None or self._kept[0] != z:
                self._kept = None  # free the old plane before taking memory for the new one: a plane may be several GB
                self._check_open()
                plane = parallel_read(self.dataset, z)
                _check_finite(plane, f"{self.dataset.where}, plane {z}")
                self._kept = (z, plane)
            return self._kept[1]

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return one pattern from the last plane read, or else from its chunk."""
        with self._lock:
            if self._kept is not None and self._kept[0] == z:
                pattern: NDArray[Any] = self._kept[1][y, x]
                return pattern
            self._check_open()
            pattern = self.dataset.read((z, y, x))
            _check_finite(pattern, f"{self.dataset.where}, position ({z}, {y}, {x})")
            return pattern

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix."""
        return TransposedPlanes(self)

    @property
    def path(self) -> Path:
        """Path of the file."""
        return self.dataset.path

    def close(self) -> None:
        """Close the file; may be called twice."""
        self.dataset.close_file()

    def _check_open(self) -> None:
        # h5py raises a bare ValueError on a closed file, which does not name the remedy
        if not self.dataset.is_open:
            raise FileFormatError("PSF matrix: the file is closed; open it again with open_psf")


def as_planes(data: Any) -> Planes:
    """Return the planes of an array of numbers, a memory map, a dataset, or an object that already provides planes.

    Raises
    ------
    InputError
        If ``data`` does not contain numbers.
    """
    if isinstance(data, H5Data):
        return DatasetPlanes(data)
    if isinstance(data, Planes):
        return data
    # recognised by its attributes: importing h5py here would slow down every use of an array
    if hasattr(data, "id") and hasattr(data, "chunks") and hasattr(data, "file"):
        return DatasetPlanes(H5Data(data, holes=True))
    array = data if isinstance(data, np.ndarray) else np.asarray(data)
    if array.dtype.kind not in "iufcb":
        raise InputError.expected("PSF matrix", "numbers", f"dtype {array.dtype}", "convert the array to numbers")
    return ArrayPlanes(array)


def as_stored(planes: Planes) -> Planes:
    """Return planes as they are stored, before scales, transposes and the order of another code are applied."""
    while isinstance(planes, DerivedPlanes):
        planes = planes.base
    return planes


def _five(shape: tuple[int, ...]) -> tuple[int, int, int, int, int]:
    """Return the shape of planes, after checking the number of axes."""
    nz, ny, nx, nt, ns = shape if len(shape) == 5 else check_psf_shape(shape)
    return nz, ny, nx, nt, ns


def _check_finite(values: NDArray[Any], where: str) -> None:
    """Raise `FileFormatError` if ``values`` ``(…, nt, ns)`` contain NaN, infinity, or impossible counts."""
    if values.dtype.kind not in "fc":
        return
    # minimum and maximum are NaN if any value is, and need no additional array
    parts = (values.real, values.imag) if values.dtype.kind == "c" else (values,)
    ends = [end for part in parts for end in (part.max(axis=(-2, -1)), -part.min(axis=(-2, -1)))]
    with np.errstate(invalid="ignore"):  # converting some kinds of NaN warns
        largest = np.maximum.reduce([end.astype(np.float64) for end in ends])
    good = largest <= MAX_SAMPLE
    if good.all():
        return
    bad = tuple(int(k) for k in np.argwhere(~good)[0])
    place = f", position {bad}" if bad else ""
    got = f"{largest[bad]:.3g}" if np.isfinite(largest[bad]) else "NaN or infinity"
    raise FileFormatError.expected(
        f"{where}{place}", f"finite values up to {MAX_SAMPLE:g}", got, "set values that were not measured to 0"
    )


class TransposedPlanes:
    """The transpose of other planes: HT[z, y, x, t, s] = H[z, (y+t-ct) % ny, (x+s-cs) % nx, nt-1-t, ns-1-s]."""

    def __init__(self, base: Planes) -> None:
        self.base = base
        self.shape = base.shape
        self.dtype = base.dtype

    def plane(self, z: int) -> NDArray[Any]:
        """Return the transposed plane as a new array."""
        from lfcal.psf._transpose import transpose

        turned: NDArray[Any] = transpose(self.base.plane(z)[None])[0]
        return turned

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return one pattern of HT without building HT."""
        from lfcal.psf._transpose import ht_slice

        _, ny, nx, _, _ = self.shape
        if ny == nx == 1:  # a single position: HT is H turned by half a turn, no plane is needed
            return self.base.cutout(z, 0, 0)[::-1, ::-1]
        return ht_slice(self.base.plane(z), y, x)

    def transposed(self) -> Planes:
        """Return the planes of which these are the transpose."""
        return self.base


class ScaledPlanes:
    """Planes with the values stored * scale[z] + offset[z], as float32."""

    def __init__(self, base: Planes, scale: NDArray[np.float64], offset: NDArray[np.float64]) -> None:
        self.base, self.scale, self.offset = base, scale, offset
        self.shape = base.shape
        self.dtype = np.dtype(np.float32)

    def _values(self, stored: NDArray[Any], z: int) -> NDArray[np.float32]:
        with np.errstate(over="ignore"):  # only for stored floats; integers were checked when the file was opened
            values = stored.astype(np.float32)
            # in place: a plane may be several GB
            values *= np.float32(self.scale[z])
            values += np.float32(self.offset[z])
        if stored.dtype.kind == "f":
            _check_finite(values, f"plane {z}, scaled")
        return values

    def plane(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as float32."""
        return self._values(self.base.plane(z), z)

    def cutout(self, z: int, y: int, x: int) -> NDArray[Any]:
        """Return one pattern as float32."""
        return self._values(self.base.cutout(z, y, x), z)

    def transposed(self) -> Planes:
        """Return the planes of the transposed matrix: transposed as stored, scaled afterwards."""
        return ScaledPlanes(self.base.transposed(), self.scale, self.offset)
