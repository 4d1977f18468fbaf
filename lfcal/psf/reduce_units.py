"""H within a tolerance, file to file, in units of a plane each: many at a time, and whole after a kill."""

from __future__ import annotations

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
from lfcal.psf.steps import check_store_tolerance
from lfcal.psf.store import PSFWriter, facts_of, stored_bytes, writer_of
from lfcal.work import RunChoice, Unit, iter_made

__all__ = ["do_plane", "iter_reduce_units"]


def iter_reduce_units(
    matrix: PSFMatrix, out: str | os.PathLike[str], tolerance: float, *, run: RunChoice, compression: str = "gzip"
) -> Work[Path]:
    """Write ``matrix``, which is that of a file, within a tolerance; values as of `lfcal.psf.iter_save`.

    Parameters
    ----------
    matrix
        H as `open_psf` gave it; workers open its file by its path.
    out
        File to write.
    tolerance
        Share (L1) that every pattern may lack; see `lfcal.psf.steps`.
    run
        By whom, and what becomes of an earlier run.
    compression
        As in `lfcal.psf.PSFWriter`.

    Raises
    ------
    InputError
        If ``matrix`` has no file, is an HT, or is not finite, or the tolerance is too small for steps.
    """
    check_other_file(matrix.path, out)
    if not matrix.path:
        raise InputError.expected("H", "one opened from a file", repr(matrix), "save it first")
    target = Path(out)
    stored = {"compression": compression, "store_tolerance": check_store_tolerance(tolerance)}
    require_space(target.parent, stored_bytes(matrix.shape, "float32", compression, tolerance), what=target.name)
    source, order = os.path.abspath(matrix.path), mat_order_of(matrix)
    writer = writer_of(matrix, target, workers=run.workers, compression=compression, store_tolerance=tolerance)
    units = [
        Unit(
            f"plane {z:04d}",
            f"{__name__}:{do_plane.__name__}",
            {"source": source, "z": z, "region": matrix.region, "mat_order": order, **stored},
            (source,),
        )
        for z in range(len(matrix))
    ]
    yield from iter_made(units, target, run, partial(iter_join, writer=writer), title=f"reduce to {target.name}")
    return target


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Write one plane within the tolerance into an H file of its own: the task of a unit."""
    z = int(arguments["z"])
    clock = Clock(f"reduce plane {z}", 1)
    yield clock.at(0)
    with open_psf(arguments["source"], region=arguments["region"], mat_order=arguments.get("mat_order", "")) as matrix:
        stated = matrix.stated_uncertainty
        with PSFWriter(
            out,
            (1, *matrix.shape[1:]),
            depths=matrix.known_depths[z : z + 1],
            compression=arguments["compression"],
            store_tolerance=arguments["store_tolerance"],
            workers=workers,
        ) as writer:
            uncertainty = None if stated is None else stated.plane(z)
            writer.write_plane(0, matrix.plane(z), facts=facts_of(matrix).plane(z), uncertainty=uncertainty)
    yield clock.at(1)
