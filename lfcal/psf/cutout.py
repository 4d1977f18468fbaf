"""The cutout that moves with the image of the point (Eberhart, section 2.1, figure 4).

`Cutout` defines the pixels. `Gatherer` reads them from the frames of a position, shifts them, and averages repeated
frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    InputError,
    Region,
    any_of,
    centre,
    check_cutout,
    clipped,
    format_pixels,
    moved,
    part_of,
    region_shape,
)
from lfcal.camera import ScanPlan
from lfcal.frames import FrameInfo, FrameSource, Noise, Position, Samples

__all__ = ["INTERPOLATIONS", "Cutout", "Gatherer", "Pattern", "Window", "by_position", "find_cutout"]

INTERPOLATIONS = ("nearest", "linear", "cubic", "fourier")
"""Interpolation of a window between pixels; ``nearest`` moves no light and reports the remaining shift."""

_MARGIN = {"nearest": 0, "linear": 1, "cubic": 12, "fourier": 0}
"""Number of pixels around the window that an interpolation uses; a cubic spline's influence is 1e-6 after 11."""

PROBE, WIDE_PROBE = (21, 21), (201, 201)
"""Shapes of the cutouts on which the weights of an interpolation are computed, for moving and scaling (pixels)."""


class Window(NamedTuple):
    """Position of a cutout on the sensor: its first row and column, and the residuals of its position.

    The residuals are the offset of the image from the middle pixel of the cutout, in (-0.5, 0.5] px.
    """

    row: int
    column: int
    row_residual: float
    column_residual: float


