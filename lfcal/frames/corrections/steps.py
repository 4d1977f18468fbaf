"""Single corrections of a frame: mask, dark, white (vignetting), exposure and background."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import InitVar, dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    InputError,
    Region,
    as_sensor_frame,
    check_choice,
    check_exposure,
    check_number,
    clipped,
    format_pixels,
    moved,
)
from lfcal.frames.cfa import phases

__all__ = [
    "Background",
    "Dark",
    "DarkSet",
    "Exposure",
    "PixelMask",
    "White",
    "average_frames",
    "border_strips",
    "difference_variance",
    "white_gain",
]

DIFFERENCED = 1 << 20
"""Approximate number of pixels compared in a pair of frames."""


def average_frames(frames: Iterable[NDArray[Any]]) -> NDArray[np.float32]:
    """Return the mean of frames of equal shape ``(rows, columns)`` as float32; the sum is computed in float64.

    Use it for series of dark or white images, and for repeated frames of one position.

    Raises
    ------
    InputError
        If there is no frame, or frames differ in shape.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import average_frames
    >>> average_frames([np.array([[1, 2]]), np.array([[3, 6]])]).tolist()
    [[2.0, 4.0]]
    """
    total: NDArray[np.float64] | None = None
    count = 0
    for frame in frames:
        if total is None:
            # float32 is exact only up to 2^24, which 256 bright 16-bit frames reach
            total = np.zeros(frame.shape, np.float64)
        if frame.shape != total.shape:
            raise InputError.expected(
                f"frame {count} of the average",
                format_pixels(total.shape),
                format_pixels(frame.shape),
                "leave this frame out",
            )
        with np.errstate(invalid="ignore"):  # converting some kinds of NaN warns; the caller that averages checks them
            total += frame
        count += 1
    if total is None:
        raise InputError.expected(
            "frames to average", "at least one", "none", "give a file or folder that contains frames"
        )
    return (total / count).astype(np.float32)


def difference_variance(first: NDArray[Any], second: NDArray[Any]) -> float:
    """Return the temporal variance of a sample, in squared sample values, from two frames with the same illumination.

    The variance is half the mean square of the difference, in which static content such as hot pixels cancels.
    Differences beyond 6 times their rms are ignored. Large frames are subsampled.
    """
    step = max(1, int(np.sqrt(first.size / DIFFERENCED)))
    square = np.subtract(first[::step, ::step], second[::step, ::step], dtype=np.float64).ravel() ** 2
    square = square[np.isfinite(square)]
    for _ in range(3):
        limit = 36 * float(square.mean()) if square.size else 0.0
        square = square[square <= limit]
    return float(square.mean()) / 2 if square.size else 0.0


def fingerprint(array: NDArray[Any]) -> str:
    """Return the CRC-32 of an array's bytes as eight hexadecimal digits, for provenance."""
    return f"{zlib.crc32(np.ascontiguousarray(array).data):08x}"


