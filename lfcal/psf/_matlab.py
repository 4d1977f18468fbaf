"""MATLAB v7.3 files as the published deconvolution codes use them (Prevedel 2014, Lu 2019, Stefanoiu 2019).

A v7.3 file is HDF5 behind a 512-byte header. Every variable has a ``MATLAB_class`` attribute and reversed axes: the
C-ordered ``H[z, y, x, t, s]`` is MATLAB's ``H(s, t, x, y, z)`` byte for byte.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, require_space
from lfcal.base.h5 import new_h5
from lfcal.psf._rearranged import PlacedPlanes
from lfcal.psf._transpose import depth_sum
from lfcal.psf.codes import write_cells
from lfcal.psf.lens_centre import first_pixel, lens_centre_of, lens_centred, sampling
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import store_plane
from lfcal.psf.voxels import voxel_um

__all__ = [
    "COLUMNS_FIRST",
    "ROWS_FIRST",
    "MatOptions",
    "create_mat_data",
    "crop_index",
    "iter_write_mat",
    "mat_header",
    "mat_notes",
    "mat_plane",
    "mat_written",
]

COLUMNS_FIRST, ROWS_FIRST = "stxyz", "tsyxz"
"""Axes of H as MATLAB counts them, in the variable ``axisOrder``."""

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


def crop_index(sums: NDArray[np.float64]) -> tuple[int, int]:
    """Return ``CAindex`` of one depth: first and last pixel (1-based) of the smallest centred square with all light.

    The published codes crop rows and columns of a plane by the same two numbers, and therefore need a square cutout.
    Only exact zeros are left out.
    """
    middle = len(sums) // 2
    lit = np.argwhere(sums)
    half = int(np.abs(lit - middle).max()) if lit.size else 0
    # MATLAB counts from 1
    return middle - half + 1, middle + half + 1


@dataclass(frozen=True)
class MatOptions:
    """Options for writing a ``.mat`` file.

    Attributes
    ----------
    include_transpose
        Whether to write ``Ht`` too, which doubles the file size.
    rows_first
        Whether to store ``H(t, s, y, x, z)`` instead of ``H(s, t, x, y, z)``, for codes that read images with
        ``imread`` as arrays with rows first. With the default order, such an image must be transposed first.
    compress
        Whether to compress with gzip; otherwise data are contiguous.
    lens_centred
        Whether to roll the positions so that a micro-image centre is on pixel ceil(Nnum/2) of the period, from 1.
    interpolation
        With ``lens_centred``: interpolation for the remaining fraction of a pixel; ``"nearest"`` leaves it
        uncorrected.
    cells
        Whether to store ``H{y,x,z}(t, s)``, a cell array of patterns, as oLaF does.
    sparse
        With ``cells``: whether each pattern is a sparse matrix of double values.
    quality
        Quality of H as text, written as the variable ``quality``; empty: not written.
    """

    include_transpose: bool = True
    rows_first: bool = False
    compress: bool = True
    lens_centred: bool = False
    interpolation: str = "nearest"
    cells: bool = False
    sparse: bool = False
    quality: str = ""


StoreMatPlane = Callable[[str, int, Any], tuple[int, int]]
"""Function of a name (``H`` or ``Ht``), z and a dataset: writes the plane to it and returns its `crop_index`."""


def iter_write_mat(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    options: MatOptions | None = None,
    store: StoreMatPlane | None = None,
) -> Work[Path]:
    """Write H plane by plane to a MATLAB v7.3 file, with the variables that other codes need.

    The file contains ``H``, ``Ht``, ``Nnum``, ``CAindex``, ``x3objspace`` (m), ``axisOrder``, ``cutout``, and, if
    they are known, ``anchor``, ``lensCentre`` and ``voxelSize`` (m); see ``docs/matlab.md``.

    Parameters
    ----------
    matrix
        The PSF matrix.
    path
        The file, which is written atomically.
    options
        Options. None: the defaults.
    store
        Function that writes planes which other processes have made. None: planes are made here.

    Raises
    ------
    InputError
        If lens-centring is requested, but the positions of the lenses in H are unknown.

    Notes
    -----
    ``Nnum`` is one number if nx = ny; otherwise ``[nx ny]``, which codes for square periods cannot use. A cutout that
    is not square is padded with zeros: the codes crop rows and columns by the same ``CAindex``.
    """
    options = options or MatOptions()
    small = _small(matrix, options)
    written = mat_written(matrix, options)
    target = Path(path)
    copies = 2 if options.include_transpose else 1
    require_space(target.parent, written.nbytes * copies, what=target.name)
    clock = Clock("write MATLAB file", len(matrix) * copies)

    def own(name: str, z: int, data: Any) -> tuple[int, int]:
        plane, crop = mat_plane(written, options, name, z)
        store_plane(data, z, plane)
        return crop

    store = store or own
    # libver restricts the file to formats that MATLAB's older HDF5 library reads
    with new_h5(target, header=mat_header(), libver=("earliest", "v110")) as file:
        done, crops = 0, []
        for name in ("H", "Ht")[:copies]:
            if options.cells:
                view = written if name == "H" else written.T
                for planes in write_cells(file, name, view, compress=options.compress, sparse=options.sparse):
                    yield clock.at(done + planes)
                done += len(written)
                continue
            data = create_mat_data(file, name, written, options)
            for z in range(len(written)):
                crop = store(name, z, data)
                if name == "H":
                    crops.append(crop)
                done += 1
                yield clock.at(done)
        if crops:
            small["CAindex"] = np.array(crops, np.float64).T  # MATLAB sees (nz, 2)
        _write_small(file, small)
    return target


def mat_written(matrix: PSFMatrix, options: MatOptions) -> PSFMatrix:
    """Return H with a square cutout, and lens-centred if requested."""
    lens = lens_centre_of(matrix)
    if options.lens_centred and lens is not None:
        matrix = lens_centred(matrix, lens, options.interpolation)
    nt, ns = matrix.cutout
    if nt == ns:
        return matrix
    side = max(nt, ns)
    return PSFMatrix(PlacedPlanes(matrix.planes, (side, side)), transposed=matrix.is_transposed)


def mat_plane(written: PSFMatrix, options: MatOptions, name: str, z: int) -> tuple[NDArray[Any], tuple[int, int]]:
    """Return plane ``z`` of ``H`` or ``Ht`` in the axis order of the file, and its `crop_index`, (0, 0) for ``Ht``.

    ``written`` is the result of `mat_written`.
    """
    plane = (written if name == "H" else written.T).plane(z)
    crop = crop_index(depth_sum(plane)) if name == "H" else (0, 0)
    return plane.transpose(1, 0, 3, 2) if options.rows_first else plane, crop


def create_mat_data(file: Any, name: str, matrix: PSFMatrix, options: MatOptions, planes: int | None = None) -> Any:
    """Return a new dataset for ``H`` or ``Ht``, or one for only ``planes`` planes, stored in the same way."""
    # HDF5's row-major (z, y, x, t, s) is MATLAB's column-major (s, t, x, y, z), so no axes need to be moved
    shape = (planes or len(matrix), *matrix.shape[1:])
    if options.rows_first:
        shape = (shape[0], shape[2], shape[1], shape[4], shape[3])
    storage: dict[str, Any] = {}
    if options.compress:
        storage = {"chunks": (1, 1, 1, *shape[3:]), "compression": "gzip", "compression_opts": 1, "shuffle": True}
    data = file.create_dataset(name, shape, matrix.dtype, track_times=False, **storage)
    kind = matrix.dtype.str[1:]
    if kind not in _CLASSES:
        raise InputError.expected(
            "values for MATLAB",
            "real numbers in a type of MATLAB",
            matrix.dtype,
            "export the squared magnitudes" if matrix.dtype.kind == "c" else "convert H to float32",
        )
    # MATLAB reads the class from this attribute: without it the data set cannot be loaded
    data.attrs["MATLAB_class"] = np.bytes_(_CLASSES[kind])
    return data


def _small(matrix: PSFMatrix, options: MatOptions) -> dict[str, NDArray[np.float64] | str]:
    """Return the small variables, as MATLAB's transpose: ``(1, nz)`` there is ``(nz, 1)`` here."""
    lens = lens_centre_of(matrix)
    if options.lens_centred and lens is None:
        raise InputError.expected(
            "lens-centred export", "an H with its camera", "an H without one", "assemble it with its camera"
        )
    ny, nx = matrix.period
    values: dict[str, NDArray[np.float64] | str] = {
        "Nnum": _pair((ny, nx), options) if ny != nx else np.array([[float(nx)]]),
        "cutout": _pair(matrix.cutout, options),
        **({"x3objspace": (matrix.depths * 1e-6)[:, None]} if matrix.knows_depths else {}),
        "axisOrder": ROWS_FIRST if options.rows_first else COLUMNS_FIRST,
        **({"quality": options.quality} if options.quality else {}),
    }
    first = np.array(first_pixel(matrix))
    at = None if lens is None else np.array(lens.position)
    if options.lens_centred and lens is not None:
        moved = np.array(lens.rest if options.interpolation != "nearest" else (0.0, 0.0))
        at = lens.expected + np.array(lens.rest) - moved
        first = first + (moved - lens.shift) / sampling(matrix)[1]
    if matrix.camera is not None or matrix.anchor != (0.0, 0.0):
        values["anchor"] = _pair(first + 1, options)  # MATLAB counts from 1
    voxel = voxel_um(matrix)
    if voxel is not None:
        values["voxelSize"] = _pair(np.array(voxel) * 1e-6, options)
    if at is not None:
        values["lensCentre"] = _pair(at + 1, options)
    return values