@dataclass(frozen=True, slots=True)
class Cutout:
    """Window of pixels around the paraxial image of the source, which moves with the source.

    Attributes
    ----------
    shape
        Number of rows and columns ``(nt, ns)`` of the cutout (px), both odd.
    anchor
        Sensor position (row, column) of the image of the source position y = x = 0 (px; whole numbers are pixel
        centres). The image of the position (y, x) is at ``anchor + (y, x) / scale``.
    interpolation
        Interpolation at fractional pixel positions: one of `INTERPOLATIONS`, such as ``"nearest"``, ``"linear"`` or
        ``"cubic"``.
    outside
        Treatment of cutouts that extend beyond the sensor: ``"error"`` raises an error, ``"zero"`` pads them with
        zeros.
    scale
        Cutout pixels per sensor pixel (rows, columns). It differs from 1 if frames are resampled such that the period
        of the lenslet array is a whole number of pixels. Successive positions are then one cutout pixel apart.
        ``"nearest"`` cannot resample.

    Examples
    --------
    >>> from lfcal.frames import Position
    >>> from lfcal.psf import Cutout
    >>> cutout = Cutout((63, 63), anchor=(100.0, 120.25))
    >>> cutout.window(Position(0, 3, 4))  # about (103, 124.25): 31 pixels on either side
    Window(row=72, column=93, row_residual=0.0, column_residual=0.25)
    """

    shape: tuple[int, int]
    anchor: tuple[float, float] = (0.0, 0.0)
    interpolation: str = "nearest"
    outside: str = "error"
    scale: tuple[float, float] = (1.0, 1.0)

    def __post_init__(self) -> None:
        """Check every value."""
        object.__setattr__(self, "shape", tuple(int(n) for n in self.shape))
        object.__setattr__(self, "anchor", tuple(float(v) for v in self.anchor))
        check_cutout(*self.shape)
        if not all(math.isfinite(v) for v in self.anchor):
            raise InputError.expected(
                "anchor", "finite numbers (row, column)", self.anchor, "give a row and a column in pixels"
            )
        for what, value, choices in (
            ("interpolation", self.interpolation, INTERPOLATIONS),
            ("outside", self.outside, ("error", "zero")),
        ):
            if value not in choices:
                raise InputError.expected(what, any_of(choices), repr(value), "choose one of these")
        object.__setattr__(self, "scale", tuple(float(v) for v in self.scale))
        # a factor far from 1 means a wrong period, not one that is rounded to whole pixels
        if not all(0.5 <= v <= 2 for v in self.scale):
            raise InputError.expected(
                "resampling factor", "a factor from 0.5 to 2", self.scale, "check the period of the scan"
            )
        if self.resamples and self.interpolation not in ("linear", "cubic"):
            raise InputError.expected(
                "interpolation of resampled frames", "linear or cubic", self.interpolation, "choose one of these"
            )

    @classmethod
    def for_plan(cls, plan: ScanPlan, *, interpolation: str = "", outside: str = "error") -> Cutout:
        """Return the cutout of a plan; ``interpolation`` defaults to cubic if the plan resamples, else to nearest."""
        default = "cubic" if plan.resample else "nearest"
        return cls(plan.cutout, plan.anchor, interpolation or default, outside, plan.resample_factors)

    @property
    def resamples(self) -> bool:
        """Whether frames are resampled to another pixel pitch, and not only shifted."""
        return self.scale != (1.0, 1.0)

    def window(self, position: Position, drift: tuple[float, float] = (0.0, 0.0)) -> Window:
        """Return the sensor window for ``position``, whose image is displaced by ``drift`` (rows, columns; px)."""
        row = self.anchor[0] + position.y / self.scale[0] + drift[0]
        column = self.anchor[1] + position.x / self.scale[1] + drift[1]
        # ceil(v - 0.5) rounds halves down, so that the residual lies in (-0.5, 0.5]; round() would round halves to
        # even numbers and alternate between neighbours
        whole_row, whole_column = math.ceil(row - 0.5), math.ceil(column - 0.5)
        nt, ns = self.reach
        return Window(whole_row - centre(nt), whole_column - centre(ns), row - whole_row, column - whole_column)

    @property
    def reach(self) -> tuple[int, int]:
        """Number of sensor rows and columns that the cutout covers, both odd."""
        if not self.resamples:
            return self.shape
        # the cutout's edge may lie between sensor pixels, so the reach is rounded up
        rows, columns = (2 * math.ceil(centre(n) / f) + 1 for n, f in zip(self.shape, self.scale, strict=True))
        return rows, columns

    def region(self, window: Window) -> tuple[slice, slice]:
        """Return slices of the sensor rows and columns to read for ``window``, including a margin for interpolation."""
        # a window on whole pixels is copied unchanged: no interpolation affects its noise
        still = window.row_residual == window.column_residual == 0 and not self.resamples
        margin = 0 if still else _MARGIN[self.interpolation]
        nt, ns = self.reach
        return (
            slice(window.row - margin, window.row + nt + margin),
            slice(window.column - margin, window.column + ns + margin),
        )

    def resample(self, values: NDArray[Any], window: Window) -> NDArray[np.float32]:
        """Return the cutout ``(nt, ns)`` at ``window``, interpolated from ``values``, the pixels in `region`."""
        shift = (window.row_residual, window.column_residual)
        data = np.asarray(values, np.float32)
        if self.resamples:
            return self._scaled(data, shift)
        if self.interpolation == "nearest" or shift == (0.0, 0.0):
            return data
        if self.interpolation == "fourier":
            return _fourier_shift(data, shift)
        from scipy import ndimage

        # scipy shifts towards larger indices, the window moves in the opposite direction
        moved: NDArray[np.float32] = ndimage.shift(data, (-shift[0], -shift[1]), order=self._order, mode="nearest")
        margin = _MARGIN[self.interpolation]
        return moved[margin : margin + self.shape[0], margin : margin + self.shape[1]]

    @property
    def _order(self) -> Literal[1, 3]:
        return 1 if self.interpolation == "linear" else 3

    def _scaled(self, data: NDArray[np.float32], shift: tuple[float, float]) -> NDArray[np.float32]:
        """Return the cutout sampled every 1/scale sensor pixels about the point; energy is preserved."""
        from scipy import ndimage

        rows, columns = (
            centre(n) + residual + (np.arange(m) - centre(m)) / f
            for n, residual, m, f in zip(data.shape, shift, self.shape, self.scale, strict=True)
        )
        at = np.meshgrid(rows, columns, indexing="ij")
        values = ndimage.map_coordinates(data, at, order=self._order, mode="nearest")
        # a resampled pixel covers 1/(fy fx) of a sensor pixel, and contains that fraction of its light
        scaled: NDArray[np.float32] = (values / (self.scale[0] * self.scale[1])).astype(np.float32)
        return scaled


