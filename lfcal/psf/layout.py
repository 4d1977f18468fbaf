"""How one matrix lies in a group of an H file: what is written when, and what every entry means.

Version 4 of the format; ``docs/formats_h.md`` describes it for other programs. Stored zero means value zero, and one
number scales the whole matrix, so that every HDF5 reader sees the right shapes and ratios.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import AXES, InputError, check_psf_shape, for_each_chunk, full_version
from lfcal.base.h5 import H5Data
from lfcal.psf._chunk_codec import copy_plane, parallel_write
from lfcal.psf._step_kernels import add_rounded, round_pattern
from lfcal.psf.facts import Facts, stacked
from lfcal.psf.provenance import with_simulated
from lfcal.psf.steps import bound_after, check_store_tolerance, step_of_range, stepped_plane

if TYPE_CHECKING:
    from lfcal.camera import Camera

__all__ = [
    "CENTRE_RULE",
    "COMPRESSIONS",
    "ROUNDED",
    "STORED_TYPES",
    "Header",
    "MatrixGroup",
    "Plane",
    "Stored",
    "StoredPlane",
    "plane_checksum",
]

CENTRE_RULE = "(n - 1) // 2"
UNCERTAINTY_DIGITS = 8
"""Binary digits of a stated standard deviation, which is rounded up: by 1/128 at most."""
COMPRESSIONS = ("gzip", "zstd", "none")
Convert = Callable[[NDArray[Any]], NDArray[Any]]
PLANE_NUMBER = "plane"
"""Unit of depths that nobody stated: they are numbers of planes."""
ROUNDED = "rounded"
"""float32 in steps of a power of two, as wide as 16 bits for a plane allow: small, and exact for whole numbers."""

STORED_TYPES = ("float32", ROUNDED, "float64", "uint16", "uint8")


CHECKSUM_RULE = "CRC-32 over the little-endian CRC-32 of every stored pattern, y slow, x fast"


@dataclass(frozen=True, eq=False)
class Header:
    """What a matrix is, besides its values.

    Attributes
    ----------
    shape
        ``(nz, ny, nx, nt, ns)``.
    depths, camera, anchor, provenance, transposed, region
        As in `lfcal.psf.PSFMatrix`.

    Raises
    ------
    InputError
        If the shape is not that of a matrix, or depths are not one for each plane.
    """

    shape: tuple[int, ...]
    depths: ArrayLike | None = None
    camera: Camera | None = None
    anchor: tuple[float, float] = (0.0, 0.0)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    transposed: bool = False
    region: str = ""

    def __post_init__(self) -> None:
        """Check shape and depths."""
        object.__setattr__(self, "shape", check_psf_shape(self.shape))
        if self.plane_depths.shape != self.shape[:1]:
            raise InputError.expected("depths", f"{self.shape[0]} values", self.plane_depths.shape, "one per plane")

    @property
    def plane_depths(self) -> NDArray[np.float64]:
        """Depth of each plane, not-a-number where it is not known."""
        return np.asarray(np.full(self.shape[0], np.nan) if self.depths is None else self.depths, np.float64)


@dataclass(frozen=True)
class Stored:
    """How the values of a matrix are stored in a file.

    Attributes
    ----------
    dtype, compression, store_tolerance
        As in `lfcal.psf.PSFWriter`.

    Raises
    ------
    InputError
        If there is no such type or compression, or the tolerance is not a share.
    """

    dtype: str = "float32"
    compression: str = "gzip"
    store_tolerance: float | None = None

    def __post_init__(self) -> None:
        """Check what an H file can hold."""
        if self.dtype not in STORED_TYPES:
            raise InputError.expected("stored type", " or ".join(STORED_TYPES), self.dtype, "choose one of these")
        if self.compression not in COMPRESSIONS:
            raise InputError.expected("compression", " or ".join(COMPRESSIONS), self.compression, "choose one of these")
        if self.store_tolerance is not None:
            check_store_tolerance(self.store_tolerance)

    @property
    def rounded(self) -> bool:
        """Whether all values of a plane are rounded to one step."""
        return self.dtype == ROUNDED and self.store_tolerance is None

    @property
    def samples(self) -> np.dtype[Any]:
        """Type of the samples in the file."""
        stepped = self.store_tolerance is not None
        return np.dtype("float32" if stepped or self.dtype == ROUNDED else self.dtype)


@dataclass(frozen=True, eq=False, slots=True)
class Plane:
    """One plane of a matrix, and what is known of it.

    Attributes
    ----------
    values
        ``(ny, nx, nt, ns)``.
    facts
        What is known of the positions.
    uncertainty
        Standard deviation of every entry, 0 where none is stated besides the noise; None: none is stated.
    simulated
        How the plane was simulated, as plain JSON types; None where it was not.
    """

    values: NDArray[Any]
    facts: Facts
    uncertainty: NDArray[np.floating[Any]] | None = None
    simulated: Mapping[str, Any] | None = None


@dataclass(frozen=True, eq=False)
class StoredPlane:
    """The only plane of an H file, as it is stored.

    Attributes
    ----------
    data
        ``(1, ny, nx, nt, ns)`` in chunks of a pattern each.
    sums
        Depth-plane sum ``(nt, ns)``.
    used, checksum, error
        As the file states them.
    facts
        Of its positions; the error is not among them.
    uncertainty
        Standard deviations of its entries; None: none are stated.
    step
        Of which the values of each pattern are multiples ``(ny, nx)``; None: they are not rounded.
    simulated
        How it was simulated, as plain JSON types; None where it was not.
    """

    data: H5Data
    sums: NDArray[np.float64]
    used: NDArray[np.int32]
    checksum: int
    error: float
    facts: Facts
    uncertainty: H5Data | None = None
    step: NDArray[np.float32] | None = None
    simulated: Mapping[str, Any] | None = None


class MatrixGroup:
    """Write one matrix into an open HDF5 group, plane by plane in any order, then `complete` it."""

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
        """Planes that were not written yet."""
        return np.flatnonzero(~self._written).tolist()

    def _create_dataset(self, name: str, dtype: np.dtype[Any]) -> Any:
        header, compression = self._header, self._stored.compression
        options: dict[str, Any] = {"fletcher32": True}
        if compression == "gzip":
            options |= {"shuffle": True, "compression": "gzip", "compression_opts": 1}
        elif compression == "zstd":
            import hdf5plugin

            options |= {"shuffle": True} | dict(hdf5plugin.Zstd(clevel=3))
        chunk = (1, 1, 1, *header.shape[3:])
        return self._group.create_dataset(name, header.shape, dtype, chunks=chunk, track_times=False, **options)

    def write_plane(self, z: int, plane: Plane) -> None:
        """Write plane ``z`` and what is known of it."""
        self._write_values(z, plane.values, plane.facts)
        if plane.uncertainty is not None:
            self._write_uncertainty(z, plane.uncertainty)
        if plane.simulated is not None:
            self._simulated[z] = dict(plane.simulated)

    def _write_values(self, z: int, plane: NDArray[Any], facts: Facts) -> None:
        from lfcal.psf._transpose import depth_sum

        shape = self._header.shape
        if plane.shape != shape[1:]:
            raise InputError.expected(f"plane {z}", f"shape {shape[1:]}", plane.shape, "check the assembly")
        if not 0 <= z < shape[0] or self._written[z]:
            raise InputError.expected("plane number", "each of them once", z, "write every plane once")
        if plane.dtype.kind == "c":
            raise InputError.expected(
                f"plane {z}", "real numbers", f"{plane.dtype}", "export a complex H as .npy, or store its parts"
            )
        sums = depth_sum(plane, workers=self._workers)
        if not np.isfinite(sums).all():
            raise InputError.expected(
                f"plane {z}", "finite values", "NaN or infinity", "find the frame and record it again"
            )
        if self._stored.store_tolerance is not None:
            self._write_steps(z, plane, facts, self._stored.store_tolerance)
            return
        self._used[z] = _used_window(sums)
        convert, step = self._conversion(z, plane)
        error = 0.0
        self._sums[z] = sums
        if step:
            # the sums in the file are those of the values in the file
            self._step[z] = step
            self._sums[z], error = _rounded_sums(plane, step, self._workers)
        each = np.zeros(shape[1:3], "<u4")
        parallel_write(self._data, z, plane, convert=convert, checksums=each, workers=self._workers)
        self._checksum[z] = zlib.crc32(each.data)
        self._note(z, facts, error)
        self._written[z] = True

    def _write_steps(self, z: int, plane: NDArray[Any], facts: Facts, tolerance: float) -> None:
        """Write plane ``z`` in whole steps, within a tolerance."""
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
        """Keep more provenance beside the header's."""
        self._provenance |= provenance

    def _write_uncertainty(self, z: int, plane: NDArray[np.floating[Any]]) -> None:
        """Write the standard deviation of every entry of plane ``z`` ``(ny, nx, nt, ns)``; 0: none is stated.

        Rounded up to `UNCERTAINTY_DIGITS` binary digits: none becomes 0.
        """
        if plane.shape != self._header.shape[1:]:
            raise InputError.expected(
                f"uncertainty of plane {z}", f"shape {self._header.shape[1:]}", plane.shape, "one value per entry"
            )
        low, largest = _range(plane, self._workers)
        if not (np.isfinite(largest) and low >= 0):
            raise InputError.expected(f"uncertainty of plane {z}", "numbers ≥ 0", f"{low:g} to {largest:g}", "check it")
        if self._uncertainty is None:
            self._uncertainty = self._create_dataset("uncertainty", np.dtype(np.float32))
        parallel_write(self._uncertainty, z, plane, convert=_rounded_up, workers=self._workers)
        self._uncertain[z] = True

    def adopt_plane(self, z: int, stored: StoredPlane) -> None:
        """Take plane ``z`` over as another file has it: its bytes are neither unpacked nor rounded again."""
        if stored.data.shape[1:] != self._header.shape[1:] or self._written[z]:
            raise InputError.expected(
                f"plane {z}", f"{self._header.shape[1:]} once", stored.data.shape, "write it anew"
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
        elif rounding > 0:  # what is rounded to steps of the plane has no bound for each pattern
            known.pop("bound", None)
        stated = known.pop("error", None)
        errors = [e for e in (rounding, np.nan if stated is None else float(stated)) if np.isfinite(e)]
        # an error that nobody knows is not that of the rounding alone, where there is none
        if errors and (rounding > 0 or (stated is not None and np.isfinite(stated))):
            self._error[z] = sum(errors)
        known.setdefault("recorded", np.ones(self._header.shape[1:3], np.uint16))
        self._facts[z] = Facts(**known)

    def _conversion(self, z: int, plane: NDArray[Any]) -> tuple[Convert | None, float]:
        """Return what turns a pattern of plane ``z`` into its stored type, and the step it is rounded to; 0: none."""
        dtype = self._stored.samples
        if self._stored.rounded:
            low, high = _range(plane, self._workers)
            step = step_of_range(low, high)
            # float32 holds whole numbers beyond 16 bits as well
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
                f"others, from {low:.6g} to {high:.6g}",
                f"store it as {ROUNDED} or float32 (--dtype)",
            )
        return (lambda pattern: pattern.astype(dtype)), 0.0

    def complete(self) -> None:
        """Write everything but the values; every plane must be there."""
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


