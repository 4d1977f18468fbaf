"""Write H files plane by plane; an incomplete file never gets its final name.

This is version 4 of the format; ``docs/files.md`` describes it for other programs. A stored zero means value zero,
and one number scales the whole matrix, so every HDF5 reader shows the correct shapes and ratios.
"""

from __future__ import annotations

import json
import math
import os
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import AXES, InputError, for_each_chunk, full_version, require_space
from lfcal.base.h5 import new_h5, require_codecs
from lfcal.camera import Camera
from lfcal.psf._chunk_codec import chunk_pipeline, copy_plane, parallel_write
from lfcal.psf._nexus import mark_default_plot
from lfcal.psf._step_kernels import add_rounded, round_pattern
from lfcal.psf._steps import bits_at_most, bound_after, step_of_range, stepped_plane
from lfcal.psf.facts import Facts, stacked
from lfcal.psf.layout import ROUNDED, STORED_TYPES, Header, Plane, Stored, StoredPlane
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.provenance import with_simulated

__all__ = [
    "CENTRE_RULE",
    "CHECKED_VERSION",
    "FORMAT",
    "PLANE_NUMBER",
    "REGIONS",
    "STEPPED_VERSION",
    "STORED_TYPES",
    "VERSION",
    "MatrixGroup",
    "PSFWriter",
    "check_storable",
    "facts_of",
    "header_of",
    "new_file",
    "plane_checksum",
    "store_plane",
    "stored_bytes",
    "stored_type",
]

FORMAT = "lfcal-psf"
VERSION = 4
STEPPED_VERSION = 3
"""Version in which patterns are stored as numbers of steps, each pattern with a separate step and zero."""
CHECKED_VERSION = 2
"""First version with checksums and a specification."""
ROUNDED_BITS = 21
"""Largest number of bits of an entry of a rounded H: 17 for the number of steps, the rest for sign and exponent."""
REGIONS = "regions"
"""Group that contains the matrices of further regions of the field, by name."""
CENTRE_RULE = "(n - 1) // 2"
CHECKSUM_RULE = "CRC-32 over the little-endian CRC-32 of every stored pattern, y slow, x fast"
PLANE_NUMBER = "plane"
"""Unit of depths if none are stated: plane numbers."""
VALUE_S = 3e-8
"""Processor time per value (s) by which rounding by numpy is slower than by a compiled kernel."""
UNCERTAINTY_DIGITS = 8
"""Binary digits of a stored standard deviation, which is rounded up by 1/128 at most."""

Convert = Callable[[NDArray[Any]], NDArray[Any]]