def _fourier_shift(data: NDArray[np.float32], shift: tuple[float, float]) -> NDArray[np.float32]:
    """Return ``data`` moved by ``-shift`` pixels as a band-limited, periodic image (odd sizes: exact)."""
    # an odd size has no Nyquist term, whose phase would be ambiguous
    rows, columns = np.fft.fftfreq(data.shape[0]), np.fft.rfftfreq(data.shape[1])
    phase = np.exp(2j * np.pi * (shift[0] * rows[:, None] + shift[1] * columns))
    moved = np.fft.irfft2(np.fft.rfft2(data.astype(np.float64)) * phase, s=data.shape)
    return moved.astype(np.float32)


def find_cutout(
    images: Iterable[NDArray[Any]],
    centres: Iterable[tuple[float, float]],
    *,
    lost: float = 0.005,
    background: float | None = None,
) -> tuple[int, int]:
    """Return the smallest odd cutout ``(nt, ns)`` that excludes at most the fraction ``lost`` of each image's energy.

    Parameters
    ----------
    images
        Corrected frames ``(rows, columns)`` of single source positions, or depth-plane sums.
    centres
        Position (row, column) of the point's paraxial image in each of ``images`` (px).
    lost
        Largest fraction of the energy that may be outside the cutout, between 0 and 1; half of it is allowed along each
        axis. Pixels below three standard deviations of the noise at the border do not count.
    background
        Background that is first subtracted from every pixel, in the unit of the image. None: the median of the border
        of each image. The energy is a sum over many pixels and is therefore sensitive to this value.

    Raises
    ------
    InputError
        If an image contains no light, or ``lost`` is not between 0 and 1.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import find_cutout
    >>> frame = np.zeros((41, 41))
    >>> frame[18:23, 13:28] = 100  # 5 x 15 pixels about (20, 20)
    >>> find_cutout([frame], [(20, 20)], lost=0.005)
    (5, 15)
    """
    if not 0 < lost < 1:
        raise InputError.expected(
            "energy that a cutout may lose", "a fraction above 0 and below 1", lost, "give a fraction, usually 0.005"
        )
    height = width = 0
    for image, (row, column) in zip(images, centres, strict=True):
        data = np.asarray(image, np.float64)
        level = _border_median(data) if background is None else background
        data = data - level
        # 1.4826 times the median absolute deviation is the standard deviation of Gaussian noise
        noise = 1.4826 * np.median(np.abs(_border(data)))
        data = np.where(data > 3 * noise, data, 0.0)  # otherwise noise far from the spots would count as energy
        if not data.sum() > 0:
            raise InputError.expected("frame", "light from the point", "none", "check the exposure and the position")
        height = max(height, _half_width(data.sum(axis=1), row, lost / 2))
        width = max(width, _half_width(data.sum(axis=0), column, lost / 2))
    return 2 * height + 1, 2 * width + 1


