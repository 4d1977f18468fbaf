"""The cutout that shifts along with the point (Eberhart, section 2.1, figure 4)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, centre, check_cutout
from lfcal.camera import ScanPlan
from lfcal.frames import Position

__all__ = ["INTERPOLATIONS", "Cutout", "Window", "find_cutout"]

INTERPOLATIONS = ("nearest", "linear", "cubic", "fourier")
"""How a window that lies between pixels is taken; ``nearest`` moves no light and reports what is left."""

_MARGIN = {"nearest": 0, "linear": 1, "cubic": 12, "fourier": 0}
"""Pixels around the window that an interpolation looks at; a cubic spline's memory is 1e-6 after 11."""


class Window(NamedTuple):
    """Where a cutout lies on the sensor: first row and column, and the sub-pixel residual in (-0.5, 0.5]."""

    row: int
    column: int
    row_residual: float
    column_residual: float


@dataclass(frozen=True, slots=True)
class Cutout:
    """A window of odd x odd pixels around the paraxial image of the source.

    Attributes
    ----------
    shape
        ``(nt, ns)`` pixels, both odd.
    anchor
        Sensor position (row, column) of the image of source position y = x = 0 (pixels, pixel centres
        at whole numbers); position (y, x) lies at ``anchor + (y, x)``.
    interpolation
        One of `INTERPOLATIONS`.
    outside
        ``"error"``: a cutout that leaves the sensor is an error; ``"zero"``: it is padded with zeros.
    scale
        Cutout pixels per sensor pixel (rows, columns): not 1 where the frames are resampled to make the
        period of the array whole. Positions then step by cutout pixels; ``nearest`` cannot resample.

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
            raise InputError.expected("anchor", "finite numbers (row, column)", self.anchor, "correct it")
        for what, value, choices in (
            ("interpolation", self.interpolation, INTERPOLATIONS),
            ("outside", self.outside, ("error", "zero")),
        ):
            if value not in choices:
                raise InputError.expected(what, " or ".join(choices), repr(value), "choose one of these")
        object.__setattr__(self, "scale", tuple(float(v) for v in self.scale))
        # a smaller or larger factor means a wrong period, not a rounding of it to whole pixels
        if not all(0.5 <= v <= 2 for v in self.scale):
            raise InputError.expected("resampling factor", "between 0.5 and 2", self.scale, "check the period")
        if self.resamples and self.interpolation not in ("linear", "cubic"):
            raise InputError.expected(
                "interpolation of resampled frames", "linear or cubic", self.interpolation, "choose cubic"
            )

    @classmethod
    def for_plan(cls, plan: ScanPlan, *, interpolation: str = "", outside: str = "error") -> Cutout:
        """Return the cutout of a scan plan; resampled frames are interpolated cubically by default."""
        default = "cubic" if plan.resample else "nearest"
        return cls(plan.cutout, plan.anchor, interpolation or default, outside, plan.resample_factors)

    @property
    def resamples(self) -> bool:
        """Whether frames are scaled, not only moved."""
        return self.scale != (1.0, 1.0)

    def window(self, position: Position, drift: tuple[float, float] = (0.0, 0.0)) -> Window:
        """Return the window of ``position``; ``drift`` (rows, columns) is how far the image is off (px)."""
        row = self.anchor[0] + position.y / self.scale[0] + drift[0]
        column = self.anchor[1] + position.x / self.scale[1] + drift[1]
        # ceil(v - 0.5) rounds halves down, so that the residual lies in (-0.5, 0.5]; round() would take halves to
        # even numbers and alternate between neighbours
        whole_row, whole_column = math.ceil(row - 0.5), math.ceil(column - 0.5)
        nt, ns = self.reach
        return Window(whole_row - centre(nt), whole_column - centre(ns), row - whole_row, column - whole_column)

    @property
    def reach(self) -> tuple[int, int]:
        """Sensor pixels ``(rows, columns)``, both odd, that the cutout covers."""
        if not self.resamples:
            return self.shape
        # the cutout's own edge may lie between pixels of the sensor, so the reach is rounded up
        rows, columns = (2 * math.ceil(centre(n) / f) + 1 for n, f in zip(self.shape, self.scale, strict=True))
        return rows, columns

    def region(self, window: Window) -> tuple[slice, slice]:
        """Return the rows and columns of the sensor that ``window`` and its interpolation look at."""
        # a window on whole pixels is copied as it is: no interpolation touches its noise
        still = window.row_residual == window.column_residual == 0 and not self.resamples
        margin = 0 if still else _MARGIN[self.interpolation]
        nt, ns = self.reach
        return (
            slice(window.row - margin, window.row + nt + margin),
            slice(window.column - margin, window.column + ns + margin),
        )

    def resample(self, values: NDArray[Any], window: Window) -> NDArray[np.float32]:
        """Return the cutout from ``values`` of `region`, moved by the window's sub-pixel residual."""
        shift = (window.row_residual, window.column_residual)
        data = np.asarray(values, np.float32)
        if self.resamples:
            return self._scaled(data, shift)
        if self.interpolation == "nearest" or shift == (0.0, 0.0):
            return data
        if self.interpolation == "fourier":
            return _fourier_shift(data, shift)
        from scipy import ndimage

        # scipy shifts towards larger indices, the window moves the other way
        moved: NDArray[np.float32] = ndimage.shift(data, (-shift[0], -shift[1]), order=self._order, mode="nearest")
        margin = _MARGIN[self.interpolation]
        return moved[margin : margin + self.shape[0], margin : margin + self.shape[1]]

    @property
    def _order(self) -> Literal[1, 3]:
        return 1 if self.interpolation == "linear" else 3

    def _scaled(self, data: NDArray[np.float32], shift: tuple[float, float]) -> NDArray[np.float32]:
        """Return the cutout sampled every 1/scale sensor pixels about the point; energy is kept."""
        from scipy import ndimage

        rows, columns = (
            centre(n) + residual + (np.arange(m) - centre(m)) / f
            for n, residual, m, f in zip(data.shape, shift, self.shape, self.scale, strict=True)
        )
        at = np.meshgrid(rows, columns, indexing="ij")
        values = ndimage.map_coordinates(data, at, order=self._order, mode="nearest")
        # a resampled pixel covers 1/(fy fx) of a sensor pixel, and holds that share of its light
        scaled: NDArray[np.float32] = (values / (self.scale[0] * self.scale[1])).astype(np.float32)
        return scaled


