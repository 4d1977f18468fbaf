"""Deconvolution codes for which H is exported, the layout that each code reads, and the conditions on H.

The layouts follow the public sources of these codes (`Code.source`).
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, Work, any_of, npy_header, replace_whole, require_space, storage_errors
from lfcal.psf.lens_centre import lens_centre_of, lens_centred
from lfcal.psf.matrix import PSFMatrix

__all__ = ["CODES", "Code", "code_of", "codes_for", "iter_write_npz", "refused_by", "write_cells"]

OWN_CODE = "reconstruct with lfcal, or export a plain file"


@dataclass(frozen=True)
class Code:
    """The form in which a deconvolution code reads H.

    Attributes
    ----------
    name, title
        Name of the code in options, and as its authors write it.
    suffix
        Suffix of the file that the code reads.
    order
        Order of the axes of H in the code.
    stored
        Container and type of the values.
    use
        Instruction for users of the code; empty if none is needed.
    source
        Address of the published source code.
    one_lens
        Whether the code assumes a square grid of lenses with a period of an odd number of pixels, and repeats the
        patterns of one lens. Otherwise it needs one pattern for each plane.
    """

    name: str
    title: str
    suffix: str
    order: str
    stored: str
    use: str
    source: str
    one_lens: bool = True


CODES = {
    code.name: code
    for code in (
        Code(
            "olaf",
            "oLaF",
            ".mat",
            "H{y,x,z}(t,s)",
            "cells of single or sparse, MATLAB 7.3",
            "call the projections of oLaF with range 'full', because a measured H has no exact symmetry",
            "https://gitlab.lrz.de/IP/olaf",
        ),
        Code(
            "prevedel",
            "Prevedel",
            ".mat",
            "H(t,s,y,x,z)",
            "single, MATLAB 7.3",
            "",
            "https://doi.org/10.1038/nmeth.2964",
        ),
        Code(
            "pyolaf",
            "pyolaf",
            ".npz",
            "H[y,x,z][t,s]",
            "float32, NumPy",
            "make the patterns sparse as shown in docs/matlab.md, and call the projections of pyolaf with "
            "crange 'full'",
            "https://github.com/lambdaloop/pyolaf",
        ),
        Code(
            "flfm",
            "FLFM",
            ".tif",
            "PSF[z,t,s]",
            "float32, TIFF",
            "crop or pad the light field and the PSF to the same size, because the code multiplies their "
            "Fourier transforms",
            "https://github.com/ssec-jhu/flfm",
            one_lens=False,
        ),
    )
}
"""Codes by name."""


def code_of(name: str) -> Code:
    """Return the code called ``name``; raise `InputError` for an unknown name."""
    if name not in CODES:
        raise InputError.expected("code", any_of(CODES), repr(name), "choose one of these")
    return CODES[name]


def refused_by(code: Code, matrix: PSFMatrix, position: tuple[int, int] | None = None) -> InputError | None:
    """Return the error that states why a code cannot use ``matrix``; None if it can.

    Parameters
    ----------
    code, matrix
        The code, and H.
    position
        Position (y, x) whose patterns are used for a code that needs one pattern for each plane. None: none is chosen.
    """

    def needs(expected: str, got: str, action: str = OWN_CODE) -> InputError:
        return InputError.expected(f"H for {code.title}", expected, got, action)

    ny, nx = matrix.period
    if matrix.is_transposed:
        return needs("H", "HT", "export H, with which HT is exported")
    if matrix.dtype != np.float32:
        return needs("float32 values", str(matrix.dtype), "store H as float32 first")
    if not code.one_lens:
        several = position is None and (ny, nx) != (1, 1)
        words = "choose a position if the optics are shift-invariant"
        return needs("one pattern for each plane", f"{ny} x {nx} positions", words) if several else None
    if matrix.camera is not None and not matrix.camera.has_lattice:
        return needs("lenses on a square grid", "single lenslets in a pupil plane")
    if matrix.camera is not None and matrix.camera.lattice.kind != "square":
        return needs("lenses on a square grid", f"a {matrix.camera.lattice.kind} array")
    if ny != nx or ny % 2 == 0:
        return needs("a square period of an odd number of pixels", f"{ny} x {nx}")
    return None


def codes_for(matrix: PSFMatrix) -> tuple[Code, ...]:
    """Return the codes that can use ``matrix`` without a chosen position (see `refused_by`)."""
    return tuple(code for code in CODES.values() if refused_by(code, matrix) is None)


# -- files -------------------------------------------------------------------------------------------------
def _written(matrix: PSFMatrix) -> PSFMatrix:
    """Return H with a lens where the codes expect it, or H unchanged if it does not state where its lenses are."""
    lens = lens_centre_of(matrix)
    return matrix if lens is None else lens_centred(matrix, lens)


def write_cells(
    file: Any, name: str, matrix: PSFMatrix, *, compress: bool = True, sparse: bool = False
) -> Iterator[int]:
    """Write ``matrix`` to an open MATLAB 7.3 file as the cell array ``name{y,x,z}`` of patterns ``(t, s)``.

    With ``sparse``, each pattern is a sparse matrix; otherwise, ``compress`` selects gzip compression. Yield the number
    of planes written so far.
    """
    import h5py

    nz, ny, nx = matrix.shape[:3]
    store: dict[str, Any] = {"compression": "gzip", "compression_opts": 1, "shuffle": True} if compress else {}
    # HDF5 has MATLAB's axes reversed: the cells are (z, x, y), a pattern is (s, t)
    references = np.empty((nz, nx, ny), dtype=h5py.ref_dtype)
    group = file.require_group("#refs#")
    for z in range(nz):
        plane = matrix.plane(z)
        for y, x in np.ndindex(ny, nx):
            at = f"{name}_{z}_{y}_{x}"
            if sparse:
                cell = _write_sparse(group.create_group(at), plane[y, x])
            else:
                cell = group.create_dataset(at, data=plane[y, x].T, track_times=False, **store)
                cell.attrs["MATLAB_class"] = np.bytes_(b"single")
            references[z, x, y] = cell.ref
        yield z + 1
    cells = file.create_dataset(name, data=references, dtype=h5py.ref_dtype, track_times=False)
    cells.attrs["MATLAB_class"] = np.bytes_(b"cell")


def _write_sparse(group: Any, pattern: NDArray[Any]) -> Any:
    """Write a pattern as a sparse matrix of MATLAB: columns of double values, with their rows from 0."""
    from scipy.sparse import csc_matrix

    stored = csc_matrix(pattern, dtype=np.float64)
    group.attrs["MATLAB_class"] = np.bytes_(b"double")
    group.attrs["MATLAB_sparse"] = np.uint64(pattern.shape[0])
    parts: dict[str, NDArray[Any]] = {"jc": stored.indptr}
    if stored.nnz:  # MATLAB leaves out empty parts
        parts |= {"ir": stored.indices, "data": stored.data}
    for key, values in parts.items():
        kind = np.float64 if key == "data" else np.uint64
        part = group.create_dataset(key, data=values.astype(kind), track_times=False)
        part.attrs["MATLAB_class"] = np.bytes_(b"double" if key == "data" else b"uint64")
    return group


def iter_write_npz(
    matrix: PSFMatrix, path: Path, *, include_transpose: bool, compress: bool, quality: str
) -> Work[Path]:
    """Write ``H``, and optionally its transpose ``Ht``, as (z, y, x, t, s) to an ``.npz`` file; return its path.

    H is rolled such that a lens is where other software expects it (`lens_centred`), if the centre of a lens is known.
    The file also contains the depths of the planes (µm), if known, the order of the axes, and ``quality``, a text about
    the quality of H.
    """
    written = _written(matrix)
    views = {"H": written, **({"Ht": written.T} if include_transpose else {})}
    require_space(path.parent, len(views) * matrix.nbytes, what=path.name)
    clock, done = Clock("write npz file", len(views) * len(matrix)), 0
    method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    small = {"quality": np.array(quality), "order": np.array("zyxts")}
    if matrix.knows_depths:
        small["depths_um"] = matrix.depths
    with storage_errors(path), replace_whole(path) as part, zipfile.ZipFile(part, "w", method, compresslevel=1) as file:
        for name, view in views.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as entry:
                entry.write(npy_header(view.shape, np.dtype(np.float32)))
                for z in range(len(view)):
                    entry.write(np.ascontiguousarray(view.plane(z), np.float32).data)
                    done += 1
                    yield clock.at(done)
        for name, values in small.items():
            file.writestr(f"{name}.npy", npy_header(values.shape, values.dtype) + values.tobytes())
    return path
