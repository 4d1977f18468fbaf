"""H file to HT file in bounded memory."""

from __future__ import annotations

import os
from pathlib import Path

from lfcal.files import check_other_file
from lfcal.progress import Clock, Work
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import PSFWriter, facts_of, iter_save, writer_of
from lfcal.psf.transpose import transpose

__all__ = ["iter_transpose_file", "writer_of_transpose"]


def iter_transpose_file(
    matrix: PSFMatrix,
    out: str | os.PathLike[str],
    *,
    method: str = "exact",
    compression: str = "gzip",
    workers: int | None = None,
) -> Work[Path]:
    """Write the transpose of ``matrix`` to an H file; one plane of H and one of HT are in memory.

    ``method`` is that of `lfcal.psf.transpose`.
    """
    check_other_file(matrix.path, out)
    if method == "exact":
        return (yield from iter_save(matrix.T, out, compression=compression, workers=workers))
    clock = Clock("transpose planes", len(matrix))
    with writer_of_transpose(matrix, out, method, compression=compression, workers=workers) as writer:
        for z in range(len(matrix)):
            writer.write_plane(z, transpose(matrix.plane(z)[None], method=method)[0], facts=facts_of(matrix).plane(z))
            yield clock.at(z + 1)
    return Path(out)


def writer_of_transpose(
    matrix: PSFMatrix, out: str | os.PathLike[str], method: str, *, compression: str, workers: int | None
) -> PSFWriter:
    """Return what writes the transpose of ``matrix`` to a file, not yet entered."""
    if method == "exact":
        return writer_of(matrix.T, out, compression=compression, workers=workers)
    # of another method it cannot be made back into H
    note = {"transpose": method}
    return writer_of(matrix, out, compression=compression, workers=workers, transposed=True, region="", provenance=note)
