"""The ordered chain of corrections of a raw frame, computed in signed float32."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    InputError,
    Region,
    any_of,
    check_region,
    format_pixels,
    grow_region,
    kernel_input,
    region_shape,
    whole,
)
from lfcal.frames.corrections import _kernels
from lfcal.frames.corrections.defects import Defects, repair_nan
from lfcal.frames.corrections.steps import Background, Dark, DarkSet, Exposure, PixelMask, Plane, White

__all__ = ["CorrectionChain", "Step"]

Step: TypeAlias = PixelMask | Dark | DarkSet | White | Defects | Background | Exposure

_RANK = {PixelMask: 0, Dark: 1, DarkSet: 1, White: 2, Defects: 3, Background: 4, Exposure: 4}
_ONCE = ((PixelMask,), (Dark, DarkSet), (White,), (Defects,), (Background,), (Exposure,))
"""Groups of steps of which a chain has at most one; a dark and a set of darks subtract the same level."""

_EMPTY = np.zeros((0, 0), np.float32)
_EMPTY.setflags(write=False)  # read-only like the frames of the steps, so that one compiled kernel serves both


@dataclass(frozen=True, eq=False)
class CorrectionChain:
    """Corrections applied in this order: mask, dark, white, defects, then background and exposure in either order.

    Any step may be omitted, and none may occur twice. An empty chain only converts samples to float32. Values are not
    clipped. Masked pixels become NaN. Dark, white, background and exposure are applied in one compiled pass. Defects
    are interpolated afterwards, with the same result as if they had been repaired at their place in the order.

    Attributes
    ----------
    steps
        Sequence of `PixelMask`, `Dark` or `DarkSet`, `White`, `Defects`, `Background` and `Exposure` objects, in the
        order of application.
    saturation
        Raw sample value at which a pixel is saturated (counts). None: the value in the frames' metadata.

    Raises
    ------
    InputError
        If the order is wrong (the message states what to swap), a step occurs twice, or steps are for sensors of
        different shapes.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import CorrectionChain, Dark, White
    >>> white = np.array([[110, 110, 110, 60]] * 4)
    >>> chain = CorrectionChain((Dark(level=10.0), White(white, dark=10.0)))
    >>> chain.apply(np.full((4, 4), 50, np.uint16))[0].tolist()
    [40.0, 40.0, 40.0, 80.0]
    """

    steps: tuple[Step, ...] = ()
    saturation: float | None = None

    def __post_init__(self) -> None:
        """Check order and shapes."""
        steps = tuple(self.steps)
        object.__setattr__(self, "steps", steps)
        for step in steps:
            # exact types, because ranks are looked up by type
            if type(step) not in _RANK:
                raise InputError.expected(
                    "correction",
                    "PixelMask, Dark, White, Defects, Background or Exposure",
                    type(step).__name__,
                    "leave it out",
                )
        for before, after in itertools.pairwise(steps):
            if _RANK[type(before)] > _RANK[type(after)]:
                a, b = _name(before), _name(after)
                raise InputError.expected(
                    "order of corrections", f"{b} before {a}", f"{a} before {b}", "exchange the two corrections"
                )
        for kinds in _ONCE:
            same = [_name(step) for step in steps if type(step) in kinds]
            if len(same) > 1:
                wanted = any_of(kind.__name__ for kind in kinds)
                raise InputError.expected("corrections", f"one {wanted}", " and ".join(same), "merge them into one")
        sized = [(_name(step), step.shape) for step in steps if step.shape is not None]
        for name, shape in sized[1:]:
            first, expected = sized[0]
            if shape != expected:
                raise InputError.expected(
                    f"size of {name}",
                    f"{format_pixels(expected)}, as in {first}",
                    format_pixels(shape),
                    "record all calibration frames with the same sensor settings",
                )

    @property
    def shape(self) -> tuple[int, int] | None:
        """Shape ``(rows, columns)`` of the frames to which the chain applies (px). None: any shape."""
        return next((step.shape for step in self.steps if step.shape is not None), None)

    @property
    def margin(self) -> int:
        """Width of the margin needed around a region to correct the region exactly as in the whole frame (px)."""
        defects = self._find(Defects)
        return 0 if defects is None else defects.margin

    @property
    def measures_frames(self) -> bool:
        """Whether the background is measured on each frame, so that correcting a region requires the whole frame."""
        background: Background | None = self._find(Background)
        return background is not None and background.measured

    def apply(
        self,
        frame: NDArray[Any],
        *,
        exposure_s: float | None = None,
        out: NDArray[np.float32] | None = None,
        workers: int | None = 1,
    ) -> NDArray[np.float32]:
        """Return the corrected frame, ``(rows, columns)`` float32.

        Parameters
        ----------
        frame
            Raw frame ``(rows, columns)`` of any integer or float type; it is not changed.
        exposure_s
            Exposure time of the frame (s); required if the chain has an `Exposure` step, or a `DarkSet` for several
            exposure times.
        out
            Contiguous float32 array ``(rows, columns)`` for the result. None: a new array.
        workers
            Number of threads. None: all processors.

        Raises
        ------
        InputError
            If the frame is not 2-D, its shape is not that of the chain, or a required exposure time is missing.
        """
        shape = self._check_frame(frame)
        plane = self.measure(lambda region: frame[region], shape, exposure_s=exposure_s)
        return self._run(frame, whole(shape), plane, exposure_s, out=out, workers=workers)

    def apply_region(
        self,
        part: NDArray[Any],
        region: Region,
        *,
        inside: Region | None = None,
        exposure_s: float | None = None,
        background: Plane | None = None,
    ) -> NDArray[np.float32]:
        """Return the corrected region ``inside`` of a frame, ``(rows, columns)`` float32.

        Parameters
        ----------
        part
            Raw pixels of ``region``, ``(rows, columns)``; not changed.
        region
            Rows and columns of ``part`` in sensor coordinates (px), as ``slice(start, stop)`` each.
        inside
            Region to return, within ``region``. None: all of it. The result equals that of the whole frame if
            ``region`` exceeds ``inside`` by `margin` on every side (see `grow_region`).
        exposure_s
            As in `apply`.
        background
            Result of `measure` for this frame; needed if `measures_frames`.

        Raises
        ------
        InputError
            If the shapes do not match, or the background of the frame is needed but missing.
        """
        # without a sensor shape, any region fits: the limit only needs to exceed every sensor
        limit = self.shape or (1 << 30, 1 << 30)
        region = check_region(region, limit)
        if part.shape != region_shape(region):
            raise InputError.expected(
                "part of a frame", f"shape {region_shape(region)}", part.shape, "pass the pixels of the region"
            )
        if self.measures_frames and background is None:
            raise InputError.expected(
                "background of the frame",
                "the result of measure() for this frame",
                "none",
                "call measure() first, correct whole frames, or use a constant background",
            )
        if background is None:
            background = self.measure(lambda _: part, region_shape(region), exposure_s=exposure_s)
        result = self._run(part, region, background, exposure_s)
        if inside is None:
            return result
        (r, c), (rows, columns) = region, check_region(inside, (region[0].stop, region[1].stop))
        return np.ascontiguousarray(
            result[rows.start - r.start : rows.stop - r.start, columns.start - c.start : columns.stop - c.start]
        )

    def measure(
        self,
        read: Callable[[Region], NDArray[Any]],
        shape: tuple[int, int],
        *,
        exposure_s: float | None = None,
    ) -> Plane:
        """Return a frame's background for `apply_region`: its level at pixel (0, 0), and slopes per row and per column.

        ``read`` is a function that returns the raw pixels of a region of the frame. The shape ``(rows, columns)`` of
        the frame is ``shape``. Only its border is read, or nothing if the background is constant. Without a
        `Background` step, all three values are 0. ``exposure_s`` is as in `apply`.
        """
        background: Background | None = self._find(Background)
        if background is None:
            return 0.0, 0.0, 0.0
        if not background.measured:
            return background.measure(lambda _: _EMPTY, shape)
        # the border is corrected by the steps before the background, which is in their values
        ahead = CorrectionChain(self.steps[: self.steps.index(background)])

        def part(region: Region) -> NDArray[np.float32]:
            grown = grow_region(region, ahead.margin, shape)
            return ahead.apply_region(read(grown), grown, inside=region, exposure_s=exposure_s)

        return background.measure(part, shape)

    def keeps_level(self) -> bool:
        """Return whether corrected frames still contain the black level, because no step subtracts it."""
        return not any(isinstance(step, Dark | DarkSet | Background) for step in self.steps)

    def factor(self, exposure_s: float | None) -> float:
        """Return the factor of the `Exposure` step for a frame exposed for ``exposure_s`` (s); 1 without that step."""
        step: Exposure | None = self._find(Exposure)
        return 1.0 if step is None else step.factor(exposure_s)

    def gain(self, region: Region) -> NDArray[np.float64] | None:
        """Return the factors of the `White` step in a sensor region, ``(rows, columns)``; None without that step."""
        white: White | None = self._find(White)
        return None if white is None else white.gain[region].astype(np.float64)

    def dark_at(self, exposure_s: float | None) -> Dark | None:
        """Return the `Dark` step for frames with the exposure time ``exposure_s`` (s); None without a dark step.

        Raises
        ------
        InputError
            If the chain has a `DarkSet` without a dark frame for this exposure time (see `DarkSet.at`).
        """
        found: Dark | DarkSet | None = self._find(Dark) or self._find(DarkSet)
        return None if found is None else found.at(exposure_s)

    def only_dark(self) -> Dark | None:
        """Return the `Dark` step that applies to every frame; None if there is none, or several by exposure time."""
        found: Dark | DarkSet | None = self._find(Dark) or self._find(DarkSet)
        if isinstance(found, DarkSet):
            return next(iter(found.darks.values())) if len(found.darks) == 1 else None
        return found

    def level(self, plane: Plane, exposure_s: float | None, place: tuple[float, float]) -> float:
        """Return a frame's background at the sensor position ``place`` (row, column; px), in corrected counts.

        ``plane`` is the result of `measure`, and ``exposure_s`` the exposure time of the frame (s).
        """
        _, offset = self._affine(plane, exposure_s)
        return float(offset[0] + offset[1] * place[0] + offset[2] * place[1])

    def masked(self, region: Region) -> NDArray[np.bool_] | None:
        """Return a mask ``(rows, columns)``, True at the masked pixels of a sensor region; None if none is masked."""
        mask: PixelMask | None = self._find(PixelMask)
        lost = None if mask is None else mask.lost[region]
        return lost if lost is not None and lost.any() else None

    def repaired(self, region: Region) -> NDArray[np.intp]:
        """Return the repaired defects in a sensor region, ``(n, 2)``: (row, column) relative to its first pixel."""
        defects: Defects | None = self._find(Defects)
        if defects is None or not len(defects):
            return np.zeros((0, 2), np.intp)
        at = np.asarray(defects.pixels, np.intp) - np.array([region[0].start, region[1].start])
        inside: NDArray[np.intp] = at[((at >= 0) & (at < np.array(region_shape(region)))).all(axis=1)]
        return inside

    def describe(self) -> dict[str, Any]:
        """Return a JSON-compatible description for provenance: each step with its parameters and checksums."""
        return {"steps": [step.describe() for step in self.steps], "saturation": self.saturation}

    def _find(self, kind: type[Any]) -> Any:
        return next((step for step in self.steps if type(step) is kind), None)

    def _check_frame(self, frame: NDArray[Any]) -> tuple[int, int]:
        if frame.ndim != 2:
            raise InputError.expected("frame", "2 axes (rows, columns)", frame.shape, "pass one frame at a time")
        shape = (frame.shape[0], frame.shape[1])
        if self.shape is not None and shape != self.shape:
            raise InputError.expected(
                "frame",
                f"{format_pixels(self.shape)}, as in the calibration frames",
                format_pixels(shape),
                "record frame, dark and white with the same sensor settings",
            )
        return shape

    def _affine(self, plane: Plane, exposure_s: float | None) -> tuple[float, NDArray[np.float64]]:
        """Return the factor and the plane ``(3,)`` of background and exposure together: ``value * factor - plane``."""
        factor, offset = 1.0, np.zeros(3)
        for step in self.steps:
            if isinstance(step, Background):
                offset = offset + np.array(plane)
            elif isinstance(step, Exposure):
                # exposure after background also scales the background, exposure before it does not
                scale = step.factor(exposure_s)
                factor, offset = factor * scale, offset * scale
        return factor, offset

    def _run(
        self,
        part: NDArray[Any],
        region: Region,
        plane: Plane,
        exposure_s: float | None,
        *,
        out: NDArray[np.float32] | None = None,
        workers: int | None = 1,
    ) -> NDArray[np.float32]:
        white, defects = self._find(White), self._find(Defects)
        dark = self.dark_at(exposure_s)
        dark_part = None if dark is None else dark.part(region)
        dark_frame = _EMPTY if dark_part is None else dark_part
        level = 0.0 if dark is None else dark.level
        gain = _EMPTY if white is None else white.gain[region]
        r0, c0 = region[0].start, region[1].start
        raw = _narrow(part)
        if (lost := self.masked(region)) is not None:
            raw = np.where(lost, np.float32(np.nan), raw).astype(np.float32, copy=False)
        result = np.empty(part.shape, np.float32) if out is None else _check_out(out, part.shape)
        factor, offset = self._affine(plane, exposure_s)
        # the kernel counts from the first pixel of the part, like the parts of dark and gain
        local = np.array([offset[0] + offset[1] * r0 + offset[2] * c0, offset[1], offset[2]])

        maps = kernel_input(dark_frame), kernel_input(gain)
        terms = _kernels.CorrectionTerms(*maps, np.float32(level), np.float32(factor), *local.tolist())
        samples = kernel_input(raw)

        _kernels.correct(samples, terms, result, workers)
        if defects is not None:
            _kernels.repair_pixels(result, r0, c0, offset, defects.pixels, defects.neighbours)
            # only floats can hold NaN, and only masks put them there
            if raw.dtype.kind == "f":
                repair_nan(result, (r0, c0), offset, defects.cfa)
        return result


def _narrow(part: NDArray[Any]) -> NDArray[Any]:
    """Return the samples as uint16 or float32, contiguous: the two types the kernel is compiled for."""
    # uint8 converts without loss; wider integers and other floats lose nothing that a sensor measures
    return np.ascontiguousarray(part, np.uint16 if part.dtype in (np.uint8, np.uint16) else np.float32)


def _check_out(out: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    if out.shape != shape or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise InputError.expected(
            "output array", f"contiguous float32 of shape {shape}", f"{out.dtype} of shape {out.shape}", "pass None"
        )
    return out


def _name(step: object) -> str:
    return type(step).__name__