class MatrixGroup:
    """Writer of one matrix into an open HDF5 group: write the planes in any order, then call `complete`.

    Parameters
    ----------
    group
        Group, or the file itself.
    header
        Description of the matrix without its values.
    stored
        Type, compression and tolerance of the stored values.
    workers
        Number of threads. None: one for each available CPU core.
    """

    def __init__(self, group: Any, header: Header, stored: Stored, workers: int | None = None) -> None:
        self._group, self._header, self._stored, self._workers = group, header, stored, workers
        nz = header.shape[0]
        self._written = np.zeros(nz, bool)
        self._checksum = np.zeros(nz, np.uint32)
        self._error = np.full(nz, np.nan)
        self._used = np.zeros((nz, 4), np.int32)
        self._sums = np.zeros((nz, *header.shape[3:]))
        self._facts = [Facts()] * nz
        self._provenance = dict(header.provenance)
        self._simulated: dict[int, Mapping[str, Any]] = {}
        self._uncertainty: Any = None
        self._uncertain = np.zeros(nz, bool)
        self._step = np.zeros(header.shape[:3], np.float32)
        self._data = self._create_dataset("H", stored.samples)

    @property
    def lacking(self) -> list[int]:
        """Indices of the planes that have not been written yet."""
        return np.flatnonzero(~self._written).tolist()

    def _create_dataset(self, name: str, dtype: np.dtype[Any]) -> Any:
        header, compression = self._header, self._stored.compression
        options: dict[str, Any] = {"fletcher32": True}
        if compression == "gzip":
            options |= {"shuffle": True, "compression": "gzip", "compression_opts": 1}
        elif compression == "zstd":
            require_codecs("compression zstd of H")
            import hdf5plugin

            options |= {"shuffle": True} | dict(hdf5plugin.Zstd(clevel=3))
        chunk = (1, 1, 1, *header.shape[3:])
        return self._group.create_dataset(name, header.shape, dtype, chunks=chunk, track_times=False, **options)

    def write_plane(self, z: int, plane: Plane) -> None:
        """Write ``plane``, with its facts, as plane ``z``."""
        self._write_values(z, plane.values, plane.facts)
        if plane.uncertainty is not None:
            self._write_uncertainty(z, plane.uncertainty)
        if plane.simulated is not None:
            self._simulated[z] = dict(plane.simulated)

    def _write_values(self, z: int, plane: NDArray[Any], facts: Facts) -> None:
        from lfcal.psf._transpose import depth_sum

        shape = self._header.shape
        if plane.shape != shape[1:]:
            raise InputError.expected(
                f"plane {z}", f"shape {shape[1:]}", plane.shape, "check how the plane was assembled"
            )
        if not 0 <= z < shape[0] or self._written[z]:
            raise InputError.expected("plane number", "each number once", z, "write every plane once")
        if plane.dtype.kind == "c":
            raise InputError.expected(
                f"plane {z}",
                "real numbers",
                f"{plane.dtype}",
                "export a complex H as a .npy file, or store its real and imaginary parts separately",
            )
        sums = depth_sum(plane, workers=self._workers)
        if not np.isfinite(sums).all():
            raise InputError.expected(
                f"plane {z}", "finite values", "NaN or infinity", "find the frame with this value and record it again"
            )
        if self._stored.store_tolerance is not None:
            self._write_steps(z, plane, facts, self._stored.store_tolerance)
            return
        self._used[z] = _used_window(sums)
        convert, step = self._conversion(z, plane)
        error = 0.0
        self._sums[z] = sums
        if step:
            # the stored sums are computed from the stored values
            self._step[z] = step
            self._sums[z], error = _rounded_sums(plane, step, self._workers)
        each = np.zeros(shape[1:3], "<u4")
        parallel_write(self._data, z, plane, convert=convert, checksums=each, workers=self._workers)
        self._checksum[z] = zlib.crc32(each.data)
        self._note(z, facts, error)
        self._written[z] = True

    def _write_steps(self, z: int, plane: NDArray[Any], facts: Facts, tolerance: float) -> None:
        """Write plane ``z``, rounded to whole steps, within a tolerance."""
        from lfcal.psf._transpose import depth_sum

        workers = self._workers
        found = stepped_plane(plane, tolerance, what=f"plane {z}", workers=workers)
        self._step[z] = found.step
        self._sums[z] = depth_sum(found.values, workers=workers)
        self._used[z] = _used_window(self._sums[z])
        each = np.zeros(plane.shape[:2], "<u4")
        parallel_write(self._data, z, found.values, checksums=each, workers=workers)
        self._checksum[z] = zlib.crc32(each.data)
        self._note(z, facts, found.error, bound_after(facts.bound, found.bound))
        self._written[z] = True

    def note(self, provenance: Mapping[str, Any]) -> None:
        """Add entries to the provenance, or replace those with the same names; `complete` writes it."""
        self._provenance |= provenance

    def _write_uncertainty(self, z: int, plane: NDArray[np.floating[Any]]) -> None:
        """Write the standard deviation of every entry of plane ``z`` ``(ny, nx, nt, ns)``; 0: not stated.

        Values are rounded up to `UNCERTAINTY_DIGITS` binary digits, so that none becomes 0.
        """
        if plane.shape != self._header.shape[1:]:
            raise InputError.expected(
                f"uncertainty of plane {z}",
                f"shape {self._header.shape[1:]}",
                plane.shape,
                "give one value for each entry",
            )
        low, largest = _range(plane, self._workers)
        if not (np.isfinite(largest) and low >= 0):
            raise InputError.expected(
                f"uncertainty of plane {z}",
                "finite values of 0 or more",
                f"values from {low:g} to {largest:g}",
                "check how the uncertainty was computed",
            )
        if self._uncertainty is None:
            self._uncertainty = self._create_dataset("uncertainty", np.dtype(np.float32))
        parallel_write(self._uncertainty, z, plane, convert=_rounded_up, workers=self._workers)
        self._uncertain[z] = True

    def adopt_plane(self, z: int, stored: StoredPlane) -> None:
        """Copy ``stored``, a plane of another file, to plane ``z`` without decompressing or rounding it again."""
        if stored.data.shape[1:] != self._header.shape[1:] or self._written[z]:
            raise InputError.expected(
                f"plane {z}",
                f"shape {self._header.shape[1:]}, not written before",
                stored.data.shape,
                "write each plane once, with the shape of the others",
            )
        copy_plane(stored.data, self._data, z)
        self._sums[z], self._used[z], self._error[z] = stored.sums, stored.used, stored.error
        self._checksum[z], self._facts[z] = stored.checksum, stored.facts
        if stored.step is not None:
            self._step[z] = stored.step
        if stored.uncertainty is not None:
            if self._uncertainty is None:
                self._uncertainty = self._create_dataset("uncertainty", np.dtype(np.float32))
            copy_plane(stored.uncertainty, self._uncertainty, z)
            self._uncertain[z] = True
        if stored.simulated is not None:
            self._simulated[z] = dict(stored.simulated)
        self._written[z] = True

    def _complete_uncertainty(self) -> None:
        if self._uncertainty is None:
            return
        none = np.broadcast_to(np.zeros((), np.float32), self._header.shape[1:])
        for z in np.flatnonzero(~self._uncertain).tolist():
            parallel_write(self._uncertainty, z, none, workers=self._workers)
        self._uncertainty.attrs["long_name"] = "standard deviation of each entry of H; 0: none is stated"

    def _note(self, z: int, facts: Facts, rounding: float, bound: NDArray[np.float64] | None = None) -> None:
        known = facts.known()
        if bound is not None:
            known["bound"] = bound
        elif rounding > 0:  # values rounded to the step of the plane have no bound for each pattern
            known.pop("bound", None)
        stated = known.pop("error", None)
        errors = [e for e in (rounding, np.nan if stated is None else float(stated)) if np.isfinite(e)]
        # the error of rounding alone must not replace an unknown error
        if errors and (rounding > 0 or (stated is not None and np.isfinite(stated))):
            self._error[z] = sum(errors)
        known.setdefault("recorded", np.ones(self._header.shape[1:3], np.uint16))
        self._facts[z] = Facts(**known)

    def _conversion(self, z: int, plane: NDArray[Any]) -> tuple[Convert | None, float]:
        """Return the function that converts patterns of plane ``z`` to their stored type, and the step of rounding.

        The function is None if nothing is converted. The step is 0 without rounding.
        """
        dtype = self._stored.samples
        if self._stored.rounded:
            low, high = _range(plane, self._workers)
            step = step_of_range(low, high)
            # float32 also represents whole numbers above 16 bits
            step = 1.0 if step > 1 and max(-low, high) < 2**24 and _whole(plane) else step
            return (partial(_rounded, step=step), step) if step else (_single, 0.0)
        if plane.dtype == dtype:
            return None, 0.0
        if dtype.kind == "f":
            return (lambda pattern: pattern.astype(dtype)), 0.0
        low, high = _range(plane, self._workers)
        if low < 0 or high > np.iinfo(dtype).max or not _whole(plane):
            raise InputError.expected(
                f"plane {z}, stored as {dtype}",
                f"whole numbers from 0 to {np.iinfo(dtype).max}",
                f"other values, from {low:.6g} to {high:.6g}",
                f"store the values as {ROUNDED} or float32 (--dtype)",
            )
        return (lambda pattern: pattern.astype(dtype)), 0.0

    def complete(self) -> None:
        """Write depths, facts, sums and attributes; all planes must have been written before."""
        group, header = self._group, self._header
        self._complete_uncertainty()
        if self._simulated:
            planes = [self._simulated.get(z) for z in range(header.shape[0])]
            self._provenance = with_simulated(self._provenance, planes)
        group.create_dataset("depth_sum", data=self._sums)
        known = not np.isnan(header.plane_depths).any()
        stored = header.plane_depths if known else np.arange(header.shape[0], dtype=np.float64)
        depths = group.create_dataset("depths", data=stored)
        depths.attrs["unit"] = "um" if known else PLANE_NUMBER
        for name, values in stacked(self._facts).known().items():
            group.create_dataset(name, data=values, compression="gzip")
        if self._step.any():
            step = group.create_dataset("step", data=self._step, compression="gzip")
            step.attrs["long_name"] = "all values of a pattern are whole multiples of its step; 0: of none"
        group.create_dataset("used_window", data=self._used).attrs["columns"] = "t_first,t_last,s_first,s_last"
        group.create_dataset("checksum", data=self._checksum).attrs["rule"] = CHECKSUM_RULE
        group.create_dataset("error", data=self._error).attrs["measure"] = "sum |error| / sum |H| of the plane"
        counts = "frames" in self._provenance
        name = "HT" if header.transposed else "H"
        self._data.attrs.update(
            {
                "scaling_factor": 1.0,
                "units": "counts" if counts else "",
                "long_name": f"{name}{' (counts)' if counts else ''}; value = stored * scaling_factor",
            }
        )
        group.attrs.update(
            {
                "matrix": "HT" if header.transposed else "H",
                "axes": ",".join(AXES),
                "centre": CENTRE_RULE,
                "anchor": np.asarray(header.anchor, np.float64),
                "region": header.region,
                "provenance": json.dumps({"lfcal": full_version(), **self._provenance}),
            }
        )
        if header.camera is not None:
            group.attrs["camera"] = header.camera.to_json()


