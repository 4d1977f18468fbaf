"""H for other programs in units of a plane each: what is done stays where it is stopped, fails, or is killed."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from lfcal.base import Clock, Work, require_space
from lfcal.base.h5 import H5File, new_h5
from lfcal.psf._chunk_codec import copy_plane
from lfcal.psf._export import ExportOptions, check_export, iter_export, iter_write_npy
from lfcal.psf._matlab import MatOptions, create_mat_data, iter_write_mat, mat_plane, mat_written
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import open_psf
from lfcal.psf.saving import iter_save
from lfcal.psf.store import store_plane
from lfcal.work import RunChoice, Unit, iter_made

__all__ = ["UNITS", "do_plane", "iter_export_units"]

UNITS = (".h5", ".mat", ".npy")
"""Formats that are written in units; a TIFF of several planes is one file for each already, or small."""

PLANE, CROP = "plane", "crop"


def iter_export_units(
    psf: str | os.PathLike[str],
    path: str | os.PathLike[str],
    options: ExportOptions | None = None,
    *,
    turned: bool = False,
    run: RunChoice,
) -> Work[Path]:
    """Write the H of a file in the format of a suffix as `iter_export` does, plane by plane.

    Parameters
    ----------
    psf
        The H file.
    path
        The file to write.
    options
        As in `iter_export`; None: what the format does by itself.
    turned
        Write its transpose.
    run
        By whom, and what becomes of an earlier run.

    Raises
    ------
    InputError, StorageError
        As that does, and `lfcal.work.iter_made`; the planes that are done stay for the next run.
    """
    options, target = options or ExportOptions(), Path(path)
    with open_psf(psf) as opened:
        matrix = opened.T if turned else opened
        suffix = check_export(matrix, path, options)
        if suffix == ".h5":
            compression = "none" if options.compress is False else "gzip"
            return (yield from iter_save(matrix, path, dtype=options.dtype, compression=compression, run=run))
        if suffix not in UNITS:
            return (yield from iter_export(matrix, path, **options.given()))
        names = ("H", "Ht") if suffix == ".mat" and options.mat.include_transpose else ("H",)
        # before any plane is made: each is a file of its own until all are there
        require_space(target.parent, len(names) * matrix.nbytes, what=target.name)
        source = os.path.abspath(psf)
        told = asdict(options.mat) if suffix == ".mat" else {}
        shared = {"source": source, "turned": turned, "suffix": suffix, "options": told}
        units = [
            Unit(
                f"plane {z:04d}" if name == "H" else f"{name} plane {z:04d}",
                f"{__name__}:{do_plane.__name__}",
                shared | {"name": name, "z": z},
                (source,),
            )
            for name in names
            for z in range(len(matrix))
        ]
        join = partial(_join, matrix=matrix, target=target, options=options)
        yield from iter_made(units, target, run, join, title=f"export {target.name}")
    return target


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Write one plane into a file of its own, stored as it will be: the task of a unit."""
    z, suffix, told = int(arguments["z"]), arguments["suffix"], arguments["options"]
    clock = Clock(f"export plane {z}", 1)
    yield clock.at(0)
    with open_psf(arguments["source"]) as opened:
        matrix = opened.T if arguments["turned"] else opened
        options = MatOptions(**told) if suffix == ".mat" else MatOptions(compress=False)
        written = mat_written(matrix, options) if suffix == ".mat" else matrix
        plane, crop = mat_plane(written, options, arguments["name"], z)
        with new_h5(out) as file:
            data = create_mat_data(file, PLANE, written, options, planes=1)
            store_plane(data, 0, plane, workers=workers)
            data.attrs[CROP] = crop
    yield clock.at(1)


def _join(parts: Sequence[Path], *, matrix: PSFMatrix, target: Path, options: ExportOptions) -> Work[None]:
    """Make the file of its planes."""
    if target.suffix.lower() == ".npy":
        yield from iter_write_npy(matrix, target, lambda z: _read(parts[z]))
    else:

        def store(name: str, z: int, data: Any) -> tuple[int, int]:
            return _take(parts[z if name == "H" else len(matrix) + z], data, z)

        yield from iter_write_mat(matrix, target, options.mat, store)


def _read(part: Path) -> NDArray[Any]:
    """Return the plane of a part that is stored plainly."""
    with H5File(part) as file:
        plane: NDArray[Any] = file.dataset(PLANE).read()[0]
        return plane


def _take(part: Path, data: Any, z: int) -> tuple[int, int]:
    """Copy the plane of a part into an open dataset, as it is stored; return its crop."""
    with H5File(part) as file:
        stored = file.dataset(PLANE)
        if data.chunks:
            copy_plane(stored, data, z)
        else:
            data[z] = stored.read()[0]
        crop = file.attributes(PLANE).numbers(CROP, (2,))
        assert crop is not None, "do_plane writes it"
        return int(crop[0]), int(crop[1])
