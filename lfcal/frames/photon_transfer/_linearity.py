"""Signal over exposure: by how much it departs from a line (EMVA 1288 release 4, section 6)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lfcal.frames.photon_transfer._levels import FlatLevel
from lfcal.frames.photon_transfer.values import MeasuredValue

__all__ = ["measure_linearity"]

RANGE = (0.05, 0.95)
"""Share of saturation within which EMVA asks for it."""


def measure_linearity(
    levels: Sequence[FlatLevel], good: NDArray[np.bool_], top: float, dark_rate: float, shortest_s: float
) -> tuple[MeasuredValue | None, str]:
    """Return the largest relative departure of the signal from a line over exposure, and why there is none.

    Parameters
    ----------
    levels
        Flats of one lamp at several exposures.
    good
        Pixels without defect.
    top
        Signal above black at saturation (sample values).
    dark_rate, shortest_s
        Growth of the dark level (sample values per second) since the exposure of the dark that was subtracted (s).
    """
    known = [level for level in levels if level.exposure_s and level.count]
    if len({level.exposure_s for level in known}) < 3:
        return None, "linearity: unknown, for it takes flats of three or more exposures under one lamp"
    pixels = _alike(known, good, top)
    x, y, sigma = [], [], []
    for level in known:
        seconds = float(level.exposure_s or 0)
        light = level.bright[pixels]
        value = float(light.mean(dtype=np.float64)) - dark_rate * (seconds - shortest_s)
        if RANGE[0] * top <= value <= RANGE[1] * top and float(np.percentile(light, 99.9)) < 0.98 * top:
            x.append(seconds)
            y.append(value)
            change = [abs(pair.change) for pair in level.pairs] or [0.0]
            # the lamp's own unrest is not the sensor's
            sigma.append(value * float(np.mean(change)) / np.sqrt(2 * len(change)) + 1e-4 * value)
    if len(set(x)) < 3:
        return None, "linearity: unknown, for fewer than three exposures lie between 5 and 95 % of saturation"
    seconds_, values, errors = np.array(x), np.array(y), np.array(sigma)
    # relative deviations are minimised, as EMVA asks: each level counts alike, dim or bright
    base = np.stack([1 / values, seconds_ / values], axis=1)
    line, *_ = np.linalg.lstsq(base, np.ones(values.size), rcond=None)
    fitted = line[0] + line[1] * seconds_
    away = np.abs(values - fitted) / fitted
    return MeasuredValue(float(away.max()), float(errors[away.argmax()] / values[away.argmax()])), ""


def _alike(levels: Sequence[FlatLevel], good: NDArray[np.bool_], top: float) -> NDArray[np.bool_]:
    """Return pixels of like brightness, for under lenslets the brightest saturate long before the others."""
    response = np.sum(
        [level.bright for level in levels if float(level.bright.mean()) < 0.6 * top] or [levels[0].bright], axis=0
    )
    inside = response[good]
    low, middle, high = np.percentile(inside, (5, 50, 95)).tolist()
    if high - low < 0.2 * abs(middle):
        return good
    chosen: NDArray[np.bool_] = good & (response > np.percentile(inside, 70)) & (response < np.percentile(inside, 90))
    return chosen