class PSFWriter:
    """Writer of an H file, plane by plane; the file appears under its name only when all planes are complete.

    Use it as a context manager. Each chunk of the file is one pattern, ``(1, 1, 1, nt, ns)``, and has a checksum.
    Chunks are compressed in parallel.

    Parameters
    ----------
    path
        Path of the file to write; an existing file is replaced when all planes are complete.
    shape
        Shape ``(nz, ny, nx, nt, ns)`` of the matrix.
    depths, camera, anchor, provenance, region
        As in `PSFMatrix`.
    dtype
        Stored type: ``"float32"``, ``"float64"``, ``"rounded"``, or, for whole numbers within their range, ``"uint16"``
        or ``"uint8"``. ``"rounded"`` is float32 in multiples of a power of two that is at most 1/65535 of the range of
        the plane. It needs about a third of the space of float32, and its error is stored. A plane of whole numbers
        below 2^24 is preserved exactly.
    compression
        Compression: ``"gzip"`` (level 1 with the shuffle filter), ``"zstd"`` or ``"none"``.
    transposed
        Whether the planes are those of the transposed matrix HT.
    workers
        Number of threads for compression. None: one for each available CPU core.
    store_tolerance
        Largest relative L1 error of a pattern that lossy storage may cause, between 0 and 1. Patterns are cropped and
        rounded within it, and ``dtype`` is ignored. The largest error in each plane is stored (``bound`` of `Facts`).
        None: no loss beyond that of ``dtype``.

    Raises
    ------
    InputError
        If an argument is invalid, ``store_tolerance`` is set for HT, or ``dtype`` cannot store a value. Also if a
        plane does not have the shape of the matrix, is not finite, is written twice, or is missing at the end.
    StorageError
        If the disk is full or the file cannot be written.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFWriter, open_psf
    >>> with PSFWriter("new.h5", (2, 3, 3, 5, 5), depths=[-50, 50]) as writer:
    ...     for z in range(2):
    ...         writer.write_plane(z, np.full((3, 3, 5, 5), 10 * z + 1, np.float32))
    >>> with open_psf("new.h5") as H:
    ...     print(H.depths.tolist(), H[:, 0, 0, 2, 2].tolist())
    [-50.0, 50.0] [1.0, 11.0]
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        shape: tuple[int, ...],
        *,
        depths: ArrayLike | None = None,
        camera: Camera | None = None,
        anchor: tuple[float, float] = (0.0, 0.0),
        dtype: str = "float32",
        compression: str = "gzip",
        provenance: Mapping[str, Any] | None = None,
        transposed: bool = False,
        region: str = "",
        workers: int | None = None,
        store_tolerance: float | None = None,
    ) -> None:
        self.path = Path(path)
        self._header = Header(shape, depths, camera, anchor, dict(provenance or {}), transposed, region)
        self._stored, self._workers = Stored(dtype, compression, store_tolerance), workers
        check_storable(self._header, self._stored)
        self._stack = ExitStack()

    @classmethod
    def of(
        cls, path: str | os.PathLike[str], header: Header, stored: Stored | None = None, workers: int | None = None
    ) -> Self:
        """Return a writer for a matrix described by ``header`` and stored as in ``stored`` (None: the defaults)."""
        return cls(path, **vars(header), **vars(stored or Stored()), workers=workers)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape ``(nz, ny, nx, nt, ns)`` of the matrix."""
        return self._header.shape

    def __enter__(self) -> Self:
        """Create the scratch file next to the target."""
        require_space(self.path.parent, stored_bytes(self.shape, self._stored), what=self.path.name)
        try:
            self._file = self._stack.enter_context(new_file(self.path))
            self._matrix = MatrixGroup(self._file, self._header, self._stored, self._workers)
        except BaseException as error:
            self._stack.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def write_plane(
        self,
        z: int,
        plane: NDArray[Any],
        *,
        recorded: ArrayLike | None = None,
        saturated: ArrayLike | None = None,
        facts: Facts | None = None,
        uncertainty: NDArray[np.floating[Any]] | None = None,
        simulated: Mapping[str, Any] | None = None,
    ) -> None:
        """Write the values of plane ``z``, an array ``(ny, nx, nt, ns)``, with its facts.

        ``recorded`` and ``saturated`` are the numbers of frames and of saturated pixels for each position, ``(ny,
        nx)``. None: one frame, and unknown saturation. ``facts`` replaces both and may contain more. ``uncertainty`` is
        the standard deviation of every entry in the shape of ``plane``, 0 where only the noise is known. ``simulated``
        describes how the plane was simulated, as plain JSON types.
        """
        if facts is None:
            _, ny, nx, nt, ns = self.shape
            facts = Facts.of((ny, nx), (nt, ns), recorded=recorded, saturated=saturated)
        self.write(z, Plane(plane, facts, uncertainty, simulated))

    def write(self, z: int, plane: Plane) -> None:
        """Write ``plane``, with its facts, as plane ``z``."""
        self._matrix.write_plane(z, plane)

    def adopt_plane(self, z: int, stored: StoredPlane) -> None:
        """Copy the compressed data and the facts of ``stored``, a plane of another file, unchanged to plane ``z``."""
        self._matrix.adopt_plane(z, stored)

    def note(self, provenance: Mapping[str, Any]) -> None:
        """Add entries (plain JSON types) to the provenance before the end of the context, or replace existing ones."""
        self._matrix.note(provenance)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the file and rename it to its final name, or remove it after an error."""
        if error is None and self._matrix.lacking:
            lacking = self._matrix.lacking[:5]
            error = InputError.expected(
                str(self.path), "all planes written", f"a file without planes {lacking}", "write these planes"
            )
            self._stack.__exit__(type(error), error, None)
            raise error
        try:
            if error is None:
                self._matrix.complete()
                mark_default_plot(self._file)
        except BaseException as failure:
            self._stack.__exit__(type(failure), failure, failure.__traceback__)
            raise
        self._stack.__exit__(kind, error, trace)


@contextmanager
def new_file(path: Path) -> Iterator[Any]:
    """Yield a new HDF5 file to write to; it is renamed to ``path`` after the block, or removed after an error."""
    with new_h5(path) as file:
        file.attrs.update({"format": FORMAT, "version": VERSION, "creator": f"lfcal {full_version()}"})
        yield file


def check_storable(header: Header, stored: Stored) -> None:
    """Raise `InputError` if a storage tolerance is set for HT."""
    if header.transposed and stored.store_tolerance is not None:
        raise InputError.expected(
            "storage tolerance",
            "H, because the tolerance limits the error of its patterns",
            "HT",
            "store H, and derive HT from it",
        )


def stored_bytes(shape: tuple[int, ...], stored: Stored) -> int:
    """Return an upper estimate of the size (bytes) of the values of H in a file, without metadata or uncertainties."""
    size = int(np.prod(shape, dtype=np.int64))
    if stored.store_tolerance is None and not stored.rounded:
        return size * stored.samples.itemsize
    bits = ROUNDED_BITS if stored.store_tolerance is None else bits_at_most(stored.store_tolerance)
    return math.ceil(size * (32 if stored.compression == "none" else bits) / 8)


def store_plane(data: Any, z: int, plane: NDArray[Any], *, workers: int | None = None) -> None:
    """Write one plane ``(ny, nx, nt, ns)`` into an HDF5 dataset, compressed by several threads if possible."""
    if chunk_pipeline(data) is None:
        data[z] = plane
        return
    parallel_write(data, z, plane, workers=workers)


def stored_type(matrix: PSFMatrix) -> str:
    """Return the default stored type of ``matrix``: its own dtype if an H file supports it, else ``"float32"``."""
    return matrix.dtype.name if matrix.dtype.name in STORED_TYPES else "float32"


def header_of(matrix: PSFMatrix) -> Header:
    """Return the description of ``matrix`` without its values."""
    return Header(
        matrix.shape,
        matrix.known_depths,
        matrix.camera,
        matrix.anchor,
        matrix.provenance,
        matrix.is_transposed,
        matrix.region,
    )


def facts_of(matrix: PSFMatrix) -> Facts:
    """Return the facts about the positions of H, whether ``matrix`` is H or HT."""
    return matrix.T.facts if matrix.is_transposed else matrix.facts


def plane_checksum(stored: NDArray[Any], workers: int | None = None) -> int:
    """Return the checksum of a plane ``(ny, nx, nt, ns)`` of stored samples.

    It is a CRC-32 over the CRC-32 values of all patterns. Patterns can therefore be checked separately and in parallel.
    ``workers`` is the number of threads; None: one for each available CPU core.
    """
    ny, nx = stored.shape[:2]
    each = np.zeros((ny, nx), "<u4")
    little = stored.dtype.newbyteorder("<")

    def rows(start: int, stop: int) -> None:
        for y in range(start, stop):
            row = np.ascontiguousarray(stored[y], little)
            for x in range(nx):
                each[y, x] = zlib.crc32(row[x].data)

    for_each_chunk(rows, ny, workers)
    return zlib.crc32(each.data)


def _used_window(sums: NDArray[np.float64]) -> tuple[int, int, int, int]:
    """Return first and last row and column of the lit part of the cutout; (0, -1, 0, -1) without light."""
    rows, columns = np.flatnonzero(sums.any(axis=1)), np.flatnonzero(sums.any(axis=0))
    if not rows.size:
        return 0, -1, 0, -1
    return int(rows[0]), int(rows[-1]), int(columns[0]), int(columns[-1])


def _range(plane: NDArray[Any], workers: int | None) -> tuple[float, float]:
    """Return lowest and highest value of a plane."""

    def rows(start: int, stop: int) -> tuple[float, float]:
        # pattern by pattern, so that each is loaded into the cache only once
        low, high = np.inf, -np.inf
        for pattern in plane[start:stop].reshape(-1, plane[0, 0].size):
            low, high = min(low, float(pattern.min())), max(high, float(pattern.max()))
        return low, high

    found = for_each_chunk(rows, plane.shape[0], workers)
    return min(f[0] for f in found), max(f[1] for f in found)


def _whole(plane: NDArray[Any]) -> bool:
    """Return whether all values of a plane are whole numbers."""
    return plane.dtype.kind in "iu" or all(np.array_equal(np.rint(row), row) for row in plane)


def _single(pattern: NDArray[Any]) -> NDArray[np.float32]:
    return pattern.astype(np.float32)


def _rounded(pattern: NDArray[Any], step: float) -> NDArray[np.float32]:
    """Return a pattern rounded to whole multiples of ``step``, a power of two."""
    out = np.empty(pattern.shape, np.float32)
    if round_pattern.spared(VALUE_S * pattern.size):
        out[...] = np.rint(pattern * np.float64(1 / step)) * step + 0.0
    else:
        round_pattern(pattern, step, out)
    return out


def _add_rounded_by_numpy(pattern: NDArray[Any], step: float, total: NDArray[np.float64]) -> tuple[float, float]:
    """Compute the results of `add_rounded` with NumPy, without compilation."""
    values = np.rint(pattern * np.float64(1 / step)) * step
    total += values
    return float(np.abs(pattern - values).sum()), float(np.abs(pattern).sum(dtype=np.float64))


def _rounded_sums(plane: NDArray[Any], step: float, workers: int | None) -> tuple[NDArray[np.float64], float]:
    """Return the sum of a plane, rounded to whole steps, over all positions, and the relative L1 error of the plane."""
    add = _add_rounded_by_numpy if add_rounded.spared(VALUE_S * plane.size) else add_rounded

    def rows(start: int, stop: int) -> tuple[NDArray[np.float64], float, float]:
        total, error, size = np.zeros(plane.shape[2:]), 0.0, 0.0
        for pattern in plane[start:stop].reshape(-1, *plane.shape[2:]):
            lacking, own = add(pattern, step, total)
            error, size = error + lacking, size + own
        return total, error, size

    found = for_each_chunk(rows, plane.shape[0], workers)
    total: NDArray[np.float64] = np.sum([one[0] for one in found], axis=0)
    error, size = sum(one[1] for one in found), sum(one[2] for one in found)
    return total, error / size if size > 0 else 0.0


def _rounded_up(deviations: NDArray[Any]) -> NDArray[np.float32]:
    """Return standard deviations rounded up to a few binary digits, which compress well."""
    mantissa, exponent = np.frexp(deviations.astype(np.float32))
    found = np.ldexp(np.ceil(mantissa * 2**UNCERTAINTY_DIGITS), exponent - UNCERTAINTY_DIGITS)
    return np.asarray(found, np.float32)
