"""H file to HT file in bounded memory."""

from __future__ import annotations

import os
from pathlib import Path

from lfcal.files import check_other_file
from lfcal.progress import Clock, Work
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import STORED_TYPES, PSFWriter, facts_of, iter_save
from lfcal.psf.transpose import transpose

__all__ = ["iter_transpose_file"]


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
    stored = matrix.dtype.name if matrix.dtype.name in STORED_TYPES else "float32"
    with PSFWriter(
        out,
        matrix.shape,
        depths=matrix.depths,
        camera=matrix.camera,
        anchor=matrix.anchor,
        dtype=stored,
        compression=compression,
        provenance={**matrix.provenance, "transpose": method},
        transposed=True,
        workers=workers,
    ) as writer:
        for z in range(len(matrix)):
            writer.write_plane(z, transpose(matrix.plane(z)[None], method=method)[0], facts=facts_of(matrix).plane(z))
            yield clock.at(z + 1)
    return Path(out)