def plane_checksum(stored: NDArray[Any], workers: int | None = None) -> int:
    """Return the checksum of a plane ``(ny, nx, nt, ns)`` of stored samples.

    It is a CRC-32 over the CRC-32 of each pattern, so that patterns can be checked in parallel and on their own.
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
    """Return first and last row and column of the cutout that hold light, (0, -1, 0, -1) where none does."""
    rows, columns = np.flatnonzero(sums.any(axis=1)), np.flatnonzero(sums.any(axis=0))
    if not rows.size:
        return 0, -1, 0, -1
    return int(rows[0]), int(rows[-1]), int(columns[0]), int(columns[-1])


def _range(plane: NDArray[Any], workers: int | None) -> tuple[float, float]:
    """Return lowest and highest value of a plane."""

    def rows(start: int, stop: int) -> tuple[float, float]:
        # pattern by pattern, so that each is read once into the cache
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
    """Return a pattern in whole steps of a power of two."""
    out = np.empty(pattern.shape, np.float32)
    round_pattern(pattern, step, out)
    return out


def _rounded_sums(plane: NDArray[Any], step: float, workers: int | None) -> tuple[NDArray[np.float64], float]:
    """Return the sum over all positions of a plane in whole steps, and its relative error (L1)."""

    def rows(start: int, stop: int) -> tuple[NDArray[np.float64], float, float]:
        total, error, size = np.zeros(plane.shape[2:]), 0.0, 0.0
        for pattern in plane[start:stop].reshape(-1, *plane.shape[2:]):
            lacking, own = add_rounded(pattern, step, total)
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
