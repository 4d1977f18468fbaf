"""MATLAB v7.3 files as the published deconvolution codes use them (Prevedel 2014, Lu 2019, Stefanoiu 2019).

A v7.3 file is HDF5 behind a 512-byte header, every variable with a ``MATLAB_class`` attribute and its axes
reversed: the C-ordered ``H[z, y, x, t, s]`` is MATLAB's ``H(s, t, x, y, z)`` byte for byte.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import FileFormatError, InputError
from lfcal.files import require_space, storage_errors
from lfcal.h5.file import H5File
from lfcal.h5.writing import new_h5
from lfcal.progress import Clock, Work
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import store_plane

__all__ = ["crop_index", "iter_write_mat", "mat_header", "open_mat"]

_CLASSES = {
    "f4": b"single",
    "f8": b"double",
    "u1": b"uint8",
    "u2": b"uint16",
    "u4": b"uint32",
    "i1": b"int8",
    "i2": b"int16",
    "i4": b"int32",
    "i8": b"int64",
    "u8": b"uint64",
}


def mat_header() -> bytes:
    """Return the 512 bytes that make an HDF5 file a MATLAB v7.3 file."""
    date = time.strftime("%a %b %d %H:%M:%S %Y")
    text = f"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: {date} HDF5 schema 1.00 ."
    block = bytearray(512)
    block[:116] = text.encode("ascii", "replace")[:116].ljust(116, b" ")
    block[124:128] = b"\x00\x02IM"  # version 0x0200, little-endian
    return bytes(block)


def crop_index(depth_sum: NDArray[np.float64]) -> tuple[int, int]:
    """Return ``CAindex`` of one depth: first and last pixel (1-based) of the smallest centred square with all light.

    The published codes crop rows and columns of a plane by the same two numbers; only exact zeros are left out.
    """
    nt, ns = depth_sum.shape
    t, s = np.nonzero(depth_sum)
    half = max(np.abs(t - nt // 2).max(), np.abs(s - ns // 2).max()) if t.size else 0
    side = min(nt, ns)
    half = min(int(half), side // 2)
    # MATLAB counts from 1
    return side // 2 - half + 1, side // 2 + half + 1


def iter_write_mat(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    *,
    include_transpose: bool = True,
    rows_first: bool = False,
    compress: bool = True,
) -> Work[Path]:
    """Write ``H``, ``Ht``, ``Nnum``, ``CAindex`` and ``x3objspace`` (m) to a MATLAB v7.3 file, streaming.

    Parameters
    ----------
    matrix
        The PSF matrix.
    path
        The file; it appears whole or not at all.
    include_transpose
        Write ``Ht`` too (it doubles the file).
    rows_first
        Store ``H(t, s, y, x, z)`` instead of ``H(s, t, x, y, z)``: for codes whose images are ``imread``
        arrays with rows first. With the default order such an image must be transposed first.
    compress
        gzip, or contiguous data.

    Notes
    -----
    ``Nnum`` is one number where nx = ny; else ``[nx ny]`` and the codes that take a square period cannot use it.
    """
    target = Path(path)
    copies = 2 if include_transpose else 1
    require_space(target.parent, matrix.nbytes * copies, what=target.name)
    clock = Clock("write MATLAB file", len(matrix) * copies)
    # libver keeps to formats that MATLAB's older HDF5 reads
    with new_h5(target, header=mat_header(), libver=("earliest", "v110")) as file:
        done = 0
        for name, one in (("H", matrix), ("Ht", matrix.T))[:copies]:
            data = _create(file, name, one, rows_first, compress)
            for z in range(len(one)):
                plane = one.plane(z)
                store_plane(data, z, plane.transpose(1, 0, 3, 2) if rows_first else plane)
                done += 1
                yield clock.at(done)
        _write_small(file, matrix, rows_first)
    return target


def _create(file: Any, name: str, matrix: PSFMatrix, rows_first: bool, compress: bool) -> Any:
    # HDF5's row-major (z, y, x, t, s) is MATLAB's column-major (s, t, x, y, z): the axes turn round by themselves
    shape = matrix.shape
    if rows_first:
        shape = (shape[0], shape[2], shape[1], shape[4], shape[3])
    options: dict[str, Any] = {}
    if compress:
        options = {"chunks": (1, 1, 1, *shape[3:]), "compression": "gzip", "compression_opts": 1, "shuffle": True}
    data = file.create_dataset(name, shape, matrix.dtype, track_times=False, **options)
    kind = matrix.dtype.str[1:]
    if kind not in _CLASSES:
        raise InputError.expected("values for MATLAB", "real numbers", matrix.dtype, "convert them first")
    # MATLAB reads the class from this attribute: without it the data set cannot be loaded
    data.attrs["MATLAB_class"] = np.bytes_(_CLASSES[kind])
    return data


def _write_small(file: Any, matrix: PSFMatrix, rows_first: bool) -> None:
    ny, nx = matrix.period
    size = [[float(nx)]] if nx == ny else [[float(nx)], [float(ny)]]
    if rows_first:
        size = size[::-1]
    crops = np.array([crop_index(matrix.depth_sum(z)) for z in range(len(matrix))], np.float64)
    values = {
        "Nnum": np.array(size),
        "CAindex": crops.T.copy(),  # MATLAB sees (nz, 2)
        "x3objspace": (matrix.depths * 1e-6)[:, None],  # MATLAB sees (1, nz)
    }
    for name, value in values.items():
        data = file.create_dataset(name, data=value, track_times=False)
        data.attrs["MATLAB_class"] = np.bytes_(b"double")


def open_mat(path: Path) -> PSFMatrix:
    """Open the ``H`` of a MATLAB v7.3 file as a lazy `PSFMatrix`; ``x3objspace`` gives its depths.

    A 4-D H is a single plane; MATLAB drops trailing axes of length one.
    """
    head = b""
    if path.is_file():
        with storage_errors(path), path.open("rb") as raw:
            head = raw.read(128)
    # MATLAB 5.0 files are no HDF5 at all, and h5py would only say that a signature is missing
    if head.startswith(b"MATLAB 5.0"):
        raise FileFormatError.expected(
            str(path), "a MATLAB v7.3 file", "one of version 5 to 7", "save it with save(..., '-v7.3')"
        )
    file = H5File(path)
    try:
        data = file.dataset("H")
        if data.ndim == 4:
            return PSFMatrix(data.read()[None], depths=_depths(file, 1), provenance={"imported": path.name})
        if data.ndim != 5:
            raise FileFormatError.expected(
                f"{path}: H", "5 axes (s, t, x, y, z)", f"{data.ndim} axes", "check the file"
            )
        return PSFMatrix(data, depths=_depths(file, data.shape[0]), provenance={"imported": path.name})
    except BaseException:
        file.close()
        raise


def _depths(file: H5File, nz: int) -> NDArray[np.float64] | None:
    """Return the depths (µm); None where the file has none, or as many as it has planes of another matrix."""
    if "x3objspace" not in file:
        return None
    values = file.values("x3objspace", finite=True).astype(np.float64).ravel() * 1e6  # m to µm
    return values if values.size == nz else None
