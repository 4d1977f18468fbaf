"""Flats sorted into levels of equal light, and what each level gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.frames.photon_transfer._pairs import Frames2, PairFinding, measure_pair
from lfcal.frames.photon_transfer.frame_list import CalibrationFrame

__all__ = ["FlatLevel", "measure_level", "sorted_levels"]

ALIKE = 0.10
"""Frames whose light differs by less are of one level; a pair allows for what they differ by."""


@dataclass(frozen=True, eq=False)
class FlatLevel:
    """Flats of one level of light.

    Attributes
    ----------
    exposure_s
        Their exposure (s), None where not known.
    bright
        Their mean less the dark ``(rows, columns)`` (sample values).
    count
        How many they are.
    pairs
        What each pair of them gives.
    lagging
        Half variance of the first and third frame's difference over that of first and second; None with fewer frames.
    """

    exposure_s: float | None
    bright: NDArray[np.float32]
    count: int
    pairs: tuple[PairFinding, ...]
    lagging: float | None = None


def sorted_levels(
    frames: Sequence[CalibrationFrame], means: Sequence[float], black: float
) -> list[list[CalibrationFrame]]:
    """Return the flats by level: of one folder and exposure each, and of like light where these say nothing.

    Frames keep their order. Whatever is stated, frames whose mean above ``black`` differs by more than `ALIKE` are of
    different levels. Levels come from dim to bright.
    """
    levels: list[tuple[tuple[str, float | None], list[float], list[CalibrationFrame]]] = []
    for frame, mean in zip(frames, means, strict=True):
        key, light = (frame.group, frame.exposure_s), mean - black
        for own, lights, held in levels:
            if own == key and abs(light - lights[0]) <= ALIKE * max(abs(lights[0]), abs(light)):
                lights.append(light)
                held.append(frame)
                break
        else:
            levels.append((key, [light], [frame]))
    return [held for _, _, held in sorted(levels, key=lambda level: float(np.mean(level[1])))]


def measure_level(
    frames: Sequence[CalibrationFrame], dark: NDArray[np.float32], good: NDArray[np.bool_], cfa: str
) -> FlatLevel:
    """Return what the flats of one level give; one frame alone gives its mean only."""
    total = np.zeros(dark.shape)
    for frame in frames:
        total += frame.read()
    bright = (total / len(frames) - dark).astype(np.float32)
    pairs, lagging = [], None
    for k in range(0, len(frames) - 1, 2):
        first, second = frames[k].read(), frames[k + 1].read()
        pair = Frames2(first, second, dark, bright, good, cfa, len(frames))
        pairs.append(measure_pair(pair))
        if k == 0 and len(frames) > 2:
            third = measure_pair(Frames2(first, frames[2].read(), dark, bright, good, cfa, len(frames)))
            lagging = _ratio(third, pairs[0])
    return FlatLevel(frames[0].exposure_s, bright, len(frames), tuple(pairs), lagging)


def _ratio(one: PairFinding, other: PairFinding) -> float | None:
    """Return the variance of one pair over that of another, over their common pixels."""
    sums = [float((p.points.y * p.points.n).sum()) / max(1, int(p.points.n.sum())) for p in (one, other)]
    return sums[0] / sums[1] if sums[1] > 0 else None
