"""Determine the noise of new frames: given by the user, stated by the frames or by H, or measured on dark pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from lfcal.base import InputError, check_number
from lfcal.fit.locate import NewFrame
from lfcal.psf import PSFMatrix

__all__ = ["DARK", "noises_of"]

DARK = "from the frame's dark pixels; the photon noise is unknown"
"""Source of a noise that does not include photon noise, so that scatter in frames may be photon noise."""


def noises_of(
    matrix: PSFMatrix, frames: Sequence[NewFrame], given: tuple[float, float] | None
) -> tuple[list[tuple[float, float]], str]:
    """Return the constant and slope of the variance of each frame, and the source of these values as text."""
    if given is not None:
        for name, value in zip(("constant", "slope"), given, strict=True):
            check_number(f"noise: {name}", value, at_least=0)
        if sum(given) <= 0:
            raise InputError.expected(
                "noise of the frames", "a variance above 0", "0", "state a constant or a slope above 0"
            )
        return [given] * len(frames), "as stated"
    if all(frame.noise is not None and _sound(frame.noise) for frame in frames):
        return [frame.noise for frame in frames if frame.noise is not None], "as the frames state"
    known = matrix.facts.noise
    if known is not None:
        # H states the noise of the mean of its repeated frames
        every = np.asarray(known, np.float64) * np.asarray(matrix.recorded, np.float64)[..., None]
        every = every[(matrix.recorded > 0) & np.isfinite(every).all(-1)]
        if len(every):
            typical = tuple(float(v) for v in np.median(every, axis=0))
            if _sound((typical[0], typical[1])):
                return [(typical[0], typical[1])] * len(frames), "as H states"
    return [(_dark_variance(frame), 0.0) for frame in frames], DARK


def _sound(noise: tuple[float, float]) -> bool:
    return min(noise) >= 0 and sum(noise) > 0 and all(math.isfinite(v) for v in noise)


def _dark_variance(frame: NewFrame) -> float:
    """Return the variance of neighbouring samples in areas with almost no light."""
    values = np.asarray(frame.values, np.float64)
    good = np.isfinite(values) if frame.valid is None else np.isfinite(values) & frame.valid
    steps = (values[:, 1:] - values[:, :-1])[good[:, 1:] & good[:, :-1] & (values[:, 1:] <= np.median(values[good]))]
    # from differences of two samples; at least the noise of rounding to whole numbers
    spread = float(np.median(np.abs(steps))) / 0.6745 if steps.size else 0.0
    return max(spread**2 / 2, 1 / 12)
