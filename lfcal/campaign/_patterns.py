"""The patterns of a session as a fit takes them: corrected by its own darks, upright, some of them kept aside."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lfcal.acquire import RecordingSource
from lfcal.base import InputError, Work
from lfcal.fit import Measured, measured_of
from lfcal.frames import CorrectionRecipe, corrected_view, oriented
from lfcal.psf import iter_pick, iter_upright, scan_noise

__all__ = ["iter_session_patterns"]


def iter_session_patterns(folder: Path) -> Work[Measured]:
    """Return the patterns of every position of a session; yields progress in positions.

    Raises
    ------
    InputError
        If the frames certainly do not lie as the plan says, or their noise is not known.
    StorageError, FileFormatError
        If there is no session, or it is damaged.
    """
    with RecordingSource(folder) as source:
        view = corrected_view(source, CorrectionRecipe(), source.plan)
        turn, _ = yield from iter_upright(view, source.plan)
        upright = oriented(view, turn, source.plan.camera.sensor.shape)
        index = np.unique(np.array([source.info(k).position for k in range(len(source))], np.intp), axis=0)
        matrix = yield from iter_pick(upright, source.plan, index, noise=scan_noise(upright, source.plan))
        noise = matrix.facts.noise
        known = None if noise is None else noise[tuple(index.T)]
        if known is None or not np.isfinite(known).all() or (known[:, 0] < 0).any():
            got, remedy = "none", "record single exposures with dark frames, of a camera whose noise is stated"
            raise InputError.expected(f"{folder}, noise of the frames", "a variance", got, remedy)
        aside = source.metadata.kept_aside
        return measured_of(matrix, left_out=[list(p) for p in aside])
