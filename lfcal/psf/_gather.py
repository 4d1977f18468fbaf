"""From the frames of one position to its pattern: cut out, moved, repeats averaged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.frames import FrameInfo, FrameSource, Noise, Position, Region, Samples, clipped, moved, part_of, region_shape
from lfcal.psf.cutout import Cutout, Window

__all__ = ["Gatherer", "Pattern", "by_position"]

PROBE, WIDE_PROBE = (21, 21), (201, 201)
"""Pixels of a cutout on which the weights of an interpolation are found, moving and scaling."""


class Pattern(NamedTuple):
    """The pattern of one position; see `lfcal.psf.facts.Facts` for its facts."""

    values: NDArray[np.float32]
    valid: NDArray[np.bool_] | None
    noise: tuple[float, float]
    spread: float
    saturated: int


@dataclass(frozen=True, eq=False)
class Gatherer:
    """Everything the frames of a scan need to become patterns; shared by the threads.

    Attributes
    ----------
    source
        The frames.
    infos
        What is known of each of them.
    cutout
        The shifting cutout.
    drift
        ``(len(source), 2)`` how far each image is off its place (px), or None to ask the frames.
    noise
        Noise of samples of which the frames state none.
    """

    source: FrameSource
    infos: tuple[FrameInfo, ...]
    cutout: Cutout
    drift: NDArray[np.float64] | None = None
    noise: Noise | None = None

    def place(self, index: int) -> tuple[Window, Region]:
        """Return where the cutout of frame ``index`` lies on the sensor, and the region of the frame it looks at."""
        info = self.infos[index]
        shift = info.drift or (0.0, 0.0)
        if self.drift is not None:
            shift = (float(self.drift[index, 0]), float(self.drift[index, 1]))
        window = self.cutout.window(info.position, shift)
        return window, moved(self.cutout.region(window), (-info.origin[0], -info.origin[1]))

    def outside(self, index: int) -> bool:
        """Return whether the cutout of frame ``index`` leaves the frame."""
        info, (window, _) = self.infos[index], self.place(index)
        top, left = window.row - info.origin[0], window.column - info.origin[1]
        (nt, ns), (height, width) = self.cutout.reach, self.source.shape
        return top < 0 or left < 0 or top + nt > height or left + ns > width

    def where(self, index: int) -> str:
        """Return frame and position for messages."""
        info = self.infos[index]
        return f"{info.label}, (z, y, x) = {tuple(info.position)}"

    def cut(self, index: int) -> Samples:
        """Return the cutout of frame ``index``, ``(nt, ns)``; beyond the frame it is zero and not valid."""
        window, region = self.place(index)
        inside = clipped(region, self.source.shape)
        if min(region_shape(inside)) < 1:
            raise InputError.expected(self.where(index), "a cutout on the sensor", "one beside it", "check the anchor")
        found = self.source.samples(index, inside)
        if found.values.shape != region_shape(inside):
            raise InputError.expected(
                self.where(index), f"{region_shape(inside)} pixels", found.values.shape, "take the frame again"
            )
        if found.values.dtype.kind == "f" and not np.isfinite(found.values).all():
            raise InputError.expected(
                self.where(index), "finite values", "NaN or infinity", "take the frame again or leave it out"
            )
        if found.valid is not None and not found.valid.any():
            raise InputError.expected(
                self.where(index), "a point on a dark ground", "every pixel saturated", "expose shorter"
            )
        values, valid = _padded(found, region, inside)
        noise = self.noise if found.noise is None else found.noise
        return found._replace(
            values=self.cutout.resample(values, window),
            valid=None if valid is None else self._moved(valid, window),
            noise=None if noise is None else self._blended(noise.typical(found.values), window),
        )

    def _blended(self, noise: Noise, window: Window) -> Noise:
        """Return the noise of samples that interpolation blends: with weights w, sum w^2 of the variance is left."""
        if self.cutout.resamples:
            # the grids pass through all phases within a cutout, wherever it lies
            weight, square = _weights_of_phases(replace(self.cutout, shape=WIDE_PROBE))
        else:
            moved_by = window.row_residual, window.column_residual
            weight, square = _weights_of(replace(self.cutout, shape=PROBE), *moved_by)
        return Noise(noise.constant * square, noise.slope * square / weight)

    def _moved(self, valid: NDArray[np.bool_], window: Window) -> NDArray[np.bool_]:
        """Return the mask as the values are moved: a sample is valid where no invalid one enters it."""
        entered = self.cutout.resample((~valid).astype(np.float32), window)
        clean: NDArray[np.bool_] = np.abs(entered) < 0.05
        return clean

    def pattern(self, indices: NDArray[np.int64]) -> Pattern:
        """Return the pattern of one position from its frames: their weighted mean, with what their spread tells."""
        if len(indices) == 1:
            one = self.cut(int(indices[0]))
            known = (np.nan, np.nan) if one.noise is None else (float(one.noise.constant), float(one.noise.slope))
            return Pattern(one.values, one.valid, known, np.nan, -1 if one.saturated is None else one.saturated)
        return _mean([self.cut(int(k)) for k in indices])


@lru_cache(maxsize=512)
def _weights_of(cutout: Cutout, row: float, column: float) -> tuple[float, float]:
    """Return sum and sum of squares of the weights with which a small ``cutout`` blends a sample, moved by so much."""
    window = Window(0, 0, row, column)
    rows, columns = cutout.region(window)
    point = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.float32)
    point[point.shape[0] // 2, point.shape[1] // 2] = 1
    spread = cutout.resample(point, window).astype(np.float64)
    return float(spread.sum()), float((spread**2).sum())


@lru_cache(maxsize=8)
def _weights_of_phases(cutout: Cutout) -> tuple[float, float]:
    """Return the same for a ``cutout`` that scales, as the mean over all places of a sample between its pixels."""
    rows, columns = cutout.region(Window(0, 0, 0.0, 0.0))
    shape = (rows.stop - rows.start, columns.stop - columns.start)
    level = cutout.resample(np.ones(shape, np.float32), Window(0, 0, 0.0, 0.0))
    # white noise of variance 1, the same every time: what is left of its variance is the mean of sum w^2
    noise = np.random.default_rng(0).standard_normal(shape, np.float32)
    left = cutout.resample(noise, Window(0, 0, 0.0, 0.0)).astype(np.float64)
    return float(level.mean()), float(np.mean(left**2))


def _padded(found: Samples, region: Region, inside: Region) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """Return values and mask of ``region``, which may reach beyond the part ``inside`` that was read."""
    if inside == region:
        return found.values, found.valid
    values = np.zeros(region_shape(region), np.float32)
    valid = np.zeros(values.shape, np.bool_)
    there = part_of(inside, region)
    values[there] = found.values
    valid[there] = True if found.valid is None else found.valid
    return values, valid


def _mean(cuts: list[Samples]) -> Pattern:
    """Return the mean of repeated cutouts, each weighted by the inverse of its variance where that is known.

    With weights w_i the variance of the mean is sum w_i^2 var_i / (sum w_i)^2. Where the noise is not stated it is
    estimated from the repeats, alike for all samples of the pattern.
    """
    values = np.stack([cut.values for cut in cuts]).astype(np.float64)
    masks = np.stack(
        [np.ones(v.shape, bool) if c.valid is None else c.valid for c, v in zip(cuts, values, strict=True)]
    )
    weights = _weights(cuts)
    share = weights[:, None, None] * masks
    total = share.sum(axis=0)
    valid = total > 0
    # where no repeat is valid the plain mean stands, marked as not valid
    share[:, ~valid] = weights[:, None]
    total = np.where(valid, total, weights.sum())
    mean = (share * values).sum(axis=0) / total
    scatter = (share * (values - mean) ** 2).sum(axis=0) / total * (len(cuts) / (len(cuts) - 1))
    scale = float(np.sqrt(np.mean(mean**2)))
    spread = float(np.sqrt(scatter[valid].mean())) / scale if valid.any() and scale > 0 else np.nan
    counts = [cut.saturated for cut in cuts if cut.saturated is not None]
    return Pattern(
        mean.astype(np.float32),
        None if valid.all() else valid,
        _noise_of_mean([cut.noise for cut in cuts], weights, scatter[valid]),
        spread,
        max(counts) if counts else -1,
    )


def _weights(cuts: list[Samples]) -> NDArray[np.float64]:
    """Return the inverse variance of a typical sample of each cutout, or 1 for all where it is not known of all."""
    variances = []
    for cut in cuts:
        if cut.noise is None:
            return np.ones(len(cuts))
        variances.append(float(cut.noise.constant) + float(cut.noise.slope) * max(float(cut.values.mean()), 0.0))
    inverse: NDArray[np.float64] = 1 / np.maximum(np.array(variances), 1e-300)
    inverse /= inverse.max()
    return inverse


def _noise_of_mean(
    known: list[Noise | None], weights: NDArray[np.float64], scatter: NDArray[np.float64]
) -> tuple[float, float]:
    stated = [noise for noise in known if noise is not None]
    if len(stated) == len(known):
        share = (weights / weights.sum()) ** 2
        constant, slope = share @ np.array([[float(noise.constant), float(noise.slope)] for noise in stated])
        return float(constant), float(slope)
    return (float(scatter.mean()) / len(known) if scatter.size else np.nan), 0.0


def by_position(
    infos: tuple[FrameInfo, ...], shape: tuple[int, int, int]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return frame numbers sorted by position, and where each position's begin: ``(n,)`` and ``(positions + 1,)``.

    Raises
    ------
    InputError
        If a frame lies outside the plan.
    """
    flat = np.empty(len(infos), np.int64)
    for index, info in enumerate(infos):
        position = Position(*info.position)
        if not all(0 <= p < n for p, n in zip(position, shape, strict=True)):
            where = f"{info.label} at (z, y, x) = {tuple(position)}"
            raise InputError.expected(where, f"a position inside {shape}", "one outside", "check manifest and plan")
        flat[index] = np.ravel_multi_index(position, shape)
    order = np.argsort(flat, kind="stable")
    starts = np.searchsorted(flat[order], np.arange(int(np.prod(shape)) + 1))
    return order.astype(np.int64), starts.astype(np.int64)
