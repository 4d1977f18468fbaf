"""Predict the processor time of a fit to frames from a few measured patterns."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from lfcal.fit import Fineness, Setup
from lfcal.recalibrate.model import WindowModel
from lfcal.recalibrate.score import STEPS
from lfcal.simulate import Sampling

__all__ = ["Round", "processor_seconds"]

Round = tuple[int, Sampling, float]
"""Iterations for the object, sampling, and fraction of the light whose voxels determine derivatives."""

LIT = 0.3
"""Typical fraction of voxels that contain most of the light of a frame, and that a projection changes."""

FINER = 2.25
"""Time of a pattern by fine sampling, relative to that by coarse sampling."""


def processor_seconds(model: WindowModel, setup: Setup, rounds: Sequence[Round], windows: int, unknowns: int) -> float:
    """Return the predicted processor time of a fit (s), within about a factor of 2.

    Parameters
    ----------
    model, setup
        Model of one of the windows, and the start of the fit.
    rounds
        Rounds of the fit.
    windows, unknowns
        Number of windows, and of unknowns.
    """
    base, pattern, product = _measured(model, setup)
    count, frames, k = model.voxels, len(model.frames), unknowns + 1
    seconds = 0.0
    for iterations, sampling, bright in (*rounds, rounds[-1]):  # the goodness of fit repeats the last round
        finer = FINER if sampling == Fineness.fine else 1.0
        seconds += finer * (base + count * pattern)
        seconds += k * finer * (base + LIT * count * pattern) if bright else 0.0
        seconds += 2 * frames * count * product * (iterations + STEPS * k * LIT)
    return windows * seconds


def _measured(model: WindowModel, setup: Setup) -> tuple[float, float, float]:
    """Return the processor time (s) of tables, of a pattern, and of a pattern in a sum over the volume or an image."""
    some = [model.rows_of(rows) for rows in (1, 3)]
    model.patterns(setup, Fineness.coarse, some[0])  # compiles the kernels
    taken = []
    for voxels in some:
        begin = time.process_time()
        patterns = model.patterns(setup, Fineness.coarse, voxels)
        taken.append(time.process_time() - begin)
    few, many = (len(voxels[0]) for voxels in some)
    pattern = max(0.0, taken[1] - taken[0]) / (many - few)
    volume = np.ones((1, many), np.float32)
    patterns.sums(patterns.images(volume))
    begin = time.process_time()
    patterns.sums(patterns.images(volume))
    return max(0.0, taken[0] - few * pattern), pattern, (time.process_time() - begin) / (2 * many)