def _fourier_shift(data: NDArray[np.float32], shift: tuple[float, float]) -> NDArray[np.float32]:
    """Return ``data`` moved by ``-shift`` pixels as a band-limited, periodic image (odd sizes: exact)."""
    # at an odd size there is no Nyquist term, whose phase would be ambiguous
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
    """Return the smallest odd ``(nt, ns)`` that loses at most the share ``lost`` of every image's energy.

    Parameters
    ----------
    images
        Frames ``(rows, columns)`` of single positions, or depth-plane sums; corrected.
    centres
        The paraxial image of the point in each of them, (row, column) in pixels.
    lost
        Largest share of the energy outside the cutout; half of it is spent in each direction.
    background
        What is subtracted from every pixel first; None: the median of each image's border, which a
        sum over many pixels is sensitive to.

    Raises
    ------
    InputError
        If an image holds no light, or ``lost`` is not in (0, 1).

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
        raise InputError.expected("energy lost", "a share between 0 and 1", lost, "0.005 is usual")
    height = width = 0
    for image, (row, column) in zip(images, centres, strict=True):
        data = np.asarray(image, np.float64)
        level = _border_median(data) if background is None else background
        data = data - level
        # 1.4826 times the median absolute deviation is the standard deviation of Gaussian noise
        noise = 1.4826 * np.median(np.abs(_border(data)))
        data = np.where(data > 3 * noise, data, 0.0)  # noise far from the spots would count as energy
        if not data.sum() > 0:
            raise InputError.expected("frame", "light from the point", "none", "check exposure and position")
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