def _border(data: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate([data[0], data[-1], data[:, 0], data[:, -1]])


def _border_median(data: NDArray[np.float64]) -> float:
    return float(np.median(_border(data)))


def _half_width(profile: NDArray[np.float64], middle: float, lost: float) -> int:
    """Return the smallest half width about ``middle`` that leaves at most ``lost`` of the profile outside."""
    distance = np.abs(np.arange(profile.size) - round(middle)).astype(int)
    # energy is counted from the middle outwards, so the first width that reaches the share is the smallest
    inside = np.cumsum(np.bincount(distance, weights=profile))
    return int(np.argmax(inside >= (1 - lost) * inside[-1]))


# -- frames to patterns ------------------------------------------------------------------------------------------------
class Pattern(NamedTuple):
    """The pattern of one position, with facts as in `lfcal.psf.facts.Facts`; the mask ``valid`` is not packed."""

    values: NDArray[np.float32]
    valid: NDArray[np.bool_] | None
    noise: tuple[float, float]
    spread: float
    saturated: int


@dataclass(frozen=True, eq=False)
class Gatherer:
    """Converter of frames of a scan to patterns; all threads may use the same object.

    Attributes
    ----------
    source
        The frames.
    infos
        Metadata of each frame.
    cutout
        The cutout, which moves with the source.
    drift
        ``(len(source), 2)`` displacement of each image from its planned position (rows, columns; px). None: the drift
        stated by the frames.
    noise
        Noise of samples, if the frames do not state it. None: unknown.
    """

    source: FrameSource
    infos: tuple[FrameInfo, ...]
    cutout: Cutout
    drift: NDArray[np.float64] | None = None
    noise: Noise | None = None

    def place(self, index: int) -> tuple[Window, Region]:
        """Return the window of the cutout of frame ``index`` on the sensor, and the region to read from the frame.

        The region includes the margin for interpolation and may extend beyond the frame.
        """
        info = self.infos[index]
        shift = info.drift or (0.0, 0.0)
        if self.drift is not None:
            shift = (float(self.drift[index, 0]), float(self.drift[index, 1]))
        window = self.cutout.window(info.position, shift)
        return window, moved(self.cutout.region(window), (-info.origin[0], -info.origin[1]))

    def outside(self, index: int) -> bool:
        """Return whether the cutout of frame ``index`` extends beyond the frame."""
        info, (window, _) = self.infos[index], self.place(index)
        top, left = window.row - info.origin[0], window.column - info.origin[1]
        (nt, ns), (height, width) = self.cutout.reach, self.source.shape
        return top < 0 or left < 0 or top + nt > height or left + ns > width

    def where(self, index: int) -> str:
        """Return the name and position of frame ``index`` for messages."""
        info = self.infos[index]
        return f"{info.label}, (z, y, x) = {tuple(info.position)}"

    def cut(self, index: int) -> Samples:
        """Return the cutout ``(nt, ns)`` of frame ``index``; pixels beyond the frame are zero and marked as invalid.

        Raises
        ------
        InputError
            If the cutout is completely outside the frame or all its pixels are invalid, or a value is not finite.
        """
        window, region = self.place(index)
        inside = clipped(region, self.source.shape)
        if min(region_shape(inside)) < 1:
            raise InputError.expected(
                self.where(index), "a cutout inside the sensor", "one that reaches beyond it", "check the anchor"
            )
        found = self.source.samples(index, inside)
        if found.values.shape != region_shape(inside):
            raise InputError.expected(
                self.where(index),
                format_pixels(region_shape(inside)),
                format_pixels(found.values.shape),
                "record the frame again",
            )
        if found.values.dtype.kind == "f" and not np.isfinite(found.values).all():
            raise InputError.expected(
                self.where(index), "finite values", "NaN or infinity", "record the frame again, or leave it out"
            )
        if found.valid is not None and not found.valid.any():
            raise InputError.expected(
                self.where(index), "a point on a dark background", "every pixel saturated", "reduce the exposure"
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
            # the grids pass through all phases within a cutout, wherever it is
            weight, square = _weights_of_phases(replace(self.cutout, shape=WIDE_PROBE))
        else:
            moved_by = window.row_residual, window.column_residual
            weight, square = _weights_of(replace(self.cutout, shape=PROBE), *moved_by)
        return Noise(noise.constant * square, noise.slope * square / weight)

    def _moved(self, valid: NDArray[np.bool_], window: Window) -> NDArray[np.bool_]:
        """Return the mask moved like the values: a sample is valid if invalid ones contribute less than 5 % to it."""
        entered = self.cutout.resample((~valid).astype(np.float32), window)
        clean: NDArray[np.bool_] = np.abs(entered) < 0.05
        return clean

    def pattern(self, indices: NDArray[np.int64]) -> Pattern:
        """Return the pattern of one position from the frames ``indices``: their weighted mean, and facts about them."""
        if len(indices) == 1:
            one = self.cut(int(indices[0]))
            known = (np.nan, np.nan) if one.noise is None else (float(one.noise.constant), float(one.noise.slope))
            return Pattern(one.values, one.valid, known, np.nan, -1 if one.saturated is None else one.saturated)
        return _mean([self.cut(int(k)) for k in indices])


@lru_cache(maxsize=512)
def _weights_of(cutout: Cutout, row: float, column: float) -> tuple[float, float]:
    """Return the sums of weights and of squared weights of a small ``cutout`` moved by ``row``, ``column`` (px)."""
    window = Window(0, 0, row, column)
    rows, columns = cutout.region(window)
    point = np.zeros((rows.stop - rows.start, columns.stop - columns.start), np.float32)
    point[point.shape[0] // 2, point.shape[1] // 2] = 1
    spread = cutout.resample(point, window).astype(np.float64)
    return float(spread.sum()), float((spread**2).sum())


@lru_cache(maxsize=8)
def _weights_of_phases(cutout: Cutout) -> tuple[float, float]:
    """Return the sums of weights and of squared weights of a ``cutout`` that scales, averaged over subpixel shifts."""
    rows, columns = cutout.region(Window(0, 0, 0.0, 0.0))
    shape = (rows.stop - rows.start, columns.stop - columns.start)
    level = cutout.resample(np.ones(shape, np.float32), Window(0, 0, 0.0, 0.0))
    # white noise of variance 1, always the same: the variance that remains is the mean of sum w^2
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
    """Return the mean of repeated cutouts, each weighted by the inverse of its variance if that is known.

    With weights w_i the variance of the mean is sum w_i^2 var_i / (sum w_i)^2. If the noise is not stated, one
    variance for all samples of the pattern is estimated from the repeats.
    """
    values = np.stack([cut.values for cut in cuts]).astype(np.float64)
    masks = np.stack(
        [np.ones(v.shape, bool) if c.valid is None else c.valid for c, v in zip(cuts, values, strict=True)]
    )
    weights = _weights(cuts)
    share = weights[:, None, None] * masks
    total = share.sum(axis=0)
    valid = total > 0
    # where no repeat is valid, the plain mean is used and marked as not valid
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
    """Return the inverse variance of a typical sample of each cutout, relative to the largest; 1 if any is unknown."""
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
    """Return frame indices ``(n,)`` sorted by position, and where each position starts in them, ``(positions + 1,)``.

    Positions are in row-major order for ``shape`` ``(nz, ny, nx)``; the last entry of the second array is n.

    Raises
    ------
    InputError
        If a frame is outside the plan.
    """
    flat = np.empty(len(infos), np.int64)
    for index, info in enumerate(infos):
        position = Position(*info.position)
        if not all(0 <= p < n for p, n in zip(position, shape, strict=True)):
            where = f"{info.label} at (z, y, x) = {tuple(position)}"
            raise InputError.expected(
                where,
                f"a position inside the scan of {shape}",
                "one outside it",
                "check the manifest and the scan plan",
            )
        flat[index] = np.ravel_multi_index(position, shape)
    order = np.argsort(flat, kind="stable")
    starts = np.searchsorted(flat[order], np.arange(int(np.prod(shape)) + 1))
    return order.astype(np.int64), starts.astype(np.int64)
