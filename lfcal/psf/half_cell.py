"""Find the patterns of H that were copied from another position, in a half-cell scan."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.psf.matrix import PSFMatrix

__all__ = ["copied_positions"]


def copied_positions(matrix: PSFMatrix) -> NDArray[np.bool_]:
    """Return a boolean map ``(nz, ny, nx)`` of the positions of H whose pattern was recorded half a period away.

    These patterns are not independent measurements, so neither a fit nor an estimate of repeatability may use them.
    """
    shape = (matrix.shape[0], *matrix.period)
    flat = np.zeros(int(np.prod(shape)), np.bool_)
    said = matrix.provenance.get("half_cell")
    # provenance comes from a file that anyone may have written
    runs = said.get("positions") if isinstance(said, dict) else None
    for run in runs if isinstance(runs, list) else ():
        if isinstance(run, list) and len(run) == 2 and all(type(v) is int and 0 <= v <= flat.size for v in run):
            flat[run[0] : run[1]] = True
    return flat.reshape(shape)