def _pair(rows_columns: Any, options: MatOptions) -> NDArray[np.float64]:
    """Return (rows, columns) in the order that H's own axes have in the file, ``(1, 2)`` in MATLAB."""
    pair = np.array(rows_columns, np.float64)[:, None]
    return pair if options.rows_first else pair[::-1]


def _write_small(file: Any, values: dict[str, NDArray[np.float64] | str]) -> None:
    for name, value in values.items():
        text = isinstance(value, str)
        stored = np.array([[ord(letter)] for letter in value], np.uint16) if isinstance(value, str) else value
        data = file.create_dataset(name, data=stored, track_times=False)
        data.attrs["MATLAB_class"] = np.bytes_(b"char" if text else b"double")
        if text:
            data.attrs["MATLAB_int_decode"] = np.int32(2)  # characters of 16 bits


def mat_notes(matrix: PSFMatrix, options: MatOptions | None = None) -> tuple[str, ...]:
    """Return notes and instructions on conventions of codes for ``.mat`` files that differ from those of H."""
    options = options or MatOptions()
    ny, nx = matrix.period
    notes = []
    if ny != nx:
        notes.append(f"the period is {ny} x {nx}; codes that require a square period (Nnum) cannot use this H")
    elif ny % 2 == 0:
        notes.append(f"the period is {ny} x {nx}; codes that require an odd Nnum cannot use this H")
    lens = lens_centre_of(matrix)
    if lens is None:
        return (
            *notes,
            "H does not state where its lenses are; other codes assume that a lens is centred on pixel ceil(Nnum/2)",
        )
    row, column = (at + 1 for at in lens.position)
    wanted = "row {} and column {}".format(*(at + 1 for at in lens.expected))
    if not options.lens_centred and not lens.agrees:
        notes.append(
            f"a lens is centred on row {row:.2f} and column {column:.2f} of the period, but other codes assume "
            f"{wanted} "
            "(counting from 1); centre the lens (--lens-centred), or use frames that begin at pixel `anchor`"
        )
    elif options.lens_centred and not lens.is_whole and options.interpolation == "nearest":
        rest = ", ".join(f"{v:+.2f}" for v in lens.rest)
        notes.append(
            f"with shifts by whole pixels, the centre of the lens is ({rest}) px (rows, columns) from {wanted}; "
            "shift the patterns by fractions of a pixel (--interpolation cubic)"
        )
    return tuple(notes)