@dataclass(frozen=True, eq=False)
class PixelMask:
    """Correction that masks pixels without information: they are invalid, and no other pixel is computed from them.

    Attributes
    ----------
    lost
        Mask ``(rows, columns)`` of the sensor, True at the pixels without information.

    Raises
    ------
    InputError
        If every pixel is masked.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, CorrectionChain, PixelMask, corrected
    >>> frame = np.array([[3, 4095, 5]], np.uint16)
    >>> chain = CorrectionChain((PixelMask(frame > 100),))
    >>> found = corrected(ArraySource(frame[None], [(0, 0, 0)]), chain).samples(0)
    >>> print(found.values.tolist(), found.valid.tolist())
    [[3.0, 4.0, 5.0]] [[True, False, True]]
    """

    lost: NDArray[np.bool_] = field(repr=False)

    def __post_init__(self) -> None:
        """Check and freeze the mask."""
        lost = np.array(self.lost, np.bool_)
        if lost.ndim != 2 or lost.all():
            raise InputError.expected("mask", "at least one usable pixel", "none", "mark usable pixels with 0")
        lost.flags.writeable = False
        object.__setattr__(self, "lost", lost)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the frames to which the step applies (px)."""
        return self.lost.shape[0], self.lost.shape[1]

    def describe(self) -> dict[str, Any]:
        """Return a JSON-compatible description of the step, for provenance."""
        return {"kind": "mask", "count": int(self.lost.sum()), "crc32": fingerprint(self.lost)}


@dataclass(frozen=True, eq=False)
class Dark:
    """Correction that subtracts the dark signal of the sensor; negative differences are kept.

    Attributes
    ----------
    frame
        Mean dark frame (counts), ``(rows, columns)``. None: only ``level`` is subtracted.
    level
        Constant level to subtract in addition to ``frame`` (counts), such as the black level of a camera RAW file.
    origin
        Position (row, column) on the sensor of the first pixel of ``frame`` (px). A dark frame of a part of the sensor
        can be subtracted only within that part.
    count
        Number of averaged frames, which determines the noise of ``frame``; 0: unknown.
    variance
        Temporal variance of a sample in a single dark frame (counts²). None: not measured.

    Raises
    ------
    InputError
        If the frame is not a finite 2-D array, or the level is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import CorrectionChain, Dark
    >>> dark = Dark(np.array([[60.0, 61.0]]), count=8)
    >>> CorrectionChain((dark,)).apply(np.array([[100, 50]], np.uint16)).tolist()
    [[40.0, -11.0]]
    """

    frame: NDArray[Any] | None = field(default=None, repr=False)
    level: float = 0.0
    origin: tuple[int, int] = (0, 0)
    count: int = 0
    variance: float | None = None

    def __post_init__(self) -> None:
        """Check and freeze the frame."""
        check_number("dark level", self.level)
        if self.frame is not None:
            object.__setattr__(self, "frame", as_sensor_frame("dark frame", self.frame))

    @property
    def shape(self) -> tuple[int, int] | None:
        """Shape ``(rows, columns)`` of the frames to which the step applies (px). None: any shape."""
        # a dark of a part of the sensor does not know the shape of whole frames
        if self.frame is None or self.origin != (0, 0):
            return None
        return self.frame.shape[0], self.frame.shape[1]

    def at(self, exposure_s: float | None) -> Dark:
        """Return the dark step for frames exposed for ``exposure_s`` (s): this object, for every exposure time."""
        return self

    def part(self, region: Region) -> NDArray[np.float32] | None:
        """Return the values of ``frame`` in a sensor region; None if ``frame`` is None.

        Raises
        ------
        InputError
            If ``frame`` does not cover the region.
        """
        if self.frame is None:
            return None
        inside = moved(region, (-self.origin[0], -self.origin[1]))
        if clipped(inside, (self.frame.shape[0], self.frame.shape[1])) != inside:
            raise InputError.expected(
                "dark frame",
                f"rows {region[0].start} … {region[0].stop - 1}, columns {region[1].start} … {region[1].stop - 1}",
                f"{format_pixels(self.frame.shape)} from row {self.origin[0]}, column {self.origin[1]}",
                "record dark frames of the same region",
            )
        return np.ascontiguousarray(self.frame[inside])

    def describe(self) -> dict[str, Any]:
        """Return a JSON-compatible description of the step, for provenance."""
        record: dict[str, Any] = {"kind": "dark", "level": float(self.level)}
        if self.frame is not None:
            record |= {"mean": float(self.frame.mean(dtype=np.float64)), "crc32": fingerprint(self.frame)}
        return record


@dataclass(frozen=True, eq=False)
class DarkSet:
    """Correction that subtracts from each frame the dark frame recorded with the same exposure time.

    Attributes
    ----------
    darks
        Dark steps by exposure time (s).

    Raises
    ------
    InputError
        If there are none.
    """

    darks: Mapping[float, Dark]

    def __post_init__(self) -> None:
        """Check that there is at least one dark."""
        if not self.darks:
            raise InputError.expected("dark frames", "at least one", "none", "record some, or leave them out")

    @property
    def shape(self) -> tuple[int, int] | None:
        """Shape ``(rows, columns)`` of the frames to which the step applies (px). None: any shape."""
        return next(iter(self.darks.values())).shape

    def at(self, exposure_s: float | None) -> Dark:
        """Return the dark step for the exposure time ``exposure_s`` (s); if it is None, the only dark step.

        Raises
        ------
        InputError
            If no dark step has an exposure time within 1 % of ``exposure_s``, or it is None and there are several.
        """
        if exposure_s is None:
            # a single dark is used for frames without a stated exposure; among several, any choice could be wrong
            if len(self.darks) == 1:
                return next(iter(self.darks.values()))
            raise InputError.expected(
                "exposure of the frame",
                "the exposure of a dark frame",
                "none",
                "state the exposures of the frames, or give a single dark frame",
            )
        nearest = min(self.darks, key=lambda seconds: abs(seconds - exposure_s))
        # cameras report exposures rounded to their clock
        if abs(nearest - exposure_s) > 0.01 * exposure_s:
            known = ", ".join(f"{seconds:g}" for seconds in sorted(self.darks))
            raise InputError.expected(
                "exposure of the dark frame", f"{exposure_s:g} s", f"{known} s", "record dark frames with this exposure"
            )
        return self.darks[nearest]

    def describe(self) -> dict[str, Any]:
        """Return a JSON-compatible description of the step, for provenance."""
        return {"kind": "darks", "by_exposure": {f"{s:g}": dark.describe() for s, dark in self.darks.items()}}


def white_gain(
    light: NDArray[np.float32], floor: float, cfa: str = ""
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the factors that flatten the white image ``light``, and a mask of the pixels with limited factors.

    The relative brightness is ``light`` divided by its 99th percentile, which is computed separately for each position
    of the pattern ``cfa``. A factor is the inverse of the relative brightness, but at most ``1 / floor``.

    Raises
    ------
    InputError
        If a percentile is not positive.
    """
    relative = np.empty_like(light)
    for rows, columns in phases(cfa):
        part = light[rows, columns]
        # the 99th percentile instead of the maximum: a hot pixel or a reflection must not set the scale
        peak = float(np.percentile(part, 99))
        if not peak > 0:
            raise InputError.expected(
                "white frame",
                "light above the dark level",
                f"99th percentile {peak:g}",
                "check the lamp and the shutter, and that white and dark are not swapped",
            )
        np.divide(part, np.float32(peak), out=relative[rows, columns])
    # in place from here on: a frame of 29 MP takes 115 MB in float32
    dim = relative < floor
    np.maximum(relative, np.float32(floor), out=relative)
    return np.reciprocal(relative, out=relative), dim


