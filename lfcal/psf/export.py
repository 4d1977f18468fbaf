"""H for other programs: ``.h5``, MATLAB ``.mat``, ``.npy``, TIFF stacks."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lfcal.errors import InputError
from lfcal.files import replace_whole, require_space, storage_errors
from lfcal.progress import Clock, Work, drain
from lfcal.psf.matlab import iter_write_mat
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import iter_save

__all__ = ["SUFFIXES", "export", "iter_export"]


def iter_write_npy(matrix: PSFMatrix, path: str | os.PathLike[str]) -> Work[Path]:
    """Write an ``.npy`` file that numpy can memory-map, one plane at a time."""
    target = Path(path)
    # checked beforehand: a full disk after an hour of writing would be worse
    require_space(target.parent, matrix.nbytes, what=target.name)
    clock = Clock("write npy file", len(matrix))
    with replace_whole(target) as part:
        with storage_errors(target):
            out = np.lib.format.open_memmap(part, mode="w+", dtype=matrix.dtype, shape=matrix.shape)
        for z in range(len(matrix)):
            out[z] = matrix.plane(z)
            yield clock.at(z + 1)
        out.flush()
        # on Windows a mapped file cannot be renamed
        del out
    return target


def iter_write_tiff(
    matrix: PSFMatrix, path: str | os.PathLike[str], *, position: tuple[int, int] | None = None
) -> Work[Path]:
    """Write TIFF stacks of single patterns.

    Without ``position`` one stack per depth plane, ``NAME_z000.tif`` …, its pages in the order of
    positions (y slow, x fast). With ``position`` (y, x) a single stack over depth.
    """
    import tifffile

    target = Path(path)
    require_space(target.parent, matrix.nbytes if position is None else matrix.nbytes // len(matrix), what=target.name)
    if position is not None:
        y, x = position
        if not (0 <= y < matrix.period[0] and 0 <= x < matrix.period[1]):
            raise InputError.expected("position (y, x)", f"inside {matrix.period}", position, "choose another")
        with replace_whole(target) as part, storage_errors(target):
            stack = np.stack([matrix[z, y, x] for z in range(len(matrix))])
            tifffile.imwrite(part, stack, photometric="minisblack", metadata={"axes": "ZYX"})
        yield Clock("write TIFF stack", 1).at(1)
        return target
    clock = Clock("write TIFF stacks", len(matrix))
    for z in range(len(matrix)):
        name = target.with_name(f"{target.stem}_z{z:03d}{target.suffix}")
        with replace_whole(name) as part, storage_errors(name):
            plane = matrix.plane(z)
            # classic TIFF counts offsets in 32 bits, and 2 GiB leaves room for the tags of many pages
            pages = plane.reshape(-1, *plane.shape[2:])
            tifffile.imwrite(
                part, pages, photometric="minisblack", bigtiff=pages.nbytes > 1 << 31, metadata={"axes": "IYX"}
            )
        yield clock.at(z + 1)
    return target


SUFFIXES: dict[str, Callable[..., Work[Path]]] = {
    ".h5": iter_save,
    ".mat": iter_write_mat,
    ".npy": iter_write_npy,
    ".tif": iter_write_tiff,
    ".tiff": iter_write_tiff,
}
"""File suffix to writer."""


def iter_export(matrix: PSFMatrix, path: str | os.PathLike[str], **options: Any) -> Work[Path]:
    """Write ``matrix`` in the format of the suffix; options are those of its writer.

    ``.h5`` H file, ``.mat`` MATLAB v7.3 (H, Ht, Nnum, CAindex, x3objspace), ``.npy``, ``.tif`` stacks.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise InputError.expected("export format", " ".join(SUFFIXES), suffix or "no suffix", "name the file so")
    return SUFFIXES[suffix](matrix, path, **options)


def export(matrix: PSFMatrix, path: str | os.PathLike[str], **options: Any) -> Path:
    """Write ``matrix`` at once; see `iter_export`."""
    return drain(iter_export(matrix, path, **options))
