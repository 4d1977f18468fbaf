"""Find the constant pedestal that a wrong or unsubtracted black level would leave in H, before any other work."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, clipped
from lfcal.psf.cutout import Gatherer

__all__ = ["LIMIT", "check_pedestal", "pedestal_share"]

LIMIT = 0.02
"""Largest fraction of a plane's light that may be a constant pedestal."""

SAMPLED = 8
"""Smallest number of frames of a plane that are examined; all if there are fewer."""

CERTAIN = 4.0
"""Number of standard errors above which a level counts as different from zero."""

CERTAIN_OF_BLOCKS = 5.0
"""Number of standard errors above which the level of the darkest block counts as different from zero.

It is higher than `CERTAIN`, as noise alone makes one of the blocks darker than the others.
"""

BLOCKS = 8
"""Number of blocks along each axis into which cutouts are divided to find their darkest part."""


def pedestal_share(gatherer: Gatherer, indices: list[int]) -> tuple[float, float, bool]:
    """Return the constant level of some frames (sample values), its fraction of their cutouts' light, and a flag.

    The flag is true if the level was measured outside the light of the point. A negative level has a negative fraction.
    The fraction is infinite, with the sign of the level, if the cutouts contain no light in total.

    On whole sensor frames, the level is measured outside the cutout, where the point sends no light. If frames are
    cutouts, there is no such area. The level is then that of the darkest block of their mean, which is too high if a
    pattern fills the cutout.
    """
    levels, cuts = [], []
    for index in indices:
        try:
            cut, around = gatherer.cut(index), _surroundings(gatherer, index)
        except FileFormatError:
            continue  # damaged: this is reported when its pattern is cut out
        cuts.append(cut.values.astype(np.float64))
        if around is not None:
            level, error = _level(around)
            # a level within the noise of a frame is not a pedestal
            levels.append(level if abs(level) > CERTAIN * error else 0.0)
    if not cuts:
        return 0.0, 0.0, False
    mean = np.mean(cuts, axis=0)
    level = float(np.median(levels)) if levels else _darkest_block(mean)
    total = float(mean.sum())
    if level == 0:
        return 0.0, 0.0, bool(levels)
    return level, level * mean.size / total if total > 0 else math.copysign(math.inf, level), bool(levels)


def _level(around: NDArray[np.float64]) -> tuple[float, float]:
    """Return the level of samples, few of which are lit, and its standard error.

    The level is the mean of the samples near the median, because the median of integers is a whole number.
    """
    middle = float(np.median(around))
    away = np.abs(around - middle)
    dark = around[away <= 3 * 1.4826 * float(np.median(away)) + 1]
    return float(dark.mean()), float(dark.std()) / math.sqrt(dark.size)


def _surroundings(gatherer: Gatherer, index: int) -> NDArray[np.float64] | None:
    """Return the samples of a frame beyond its cutout, or None if these are too few to determine a level."""
    _, region = gatherer.place(index)
    frame = gatherer.source.read(index).astype(np.float64)
    outside = np.ones(frame.shape, bool)
    outside[clipped(region, gatherer.source.shape)] = False
    return frame[outside] if np.count_nonzero(outside) >= frame.size / 4 else None


def _darkest_block(mean: NDArray[np.float64]) -> float:
    """Return the level of the darkest block; 0 if it is within the noise of a block."""
    rows, columns = (np.array_split(np.arange(n), min(BLOCKS, n)) for n in mean.shape)
    darkest = min((mean[np.ix_(r, c)] for r in rows for c in columns), key=lambda block: float(block.mean()))
    level, error = float(darkest.mean()), float(darkest.std()) / math.sqrt(darkest.size)
    return level if abs(level) > CERTAIN_OF_BLOCKS * error else 0.0


def check_pedestal(gatherer: Gatherer, planes: int, limit: float = LIMIT, *, subtracted: bool = False) -> None:
    """Raise `InputError` if a constant level exceeds the fraction ``limit`` of a plane's light.

    The level is negative if too much was subtracted. If a level was already ``subtracted``, a positive one is an error
    only if it was measured outside the light of the point.
    """
    by_plane: list[list[int]] = [[] for _ in range(planes)]
    for index, info in enumerate(gatherer.infos):
        if info.position.z < planes:
            by_plane[info.position.z].append(index)
    for z, indices in enumerate(by_plane):
        if not indices:
            continue
        level, share, seen = pedestal_share(gatherer, indices[:: max(1, len(indices) // SAMPLED)])
        # a pattern that fills its cutout has a bright darkest block even if the level was subtracted correctly
        if abs(share) <= limit or (subtracted and level > 0 and not seen):
            continue
        found = f"{100 * share:.3g} %" if math.isfinite(share) else "more than all their light"
        how = (
            "subtract dark frames, the black level or the background of the border; or keep the level (--keep-pedestal)"
        )
        if subtracted:
            found += " after subtracting the dark or black level"
            how = (
                "give dark frames or a black level recorded with the gain, exposure and bit depth (--shift) "
                "of these frames, or subtract the background of the border; or keep the level (--keep-pedestal)"
            )
        raise InputError.expected(
            f"plane {z}",
            f"frames without their black level (at most {100 * limit:g} % of the light of H)",
            f"a constant level of {level:.4g} ({found})",
            how,
        )
