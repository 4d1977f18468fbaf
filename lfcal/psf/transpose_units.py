"""H file to HT file in units of a plane each: many at a time, and whole after a kill."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from lfcal.errors import InputError
from lfcal.files import check_other_file, require_space
from lfcal.progress import Clock, Work
from lfcal.psf.joining import iter_join
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.opening import mat_order_of, open_psf
from lfcal.psf.store import PSFWriter, facts_of, stored_type
from lfcal.psf.transpose import transpose
from lfcal.psf.transpose_file import writer_of_transpose
from lfcal.work import RunChoice, Unit, iter_made

__all__ = ["do_plane", "iter_transpose_units"]


def iter_transpose_units(
    matrix: PSFMatrix,
    out: str | os.PathLike[str],
    *,
    run: RunChoice,
    method: str = "exact",
    compression: str = "gzip",
) -> Work[Path]:
    """Write the transpose of ``matrix``, which is that of a file, as `iter_transpose_file` does, plane by plane.

    Parameters
    ----------
    matrix
        As `open_psf` gave it; workers open its file by its path.
    out
        File to write.
    run
        By whom, and what becomes of an earlier run.
    method, compression
        As in `iter_transpose_file`.

    Raises
    ------
    InputError
        If ``matrix`` has no file.
    """
    check_other_file(matrix.path, out)
    if not matrix.path:
        raise InputError.expected("H", "one opened from a file", repr(matrix), "save it first")
    target = Path(out)
    require_space(target.parent, math.prod(matrix.shape) * matrix.dtype.itemsize, what=target.name)
    how = {"method": method, "compression": compression, "dtype": stored_type(matrix), "region": matrix.region}
    how["mat_order"] = mat_order_of(matrix)
    source = os.path.abspath(matrix.path)
    units = [
        Unit(f"plane {z:04d}", f"{__name__}:{do_plane.__name__}", {"source": source, "z": z, **how}, (source,))
        for z in range(len(matrix))
    ]
    writer = writer_of_transpose(matrix, target, method, compression=compression, workers=run.workers)
    yield from iter_made(units, target, run, partial(iter_join, writer=writer), title=f"transpose to {target.name}")
    return target


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Transpose one plane into an H file of its own: the task of a unit."""
    z, exact = int(arguments["z"]), arguments["method"] == "exact"
    clock = Clock(f"transpose plane {z + 1}", 1)
    yield clock.at(0)
    with open_psf(arguments["source"], region=arguments["region"], mat_order=arguments.get("mat_order", "")) as matrix:
        plane = matrix.T.plane(z) if exact else transpose(matrix.plane(z)[None], method=arguments["method"])[0]
        stated = matrix.T.stated_uncertainty if exact else None
        with PSFWriter(
            out,
            (1, *matrix.shape[1:]),
            depths=matrix.known_depths[z : z + 1],
            dtype=arguments["dtype"],
            compression=arguments["compression"],
            transposed=not matrix.is_transposed,
            workers=workers,
        ) as writer:
            uncertainty = None if stated is None else stated.plane(z)
            writer.write_plane(0, plane, facts=facts_of(matrix).plane(z), uncertainty=uncertainty)
    yield clock.at(1)
