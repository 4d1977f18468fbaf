"""Channels of colour mosaics, colour gains, and the part of a scan that one channel records."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, Position, Region, check_region, whole
from lfcal.camera import ScanPlan
from lfcal.frames.cfa import channel_names, channel_phase, pattern_side, phases
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, Samples, masked
from lfcal.frames.view import SourceView

__all__ = [
    "BalancedSource",
    "ChannelSource",
    "ColourScan",
    "OneColourSource",
    "ThinnedSource",
    "are_cutouts",
    "balanced_source",
    "channel_source",
    "colour_scan",
    "colours_of",
]


def are_cutouts(source: FrameSource) -> bool:
    """Return whether frames are cutouts: any has another origin than the metadata state (if none: (0, 0))."""
    part = source.metadata.origin or (0, 0)
    return any(source.info(k).origin != part for k in range(len(source)))


class ChannelSource(SourceView):
    """View of a source of mosaics, with only the pixels at one position of the colour filter pattern.

    Pixel ``(r, c)`` is pixel ``(r0 + step r, c0 + step c)`` of the mosaic. The metadata contain (r0, c0) as
    ``channel_phase`` and the step as ``pixel_step`` (2 for a Bayer pattern). Drifts are in pixels of the channel.

    Cutouts must all start at the same pixel of the pattern, as those of `ThinnedSource` do. ``cfa`` is the
    colour filter pattern of the sensor, for cutouts whose metadata state none.
    """

    def __init__(self, source: FrameSource, channel: str, cfa: str = "") -> None:
        super().__init__(source)
        self._cut = are_cutouts(source)
        cfa = self.known.cfa or (cfa if self._cut else "")
        self.channel = channel
        self._phase = self._origin = channel_phase(cfa, channel)
        self._step = pattern_side(cfa)
        self._position = channel_names(cfa).index(channel)
        if self._cut and len(source):
            r0, c0 = self._phase
            row, column = source.info(0).origin
            self._origin = ((r0 - row) % self._step, (c0 - column) % self._step)

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of the channel (px of the channel)."""
        (r0, c0), (rows, columns) = self._origin, self.source.shape
        # ceiling division: a mosaic that ends within a pattern still has pixels of some channels
        return -(-(rows - r0) // self._step), -(-(columns - c0) // self._step)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known`` of the mosaic, changed to those of the channel."""
        black, gains, place = known.black_level, known.gains, known.origin
        return replace(
            known,
            cfa="",
            # one value per position of the pattern: use that of the channel
            black_level=black[self._position] if isinstance(black, tuple) else black,
            gains=gains[self._position] if isinstance(gains, tuple) else gains,
            origin=None if place is None else (place[0] // self._step, place[1] // self._step),
            channel=self.channel,
            channel_phase=self._phase,
            pixel_step=self._step,
            darks={seconds: self._dark(dark) for seconds, dark in known.darks.items()},
        )

    def _dark(self, dark: Any) -> Any:
        """Return a recorded dark frame reduced to the pixels of the channel."""
        if dark.frame is None:
            return dark
        (r0, c0), (row, column), step = self._phase, dark.origin, self._step
        first = ((r0 - row) % step, (c0 - column) % step)
        place = ((row + first[0] - r0) // step, (column + first[1] - c0) // step)
        return replace(dark, frame=dark.frame[first[0] :: step, first[1] :: step], origin=place)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``, with origin and drift in pixels of the channel.

        Raises
        ------
        InputError
            If a cutout starts at another pixel of the pattern than the first cutout. Also if the frames show a part of
            the sensor that does not start at the first pixel of the pattern.
        """
        info, (r0, c0), step = self.source.info(index), self._phase, self._step
        origin = info.origin if self._cut else self.known.origin or (0, 0)
        # pixels of the mosaic from the channel's first pixel to the first one in this frame
        ahead = origin[0] + self._origin[0] - r0, origin[1] + self._origin[1] - c0
        if any(n % step for n in ahead):
            # the size of a channel would differ from frame to frame
            raise InputError.expected(
                f"channel {self.channel} of {info.label}",
                "cutouts that start at the same pixel of the colour pattern"
                if self._cut
                else "a part that starts at the first pixel of a colour pattern",
                f"one that starts at {origin}",
                "select the positions of one colour (lfcal assemble --channel)" if self._cut else "record whole frames",
            )
        drift = None if info.drift is None else (info.drift[0] / step, info.drift[1] / step)
        mask = None if info.mask is None else info.mask[self._origin[0] :: step, self._origin[1] :: step]
        place = (ahead[0] // step, ahead[1] // step)
        return replace(info, origin=place, drift=drift, label=f"{info.label} {self.channel}", mask=mask)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return the channel of frame ``index``, or the part of it in ``region`` (px of the channel)."""
        rows, columns = (
            # read the mosaic only from the first to the last pixel of the channel
            slice(start + self._step * part.start, start + self._step * (part.stop - 1) + 1)
            for start, part in zip(self._origin, check_region(region or whole(self.shape), self.shape), strict=True)
        )
        return np.ascontiguousarray(self.source.read(index, (rows, columns))[:: self._step, :: self._step])

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of the channel in frame ``index``, or those in ``region`` (px of the channel)."""
        return Frames.samples(self, index, region)


class OneColourSource(SourceView):
    """View of a source of mosaics in which only the pixels of ``channel`` are valid.

    The colour filter pattern is that in the metadata of the frames, or else that of the sensor of ``plan``.
    """

    def __init__(self, source: FrameSource, channel: str, plan: ScanPlan) -> None:
        super().__init__(source)
        cfa = _filter(source, plan)
        (row, column), step = channel_phase(cfa, channel), pattern_side(cfa)
        self._mask = np.zeros(source.shape, np.bool_)
        self._mask[row::step, column::step] = True

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index``, or of the part of it in ``region``; other colours are invalid."""
        return masked(self.source.samples(index, region), self._mask[region or whole(self.shape)])


class BalancedSource(SourceView):
    """View of a source of mosaics, with balanced colours as float32; use it on dark-corrected frames.

    Each position of the colour filter pattern is multiplied by its gain. ``gains`` lists the gains in row-major order.
    None: those of the camera's white balance.
    """

    def __init__(self, source: FrameSource, gains: Sequence[float] | None = None) -> None:
        super().__init__(source)
        cfa = self.known.cfa
        names = channel_names(cfa)
        given = self.known.gains if gains is None else gains
        values = () if given is None or isinstance(given, float | int) else tuple(float(g) for g in given)
        if not names or len(values) != len(names) or not all(np.isfinite(values)) or min(values) <= 0:
            raise InputError.expected(
                "colour gains",
                f"positive numbers for {', '.join(names) or 'a colour mosaic'}",
                given,
                "measure them on a white frame",
            )
        self.gains = values
        self._side = pattern_side(cfa)
        self._phases = phases(cfa)

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type, float32."""
        return np.dtype(np.float32)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known`` with the gains as ``balanced_by``, and without saturation and bit depth.

        Saturation now differs between colours.
        """
        return replace(known, saturation=None, bit_depth=None, gains=None, balanced_by=self.gains)

    def read(self, index: int, region: Region | None = None) -> NDArray[np.float32]:
        """Return frame ``index``, or the part of it in ``region``, with balanced colours."""
        rows, columns = check_region(region or whole(self.shape), self.shape)
        part = self.source.read(index, (rows, columns)).astype(np.float32)
        # frames of a part of the sensor count the pattern from their first pixel, cutouts from that of the sensor
        place = (0, 0) if self.known.origin is not None else self.source.info(index).origin
        top, left = (a.start + b for a, b in zip((rows, columns), place, strict=True))
        for k, gain in enumerate(self.gains):
            r0, c0 = divmod(k, self._side)
            part[(r0 - top) % self._side :: self._side, (c0 - left) % self._side :: self._side] *= np.float32(gain)
        return part

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the balanced samples of frame ``index``, or of the part of it in ``region``.

        Saturation is determined from the values before balancing. The noise of balanced samples is not stated.
        """
        return self.source.samples(index, region)._replace(values=self.read(index, region), noise=None)


def channel_source(source: FrameSource, channel: str) -> ChannelSource:
    """Return a view of ``source`` with one colour of the mosaic, such as ``"R"``, ``"G1"``, ``"G2"`` or ``"B"``.

    The greens are numbered in row-major order: in ``GRBG``, G1 is the first pixel.

    Raises
    ------
    InputError
        If the frames are monochrome or have no such channel.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, ChannelSource, channel_source
    >>> mosaic = np.array([[[50, 100, 51, 101], [102, 80, 103, 81]]])
    >>> source = ArraySource(mosaic, [(0, 0, 0)], metadata={"cfa": "RGGB"})
    >>> green: ChannelSource = channel_source(source, "G2")
    >>> print(green.shape, green.read(0).tolist())
    (1, 2) [[102, 103]]
    """
    return ChannelSource(source, channel)


def balanced_source(source: FrameSource, gains: Sequence[float] | None = None) -> BalancedSource:
    """Return a view of ``source`` with its colours multiplied by ``gains``, in row-major order of the pattern.

    Without ``gains``, those of the camera's white balance are used.

    Raises
    ------
    InputError
        If the frames are monochrome, or the gains are unknown or not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, BalancedSource, balanced_source
    >>> grey_card = ArraySource(np.array([[[50, 100], [100, 80]]]), [(0, 0, 0)], metadata={"cfa": "RGGB"})
    >>> balanced: BalancedSource = balanced_source(grey_card, (2.0, 1.0, 1.0, 1.25))
    >>> balanced.read(0).tolist()
    [[100.0, 100.0], [100.0, 100.0]]
    """
    return BalancedSource(source, gains)


@dataclass(frozen=True)
class ColourScan:
    """The part of a scan that is recorded by one colour channel.

    Attributes
    ----------
    channel
        Name of the channel.
    plan
        Plan of the channel, in channel pixels, with larger camera pixels, fewer positions and a smaller cutout.
    first
        Smallest indices y and x of the positions of the scan that belong to the channel; every ``step``-th position
        after them also belongs to it.
    step
        Period of the colour filter pattern (sensor pixels).
    """

    channel: str
    plan: ScanPlan
    first: tuple[int, int]
    step: int


def colours_of(source: FrameSource, plan: ScanPlan) -> tuple[str, ...]:
    """Return the names of the colour channels of the frames, or else of the plan's sensor; empty if monochrome."""
    return channel_names(_filter(source, plan))


def _filter(source: FrameSource, plan: ScanPlan) -> str:
    sensor = plan.camera.sensor
    whole = source.shape == sensor.shape
    return source.metadata.cfa or (sensor.cfa if whole or are_cutouts(source) else "")


def colour_scan(source: FrameSource, plan: ScanPlan, channel: str) -> ColourScan | None:
    """Return the part of a mosaic's scan that ``channel`` records; None if ``plan`` is already the channel's plan.

    The plan is taken as the channel's if frames are neither as large as its sensor, nor cutouts of a sensor with a
    colour filter.

    A step that moves the image by one pixel of the mosaic moves it by half a pixel of a Bayer channel. H needs steps of
    whole pixels. Each channel of a Bayer pattern therefore uses a quarter of the positions: those whose image is
    centred on one of its pixels. The light pattern repeats after one cell of the lenslet array, but on the same colour
    only if the cell is an even number of pixels. Otherwise two cells must be scanned.

    Raises
    ------
    InputError
        If there is no such channel, the period is not a multiple of the filter's period, or the plan resamples.
    """
    cfa = _filter(source, plan)
    phase, step = channel_phase(cfa, channel), pattern_side(cfa)
    other = source.shape != plan.camera.sensor.shape
    if other and not (plan.camera.sensor.cfa and are_cutouts(source)):
        return None
    if plan.resample:
        raise InputError.expected(
            f"plan for channel {channel}",
            "sensor pixels",
            "resampled pixels",
            "make the plan without resampling (lfcal plan without --resample)",
        )
    if any(n % step for n in plan.period):
        rows, columns = (math.lcm(n, step) for n in plan.period)
        raise InputError.expected(
            f"period of channel {channel}",
            f"a multiple of {step} pixels along each axis, because the colour filter repeats after {step} pixels",
            f"{plan.period[0]} x {plan.period[1]} pixels",
            f'set "period" in plan.json to [{rows}, {columns}], which is a whole number of periods along each axis, '
            "and record the scan again",
        )
    # the first positions whose image is nearest to a pixel of the colour; halves are rounded down, as in cutouts
    first = [(r0 - math.ceil(a - 0.5)) % step for r0, a in zip(phase, plan.anchor, strict=True)]
    anchor = tuple((a + o - r0) / step for a, o, r0 in zip(plan.anchor, first, phase, strict=True))
    most = source.shape if other else plan.camera.sensor.shape
    small = replace(
        plan,
        camera=_camera(plan, phase, step),
        period=(plan.period[0] // step, plan.period[1] // step),
        cutout=(_odd(plan.cutout[0], most[0], step), _odd(plan.cutout[1], most[1], step)),
        anchor=(anchor[0], anchor[1]),
    )
    return ColourScan(channel, small, (first[0], first[1]), step)


def _odd(n: int, most: int, step: int) -> int:
    """Return the smallest odd number of channel pixels that covers ``n`` pixels, limited to ``most`` pixels."""
    return min(-(-n // step) | 1, 2 * ((most - 1) // 2 // step) + 1)


def _camera(plan: ScanPlan, phase: tuple[int, int], step: int) -> Any:
    """Return the camera of the channel: its pixels are larger, and the lattice offset refers to their centre."""
    camera, sensor = plan.camera, plan.camera.sensor
    shape = tuple(-(-(n - r0) // step) for n, r0 in zip(sensor.shape, phase, strict=True))
    aside = [
        (r0 + step * (m - 1) / 2 - (n - 1) / 2) * sensor.pixel_um
        for r0, m, n in zip(phase, shape, sensor.shape, strict=True)
    ]
    x, y = camera.lattice.offset_um
    lattice = replace(camera.lattice, offset_um=(x - aside[1], y - aside[0]))
    own = replace(sensor, shape=(shape[0], shape[1]), pixel_um=sensor.pixel_um * step, cfa="")
    return replace(camera, sensor=own, lattice=lattice)


class ThinnedSource(SourceView):
    """View of the frames at the positions that belong to one colour, with the position numbers of that colour's plan.

    Raises
    ------
    InputError
        If there are no such frames.
    """

    def __init__(self, source: FrameSource, scan: ColourScan) -> None:
        super().__init__(source)
        self._scan = scan
        infos = [source.info(k) for k in range(len(source))]
        (y0, x0), step = scan.first, scan.step
        self._kept = [
            k
            for k, info in enumerate(infos)
            if info.position.y % step == y0 % step and info.position.x % step == x0 % step
        ]
        if not self._kept:
            raise InputError.expected(
                f"frames of channel {scan.channel}",
                f"some at positions with y = {y0}, {y0 + step} … and x = {x0}, {x0 + step} …",
                "none",
                "record the whole scan",
            )

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return the metadata ``known`` without a plan, and with the number of positions of the colour's plan."""
        return replace(known, plan=None, plan_shape=self._scan.plan.shape[:3])

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._kept)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index``, with its position in the colour's plan."""
        info = self.source.info(self._kept[index])
        (y0, x0), step = self._scan.first, self._scan.step
        z, y, x = info.position
        return replace(info, points=(Position(z, (y - y0) // step, (x - x0) // step),))

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or only the part of it in ``region``."""
        return self.source.read(self._kept[index], region)

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the samples of frame ``index``, or of the part of it in ``region``."""
        return self.source.samples(self._kept[index], region)
