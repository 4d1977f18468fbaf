"""The H file: written plane by plane, whole or not at all; opened lazily."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal import __version__
from lfcal.axes import AXES, check_psf_shape
from lfcal.camera import Camera
from lfcal.errors import InputError
from lfcal.files import replace_whole, require_space, storage_errors
from lfcal.progress import Clock, Work, drain
from lfcal.psf.matrix import PSFMatrix

__all__ = ["FORMAT", "VERSION", "PSFWriter", "iter_save", "save"]

FORMAT = "lfcal-psf"
VERSION = 1
CENTRE_RULE = "(n - 1) // 2"
COMPRESSIONS = ("gzip", "zstd", "none")
STORED_TYPES = ("float32", "uint16", "float64", "uint8")


class PSFWriter:
    """Write an H file plane by plane; the file takes its name only when every plane is in it.

    Used as a context manager. Chunks are one pattern each, ``(1, 1, 1, nt, ns)``, compressed by all
    processors, with checksums.

    Parameters
    ----------
    path
        The file to write; an existing one is replaced at the end.
    shape
        ``(nz, ny, nx, nt, ns)``.
    depths, camera, anchor, provenance
        As in `PSFMatrix`.
    dtype
        Stored type: ``"float32"`` (default), or ``"uint16"`` with a scale and offset per plane, which
        halves the file and rounds to 1/65535 of the plane's range. Integer planes may be stored as they
        are with their own type.
    compression
        ``"gzip"`` (level 1 with shuffle), ``"zstd"`` or ``"none"``.
    transposed
        The planes are those of HT.

    Raises
    ------
    InputError
        If a plane does not fit, is not finite, or is written twice; at the end if one is missing.
    StorageError
        If the disk is too small or may not be written to.
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
        workers: int | None = None,
    ) -> None:
        self.path = Path(path)
        self.shape = check_psf_shape(shape)
        if dtype not in STORED_TYPES:
            raise InputError.expected("stored type", " or ".join(STORED_TYPES), dtype, "choose one of these")
        if compression not in COMPRESSIONS:
            raise InputError.expected("compression", " or ".join(COMPRESSIONS), compression, "choose one of these")
        self.depths = np.asarray(np.arange(self.shape[0]) if depths is None else depths, np.float64)
        if self.depths.shape != (self.shape[0],):
            raise InputError.expected("depths", f"{self.shape[0]} values", self.depths.shape, "one per plane")
        self.camera, self.anchor, self.transposed = camera, anchor, transposed
        self.dtype, self.compression, self.workers = np.dtype(dtype), compression, workers
        self.provenance = {"lfcal": __version__, **(provenance or {})}
        self._written = np.zeros(self.shape[0], bool)
        self._scale, self._offset = np.ones(self.shape[0]), np.zeros(self.shape[0])
        self._recorded = np.zeros(self.shape[:3], np.uint16)
        self._saturated: NDArray[np.uint32] | None = None
        self._sums = np.zeros((self.shape[0], *self.shape[3:]))
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        """Create the scratch file beside the target."""
        import h5py

        nbytes = int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize
        require_space(self.path.parent, nbytes, what=self.path.name)
        part = self._stack.enter_context(replace_whole(self.path))
        try:
            with storage_errors(self.path):
                self._file = self._stack.enter_context(h5py.File(part, "w"))
                self._data = self._create_dataset()
        except BaseException as error:
            self._stack.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def _create_dataset(self) -> Any:
        options: dict[str, Any] = {"fletcher32": True, "shuffle": True}
        if self.compression == "gzip":
            options |= {"compression": "gzip", "compression_opts": 1}
        elif self.compression == "zstd":
            import hdf5plugin

            options |= dict(hdf5plugin.Zstd(clevel=3))
        else:
            options = {"fletcher32": True}
        chunk = (1, 1, 1, *self.shape[3:])
        return self._file.create_dataset("H", self.shape, self.dtype, chunks=chunk, track_times=False, **options)

    def write_plane(
        self,
        z: int,
        plane: NDArray[Any],
        *,
        recorded: ArrayLike | None = None,
        saturated: ArrayLike | None = None,
    ) -> None:
        """Write plane ``z``, ``(ny, nx, nt, ns)``.

        ``recorded`` and ``saturated`` are ``(ny, nx)`` counts per position (by default 1 and unknown).
        """
        from lfcal.psf.transpose import depth_sum

        if plane.shape != self.shape[1:]:
            raise InputError.expected(f"plane {z}", f"shape {self.shape[1:]}", plane.shape, "check the assembly")
        if not 0 <= z < self.shape[0] or self._written[z]:
            raise InputError.expected("plane number", "each of them once", z, "write every plane once")
        sums = depth_sum(plane, workers=self.workers)
        if not np.isfinite(sums).all():
            raise InputError.expected(
                f"plane {z}", "finite values", "NaN or infinity", "find the frame and record it again"
            )
        self._sums[z] = sums
        with storage_errors(self.path):
            store_plane(self._data, z, self._stored(z, plane), workers=self.workers)
        self._recorded[z] = 1 if recorded is None else recorded
        if saturated is not None:
            if self._saturated is None:
                self._saturated = np.zeros(self.shape[:3], np.uint32)
            self._saturated[z] = saturated
        self._written[z] = True

    def _stored(self, z: int, plane: NDArray[Any]) -> NDArray[Any]:
        """Return the plane in the stored type; an integer type takes a scale and an offset unless it fits."""
        if self.dtype.kind == "f" or plane.dtype == self.dtype:
            return plane.astype(self.dtype, copy=False)
        low, high = float(plane.min()), float(plane.max())
        top = float(np.iinfo(self.dtype).max)
        self._offset[z] = low
        self._scale[z] = (high - low) / top if high > low else 1.0
        out = np.empty(plane.shape, self.dtype)
        for y in range(plane.shape[0]):  # row by row: the plane is large
            out[y] = np.rint((plane[y] - low) / self._scale[z])
        return out

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Complete the file and give it its name, or remove it after an error."""
        if error is None and not self._written.all():
            lacking = np.flatnonzero(~self._written)[:5].tolist()
            error = InputError.expected(str(self.path), "every plane written", f"planes {lacking} missing", "write")
            kind = type(error)
            self._stack.__exit__(kind, error, None)
            raise error
        try:
            if error is None:
                with storage_errors(self.path):
                    self._describe()
        except BaseException as failure:
            self._stack.__exit__(type(failure), failure, failure.__traceback__)
            raise
        self._stack.__exit__(kind, error, trace)

    def _describe(self) -> None:
        file, data = self._file, self._data
        file.create_dataset("depth_sum", data=self._sums)
        depths = file.create_dataset("depths", data=self.depths)
        depths.attrs["unit"] = "um"
        file.create_dataset("recorded", data=self._recorded, compression="gzip")
        if self._saturated is not None:
            file.create_dataset("saturated", data=self._saturated, compression="gzip")
        data.attrs["scale"] = self._scale
        data.attrs["offset"] = self._offset
        file.attrs.update(
            {
                "format": FORMAT,
                "version": VERSION,
                "matrix": "HT" if self.transposed else "H",
                "axes": ",".join(AXES),
                "centre": CENTRE_RULE,
                "anchor": np.asarray(self.anchor, np.float64),
                "provenance": json.dumps(self.provenance),
            }
        )
        if self.camera is not None:
            file.attrs["camera"] = self.camera.to_json()


def store_plane(data: Any, z: int, plane: NDArray[Any], *, workers: int | None = None) -> None:
    """Write one plane ``(ny, nx, nt, ns)`` into an HDF5 dataset, compressing in threads where that is possible."""
    from lfcal.psf.chunk_codec import chunk_pipeline, parallel_write

    if chunk_pipeline(data) is None:
        data[z] = plane
        return
    parallel_write(data, z, plane, workers=workers)


def iter_save(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    *,
    dtype: str | None = None,
    compression: str = "gzip",
    workers: int | None = None,
) -> Work[Path]:
    """Write ``matrix`` (H, or the view ``H.T``) to an H file, one plane in memory at a time."""
    stored = dtype or (matrix.dtype.name if matrix.dtype.name in STORED_TYPES else "float32")
    clock = Clock("write planes", len(matrix))
    with PSFWriter(
        path,
        matrix.shape,
        depths=matrix.depths,
        camera=matrix.camera,
        anchor=matrix.anchor,
        dtype=stored,
        compression=compression,
        provenance=matrix.provenance,
        transposed=matrix.is_transposed,
        workers=workers,
    ) as writer:
        yield clock.at(0)
        for z in range(len(matrix)):
            saturated = None if matrix.saturated is None else matrix.saturated[z]
            writer.write_plane(z, matrix.plane(z), recorded=matrix.recorded[z], saturated=saturated)
            yield clock.at(z + 1)
    return Path(path)


def save(matrix: PSFMatrix, path: str | os.PathLike[str], **options: Any) -> Path:
    """Write ``matrix`` to an H file; options as in `iter_save`."""
    return drain(iter_save(matrix, path, **options))