@dataclass(frozen=True, eq=False)
class White:
    """Correction that divides frames by the relative brightness of a white image, which removes vignetting.

    The white image minus its dark frame is divided by its 99th percentile, separately for each position of the colour
    filter pattern. The brightest part of the field then keeps its values, and colours keep their ratio. Where the
    relative brightness is below ``floor``, as in the gaps between lenslet images, pixels are divided by ``floor`` and
    marked in ``dim``.

    Attributes
    ----------
    frame
        Mean white image (counts), ``(rows, columns)``; not stored.
    dark
        Dark frame ``(rows, columns)`` or level to subtract from ``frame`` (counts); 0 if it was already subtracted. Not
        stored.
    floor
        Lowest relative brightness by which frames are divided, above 0 and at most 1.
    cfa
        Colour filter pattern in row-major order, such as ``"RGGB"``; empty for monochrome frames.
    saturation
        Sample value at which a pixel is saturated (counts). None: the highest value of an integer type.
    gain, dim
        Factors by which frames are multiplied, and a mask of the pixels at which ``floor`` limits them; both
        ``(rows, columns)``, and computed.

    Raises
    ------
    InputError
        If the white image is not finite or shows no light, more than 0.1 % of its pixels are saturated, or ``dark`` has
        another shape.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import White
    >>> white = White(np.array([[110, 110, 110, 60]] * 4), dark=10.0)
    >>> white.gain[0].tolist()
    [1.0, 1.0, 1.0, 2.0]
    """

    frame: InitVar[NDArray[Any]]
    dark: InitVar[NDArray[Any] | float]
    floor: float = 0.05
    cfa: str = ""
    saturation: float | None = None
    gain: NDArray[np.float32] = field(init=False, repr=False)
    dim: NDArray[np.bool_] = field(init=False, repr=False)

    def __post_init__(self, frame: NDArray[Any], dark: NDArray[Any] | float) -> None:
        """Check the frames and compute the gain."""
        check_number("white floor", self.floor, above=0, at_most=1)
        raw = np.asarray(frame)
        white = as_sensor_frame("white frame", raw)
        self._check_saturation(raw)
        level = np.asarray(dark, np.float32)
        if level.ndim:
            level = as_sensor_frame("dark frame for the white frame", level)
        if level.ndim and level.shape != white.shape:
            raise InputError.expected(
                "dark frame for the white frame",
                format_pixels(white.shape),
                format_pixels(level.shape),
                "record both with the same sensor settings",
            )
        gain, dim = white_gain(white - level, self.floor, self.cfa)
        for name, value in (("gain", gain), ("dim", dim)):
            # shared by every frame and thread, so it must not change
            value.setflags(write=False)
            object.__setattr__(self, name, value)

    def _check_saturation(self, raw: NDArray[Any]) -> None:
        level = self.saturation
        if level is None and raw.dtype.kind in "iu":
            level = np.iinfo(raw.dtype).max
        if level is None:
            return
        share = float(np.count_nonzero(raw >= level)) / raw.size
        # clipped pixels are too dark compared with others, so their gain would be wrong; a few hot pixels do no harm
        if share > 1e-3:
            raise InputError.expected(
                "white frame", "at most 0.1 % saturated", f"{100 * share:.3g} %", "reduce its exposure"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the frames to which the step applies (px)."""
        return self.gain.shape[0], self.gain.shape[1]

    def describe(self) -> dict[str, Any]:
        """Return a JSON-compatible description of the step, for provenance."""
        return {
            "kind": "white",
            "floor": float(self.floor),
            "cfa": self.cfa,
            "dim_pixels": int(np.count_nonzero(self.dim)),
            "largest_gain": float(self.gain.max()),
            "crc32": fingerprint(self.gain),
        }


@dataclass(frozen=True)
class Exposure:
    """Correction that scales frames to the exposure time ``reference_s`` (s).

    Raises
    ------
    InputError
        If ``reference_s`` is not a possible exposure time.

    Examples
    --------
    >>> from lfcal.frames import Exposure
    >>> Exposure(reference_s=0.02).factor(0.005)
    4.0
    """

    reference_s: float

    def __post_init__(self) -> None:
        """Check the reference."""
        check_exposure("reference exposure (s)", self.reference_s)

    @property
    def shape(self) -> tuple[int, int] | None:
        """Always None, because the step applies to frames of any shape."""
        return None

    def factor(self, exposure_s: float | None) -> float:
        """Return ``reference_s / exposure_s``, the factor for a frame with the exposure time ``exposure_s`` (s).

        Raises
        ------
        InputError
            If the exposure time of the frame is unknown, or not above 0.
        """
        if exposure_s is None:
            raise InputError.expected(
                "exposure of the frame",
                "a time in seconds",
                "none",
                "add an exposure_s column to the manifest or leave out the exposure correction",
            )
        check_exposure("exposure of the frame (s)", exposure_s)
        return self.reference_s / float(exposure_s)

    def describe(self) -> dict[str, Any]:
        """Return a JSON-compatible description of the step, for provenance."""
        return {"kind": "exposure", "reference_s": float(self.reference_s)}


BORDER_SAMPLES = 20_000
"""Largest number of border pixels for fitting a plane, evenly spread."""

Plane = tuple[float, float, float]
"""Background at pixel (0, 0) and its change per row and per column (sample values)."""


def border_strips(shape: tuple[int, int], width: int) -> list[Region]:
    """Return the regions (top, bottom, left, right) that cover the border of a frame of ``shape`` without overlap.

    ``width`` is the width of the border (px). If opposite borders meet, the only region is the whole frame.
    """
    rows, columns = shape
    # such a small frame is only border
    if 2 * width >= min(rows, columns):
        return [(slice(0, rows), slice(0, columns))]
    inner = slice(width, rows - width)
    return [
        (slice(0, width), slice(0, columns)),
        (slice(rows - width, rows), slice(0, columns)),
        (inner, slice(0, width)),
        (inner, slice(columns - width, columns)),
    ]


def fit_plane(rows: NDArray[Any], columns: NDArray[Any], values: NDArray[Any], *, rounds: int = 4) -> Plane:
    """Return ``(p0, p1, p2)`` of the plane ``p0 + p1 row + p2 column`` fitted to ``values`` at (``rows``, ``columns``).

    The three arrays are one-dimensional. The plane is fitted up to ``rounds`` times. The first fit omits values that
    are farther than 6 robust standard deviations from the median. Later fits omit those farther than 3 from the
    previous plane.
    """
    design = np.stack([np.ones(rows.size), rows, columns], axis=1).astype(np.float64)
    values = values.astype(np.float64)
    # a wider first cut: the median ignores the slope, and a steep plane varies strongly about it
    keep = np.abs(values - np.median(values)) <= 6 * _sigma(values) + 1e-12
    solution = np.zeros(3)
    for _ in range(rounds):
        solution = np.linalg.lstsq(design[keep], values[keep], rcond=None)[0]
        residual = values - design @ solution
        # the last term keeps all values of a plane without noise, whose sigma is only rounding
        again = np.abs(residual) <= 3 * _sigma(residual[keep]) + 1e-9 * (1 + np.abs(values).max())
        # fewer than three points do not fix a plane, and an unchanged choice gives the same plane again
        if np.array_equal(again, keep) or np.count_nonzero(again) < 3:
            break
        keep = again
    return float(solution[0]), float(solution[1]), float(solution[2])


def _sigma(values: NDArray[np.float64]) -> float:
    """Return the robust standard deviation, 1.4826 times the median absolute deviation."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


@dataclass(frozen=True)
class Background:
    """Correction that subtracts the background; negative differences are kept.

    Attributes
    ----------
    kind
        ``"constant"``: ``value`` is subtracted. ``"border"``: the median of each frame's border is subtracted.
        ``"plane"``: a plane fitted to each frame's border is subtracted; spots are left out of the fit.
    value
        Level of the constant background (counts after the preceding steps of the chain).
    width
        Width of the border (px).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import Background, CorrectionChain
    >>> frame = np.full((32, 32), 12, np.uint16)
    >>> frame[15, 15] = 100
    >>> clean = CorrectionChain((Background("border", width=4),)).apply(frame)
    >>> print(clean[0, 0], clean[15, 15])
    0.0 88.0
    """

    kind: str = "border"
    value: float = 0.0
    width: int = 8

    def __post_init__(self) -> None:
        """Check the values."""
        check_choice("background", self.kind, ("constant", "border", "plane"))
        check_number("background level", self.value)
        check_number("background border (px)", self.width, at_least=1, at_most=4096, integer=True)

    @property
    def shape(self) -> tuple[int, int] | None:
        """Always None, because the step applies to frames of any shape."""
        return None

    @property
    def measured(self) -> bool:
        """Whether the background is measured on each frame."""
        return self.kind != "constant"

    def measure(self, part: Callable[[Region], NDArray[np.float32]], shape: tuple[int, int]) -> Plane:
        """Return the background of a frame: its level at pixel (0, 0), and its slopes per row and per column.

        ``part`` is a function that returns the pixels of a region after the preceding steps of the chain, and ``shape``
        is the shape ``(rows, columns)`` of the frame. Without a valid pixel at the border, all are 0.
        """
        if self.kind == "constant":
            return float(self.value), 0.0, 0.0
        rows, columns, values = [], [], []
        for region in border_strips(shape, self.width):
            strip = part(region)
            # NaN marks masked pixels, which are not yet repaired at this stage of the chain
            r, c = np.nonzero(np.isfinite(strip))
            values.append(strip[r, c])
            rows.append(r + region[0].start)
            columns.append(c + region[1].start)
        value = np.concatenate(values)
        if not value.size:
            return 0.0, 0.0, 0.0
        if self.kind == "border":
            return float(np.median(value)), 0.0, 0.0
        some = slice(None, None, 1 + value.size // BORDER_SAMPLES)
        return fit_plane(np.concatenate(rows)[some], np.concatenate(columns)[some], value[some])

    def describe(self) -> dict[str, Any]:
        """Return a JSON-compatible description of the step, for provenance."""
        record: dict[str, Any] = {"kind": "background", "method": self.kind}
        return record | ({"width": self.width} if self.measured else {"value": float(self.value)})
