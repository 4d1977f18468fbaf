"""Sensor properties from flats: levels of light, linearity (EMVA 1288 release 4, section 6), pixel differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.frames.cfa import phases
from lfcal.frames.photon_transfer._curve import PhotonTransferCurve
from lfcal.frames.photon_transfer._pairs import FramePair, PairFinding, measure_pair
from lfcal.frames.photon_transfer._values import MeasuredValue
from lfcal.frames.photon_transfer.frame_list import CalibrationFrame

__all__ = ["FlatLevel", "find_dead", "measure_level", "measure_linearity", "measure_prnu", "sorted_levels"]

LEVEL_TOLERANCE = 0.10
"""Frames whose light differs by at most this fraction may belong to one level; pairs correct for the difference."""


@dataclass(frozen=True, eq=False)
class FlatLevel:
    """Flats of one level of light.

    Attributes
    ----------
    exposure_s
        Exposure (s), None if unknown.
    bright
        Mean minus the dark ``(rows, columns)`` (sample values).
    count
        Number of flats.
    pairs
        Result of each pair.
    lagging
        Variance of the difference between first and third frame, divided by that between first and second; None with
        fewer than three frames.
    """

    exposure_s: float | None
    bright: NDArray[np.float32]
    count: int
    pairs: tuple[PairFinding, ...]
    lagging: float | None = None


def sorted_levels(
    frames: Sequence[CalibrationFrame], means: Sequence[float], black: float
) -> list[list[CalibrationFrame]]:
    """Return the flats by level: with the same folder and exposure, or of similar light if these are unknown.

    Frames keep their order. In any case, frames whose mean above ``black`` differs by more than `LEVEL_TOLERANCE`
    belong to different levels. Levels are sorted from dim to bright.
    """
    levels: list[tuple[tuple[str, float | None], list[float], list[CalibrationFrame]]] = []
    for frame, mean in zip(frames, means, strict=True):
        key, light = (frame.group, frame.exposure_s), mean - black
        for own, lights, held in levels:
            if own == key and abs(light - lights[0]) <= LEVEL_TOLERANCE * max(abs(lights[0]), abs(light)):
                lights.append(light)
                held.append(frame)
                break
        else:
            levels.append((key, [light], [frame]))
    return [held for _, _, held in sorted(levels, key=lambda level: float(np.mean(level[1])))]


def measure_level(
    frames: Sequence[CalibrationFrame], dark: NDArray[np.float32], good: NDArray[np.bool_], cfa: str
) -> FlatLevel:
    """Return the result for the flats of one level; a single frame gives only its mean."""
    total = np.zeros(dark.shape)
    for frame in frames:
        total += frame.read()
    bright = (total / len(frames) - dark).astype(np.float32)
    pairs, lagging = [], None
    for k in range(0, len(frames) - 1, 2):
        first, second = frames[k].read(), frames[k + 1].read()
        pair = FramePair(first, second, dark, bright, good, cfa, len(frames))
        pairs.append(measure_pair(pair))
        if k == 0 and len(frames) > 2:
            third = measure_pair(FramePair(first, frames[2].read(), dark, bright, good, cfa, len(frames)))
            lagging = _ratio(third, pairs[0])
    return FlatLevel(frames[0].exposure_s, bright, len(frames), tuple(pairs), lagging)


def _ratio(one: PairFinding, other: PairFinding) -> float | None:
    """Return the ratio of the variances of two pairs, over their common pixels."""
    sums = [float((p.points.y * p.points.n).sum()) / max(1, int(p.points.n.sum())) for p in (one, other)]
    return sums[0] / sums[1] if sums[1] > 0 else None


LINEAR_RANGE = (0.05, 0.95)
"""Range of the signal, as fractions of saturation, for which EMVA defines linearity."""


def measure_linearity(
    levels: Sequence[FlatLevel], good: NDArray[np.bool_], top: float, dark_rate: float, shortest_s: float
) -> tuple[MeasuredValue | None, str]:
    """Return the largest relative deviation of the signal from a line over exposure; or None, and the reason.

    Parameters
    ----------
    levels
        Flats of one lamp at several exposures.
    good
        Mask of the good pixels.
    top
        Signal above black at saturation (sample values).
    dark_rate, shortest_s
        Growth of the dark level with exposure (sample values per second), and exposure of the subtracted dark (s).
    """
    known = [level for level in levels if level.exposure_s and level.count]
    if len({level.exposure_s for level in known}) < 3:
        return None, "linearity: unknown; record flats of three or more exposures with the same light"
    pixels = _similar_pixels(known, good, top)
    x, y, sigma = [], [], []
    for level in known:
        seconds = float(level.exposure_s or 0)
        light = level.bright[pixels]
        value = float(light.mean(dtype=np.float64)) - dark_rate * (seconds - shortest_s)
        if LINEAR_RANGE[0] * top <= value <= LINEAR_RANGE[1] * top and float(np.percentile(light, 99.9)) < 0.98 * top:
            x.append(seconds)
            y.append(value)
            change = [abs(pair.change) for pair in level.pairs] or [0.0]
            # fluctuations of the lamp are not due to the sensor
            sigma.append(value * float(np.mean(change)) / np.sqrt(2 * len(change)) + 1e-4 * value)
    if len(set(x)) < 3:
        return None, "linearity: unknown, because fewer than three exposures are between 5 and 95 % of saturation"
    seconds_, values, errors = np.array(x), np.array(y), np.array(sigma)
    # relative deviations are minimised, as EMVA requires: dim and bright levels have equal weight
    base = np.stack([1 / values, seconds_ / values], axis=1)
    line, *_ = np.linalg.lstsq(base, np.ones(values.size), rcond=None)
    fitted = line[0] + line[1] * seconds_
    away = np.abs(values - fitted) / fitted
    return MeasuredValue(float(away.max()), float(errors[away.argmax()] / values[away.argmax()])), ""


def _similar_pixels(levels: Sequence[FlatLevel], good: NDArray[np.bool_], top: float) -> NDArray[np.bool_]:
    """Return pixels of similar brightness, because with lenslets the brightest saturate long before the others."""
    response = np.sum(
        [level.bright for level in levels if float(level.bright.mean()) < 0.6 * top] or [levels[0].bright], axis=0
    )
    inside = response[good]
    low, middle, high = np.percentile(inside, (5, 50, 95)).tolist()
    if high - low < 0.2 * abs(middle):
        return good
    chosen: NDArray[np.bool_] = good & (response > np.percentile(inside, 70)) & (response < np.percentile(inside, 90))
    return chosen


BOX = 5
"""Side of the neighbourhood whose mean estimates the light at a pixel."""

STRUCTURED = 0.15
"""Correlation of neighbours in the residual above which it is not a pattern of single pixels."""


def measure_prnu(
    level: FlatLevel, curve: PhotonTransferCurve, dark_variance: float, good: NDArray[np.bool_], cfa: str
) -> tuple[MeasuredValue | None, str]:
    """Return the relative rms of the pixels' responses; or None, and the reason why it is undetermined.

    The light is assumed to be smooth over `BOX` pixels of one colour. The remaining temporal noise in the mean of the
    flats is subtracted (EMVA 1288 release 4, section 8). Micro-images are not smooth: for them the result is unknown.

    Parameters
    ----------
    level
        Flats near half of saturation.
    curve
        Photon-transfer curve: variance of a sample against its signal.
    dark_variance
        Variance of a pixel in the subtracted mean dark (squared sample values).
    good
        Mask of the good pixels.
    cfa
        Colour filter pattern.
    """
    squares, noise, count, alike = 0.0, 0.0, 0, [0.0]
    for rows, columns in phases(cfa):
        part, use = level.bright[rows, columns].astype(np.float64), good[rows, columns]
        local = _local(part, use)
        inner = use & (local > 0.2 * float(part[use].mean()))
        residual = np.where(inner, (part - local) / np.where(inner, local, 1), 0.0)
        own = float((residual**2).sum())
        squares, count = squares + own, count + int(inner.sum())
        left = curve.variance(local[inner]) / level.count + dark_variance
        noise += float((left / local[inner] ** 2).sum())
        along = (float((residual[1:] * residual[:-1]).sum()), float((residual[:, 1:] * residual[:, :-1]).sum()))
        alike += [abs(one) / max(own, 1e-300) for one in along]
    if count < 1000:
        return None, "pixel response (PRNU): unknown, because too few pixels are lit"
    if max(alike) > STRUCTURED:
        return (
            None,
            "pixel response (PRNU): unknown, because the flats have structure; record flats without the lenslets",
        )
    # the residual from the mean over a box that includes the pixel has (1 - 1/box) of the pixel's variance
    seen = squares / count / (1 - 1 / BOX**2)
    chance = float(seen * np.sqrt(2 / count)) + 0.02 * noise / count
    found = MeasuredValue(seen - noise / count, chance).root()
    if found.value < 2 * found.sigma:
        return None, f"pixel response (PRNU): below {100 * 2 * found.sigma:.2g} %, hidden by noise; average more flats"
    return found, ""


def _local(part: NDArray[np.float64], use: NDArray[np.bool_]) -> NDArray[np.float64]:
    from scipy import ndimage

    weight = ndimage.uniform_filter(use.astype(np.float64), BOX, mode="nearest")
    light = ndimage.uniform_filter(np.where(use, part, 0.0), BOX, mode="nearest")
    return light / np.maximum(weight, 1e-3)


def find_dead(bright: NDArray[np.float32], good: NDArray[np.bool_], noise: float, cfa: str) -> NDArray[np.bool_]:
    """Return a mask of the pixels with less than a quarter of the light of their third-dimmest neighbour.

    Neighbours are the nearest eight of the same colour; even at the edge of a micro-image, most of them are lit.
    """
    from scipy import ndimage

    dead = np.zeros(bright.shape, np.bool_)
    around = np.ones((3, 3), bool)
    around[1, 1] = False
    for rows, columns in phases(cfa):
        part = bright[rows, columns]
        low = ndimage.rank_filter(part, rank=2, footprint=around, mode="nearest")
        dead[rows, columns] = (part < 0.25 * low) & (low > 20 * max(noise, 0.3)) & good[rows, columns]
    return dead
