"""H for other programs: ``.h5``, MATLAB ``.mat``, ``.npy``, TIFF stacks."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from lfcal.errors import InputError
from lfcal.files import check_other_file, replace_whole, require_space, storage_errors
from lfcal.npy import npy_header
from lfcal.progress import Clock, Work, drain
from lfcal.psf.matlab import iter_write_mat
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import iter_save
from lfcal.tiff_file import write_tiff

__all__ = ["WRITERS", "ExportOptions", "export", "export_files", "iter_export"]


def iter_write_npy(matrix: PSFMatrix, path: str | os.PathLike[str]) -> Work[Path]:
    """Write an ``.npy`` file that numpy can memory-map, one plane at a time.

    It is written, not mapped: a map onto a disk that fills up ends the process instead of raising an error.
    """
    target = Path(path)
    require_space(target.parent, matrix.nbytes, what=target.name)
    clock = Clock("write npy file", len(matrix))
    with storage_errors(target), replace_whole(target) as part, part.open("wb") as file:
        file.write(npy_header(matrix.shape, matrix.dtype))
        for z in range(len(matrix)):
            file.write(np.ascontiguousarray(matrix.plane(z), matrix.dtype).data)
            yield clock.at(z + 1)
    return target


def _stack_name(target: Path, z: int) -> Path:
    return target.with_name(f"{target.stem}_z{z:03d}{target.suffix}")


def iter_write_tiff(
    matrix: PSFMatrix, path: str | os.PathLike[str], *, position: tuple[int, int] | None = None
) -> Work[Path]:
    """Write TIFF stacks of single patterns.

    Without ``position`` one stack per depth plane, ``NAME_z000.tif`` …, its pages in the order of
    positions (y slow, x fast). With ``position`` (y, x) a single stack over depth.
    """
    target = Path(path)
    require_space(target.parent, matrix.nbytes if position is None else matrix.nbytes // len(matrix), what=target.name)
    if position is not None:
        y, x = position
        if not (0 <= y < matrix.period[0] and 0 <= x < matrix.period[1]):
            raise InputError.expected("position (y, x)", f"inside {matrix.period}", position, "choose another")
        write_tiff(target, np.stack([matrix[z, y, x] for z in range(len(matrix))]), metadata={"axes": "ZYX"})
        yield Clock("write TIFF stack", 1).at(1)
        return target
    clock = Clock("write TIFF stacks", len(matrix))
    for z in range(len(matrix)):
        plane = matrix.plane(z)
        # classic TIFF counts offsets in 32 bits, and 2 GiB leaves room for the tags of many pages
        pages = plane.reshape(-1, *plane.shape[2:])
        write_tiff(_stack_name(target, z), pages, bigtiff=pages.nbytes > 1 << 31, metadata={"axes": "IYX"})
        yield clock.at(z + 1)
    return target


@dataclass(frozen=True)
class ExportOptions:
    """What may be said of an export; None leaves it to the format.

    Attributes
    ----------
    compress
        ``.h5``, ``.mat``: compressed, or not.
    dtype
        ``.h5``: stored type.
    include_transpose, rows_first
        ``.mat``: as in `lfcal.psf.matlab.iter_write_mat`.
    position
        TIFF: position (y, x) of which a stack over depth is written, instead of one stack per plane.
    """

    compress: bool | None = None
    dtype: str | None = None
    include_transpose: bool | None = None
    rows_first: bool | None = None
    position: tuple[int, int] | None = None

    def given(self) -> dict[str, Any]:
        """Return what was said, by name."""
        found = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: value for name, value in found.items() if value is not None}


def _write_h5(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> Work[Path]:
    return iter_save(matrix, path, dtype=options.dtype, compression="none" if options.compress is False else "gzip")


def _write_mat(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> Work[Path]:
    return iter_write_mat(
        matrix,
        path,
        include_transpose=options.include_transpose is not False,
        rows_first=bool(options.rows_first),
        compress=options.compress is not False,
    )


def _write_npy(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> Work[Path]:
    return iter_write_npy(matrix, path)


def _write_tiff(matrix: PSFMatrix, path: str | os.PathLike[str], options: ExportOptions) -> Work[Path]:
    return iter_write_tiff(matrix, path, position=options.position)


class _Writer(NamedTuple):
    """How a format is written, and the options it uses."""

    write: Callable[[PSFMatrix, str | os.PathLike[str], ExportOptions], Work[Path]]
    uses: frozenset[str]


_TIFF = _Writer(_write_tiff, frozenset({"position"}))
WRITERS = {
    ".h5": _Writer(_write_h5, frozenset({"compress", "dtype"})),
    ".mat": _Writer(_write_mat, frozenset({"compress", "include_transpose", "rows_first"})),
    ".npy": _Writer(_write_npy, frozenset()),
    ".tif": _TIFF,
    ".tiff": _TIFF,
}
"""Formats by suffix."""


def export_files(path: str | os.PathLike[str], planes: int, position: tuple[int, int] | None = None) -> list[Path]:
    """Return the files that an export of ``planes`` depth planes to ``path`` writes: of TIFF stacks, one a plane."""
    target = Path(path)
    if WRITERS.get(target.suffix.lower()) is not _TIFF or position is not None:
        return [target]
    return [_stack_name(target, z) for z in range(planes)]


def iter_export(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    *,
    compress: bool | None = None,
    dtype: str | None = None,
    include_transpose: bool | None = None,
    rows_first: bool | None = None,
    position: tuple[int, int] | None = None,
) -> Work[Path]:
    """Write ``matrix`` in the format of the suffix.

    ``.h5`` H file, ``.mat`` MATLAB v7.3 (H, Ht, Nnum, CAindex, x3objspace), ``.npy``, ``.tif`` stacks. For the options
    see `ExportOptions`.

    Raises
    ------
    InputError
        For an unknown suffix, or an option that its format does not use.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        raise InputError.expected("export format", " ".join(WRITERS), suffix or "no suffix", "name the file so")
    options = ExportOptions(compress, dtype, include_transpose, rows_first, position)
    for name in options.given():
        if name not in WRITERS[suffix].uses:
            used = ", ".join(sorted(WRITERS[suffix].uses)) or "none"
            raise InputError.expected(f"options of {suffix} files", used, name, "leave it out")
    check_other_file(matrix.path, path)
    return WRITERS[suffix].write(matrix, path, options)


def export(
    matrix: PSFMatrix,
    path: str | os.PathLike[str],
    *,
    compress: bool | None = None,
    dtype: str | None = None,
    include_transpose: bool | None = None,
    rows_first: bool | None = None,
    position: tuple[int, int] | None = None,
) -> Path:
    """Write ``matrix`` at once; see `iter_export`."""
    return drain(
        iter_export(
            matrix,
            path,
            compress=compress,
            dtype=dtype,
            include_transpose=include_transpose,
            rows_first=rows_first,
            position=position,
        )
    )
