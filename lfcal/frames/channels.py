"""Colour mosaics channel by channel, or all channels with their gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.frames.cfa import channel_names, channel_phase, pattern_side, phases
from lfcal.frames.regions import Region, check_region, whole
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, Samples
from lfcal.frames.view import SourceView

__all__ = ["BalancedSource", "ChannelSource", "balanced_source", "channel_source"]


class ChannelSource(SourceView):
    """One position of the colour filter pattern as frames of their own: half the rows and columns for Bayer.

    Pixel ``(r, c)`` is pixel ``(r0 + step r, c0 + step c)`` of the mosaic; ``channel_phase`` (r0, c0) and
    ``pixel_step`` are in the metadata, drifts are in pixels of the channel.
    """

    def __init__(self, source: FrameSource, channel: str) -> None:
        super().__init__(source)
        cfa = self.known.cfa
        self.channel = channel
        self._origin = channel_phase(cfa, channel)
        self._step = pattern_side(cfa)
        self._position = channel_names(cfa).index(channel)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the channel."""
        (r0, c0), (rows, columns) = self._origin, self.source.shape
        # ceiling division: a mosaic that ends within a pattern still has pixels of some channels
        return -(-(rows - r0) // self._step), -(-(columns - c0) // self._step)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return what is known of the mosaic, with what is the channel's own."""
        black, gains, place = known.black_level, known.gains, known.origin
        return replace(
            known,
            cfa="",
            # one value per place of the pattern: the channel's own is taken
            black_level=black[self._position] if isinstance(black, tuple) else black,
            gains=gains[self._position] if isinstance(gains, tuple) else gains,
            origin=None if place is None else (place[0] // self._step, place[1] // self._step),
            channel=self.channel,
            channel_phase=self._origin,
            pixel_step=self._step,
        )

    def info(self, index: int) -> FrameInfo:
        """Return what is known of frame ``index``; its drift is in pixels of the channel."""
        info = self.source.info(index)
        place = self.known.origin or (0, 0)
        whole = info.origin == place
        if not whole or any(n % self._step for n in place):
            # rows and columns of a channel would differ in number from cutout to cutout
            raise InputError.expected(
                f"channel {self.channel} of {info.label}",
                "a part from the first pixel of a colour pattern" if whole else "whole sensor frames",
                f"one from {place}" if whole else "cutouts",
                "record whole frames for it",
            )
        drift = None if info.drift is None else (info.drift[0] / self._step, info.drift[1] / self._step)
        (r0, c0), step = self._origin, self._step
        mask = None if info.mask is None else info.mask[r0::step, c0::step]
        place = (place[0] // self._step, place[1] // self._step)
        return replace(info, origin=place, drift=drift, label=f"{info.label} {self.channel}", mask=mask)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return the channel of frame ``index``, or a part of it."""
        rows, columns = (
            # from the first to the last pixel of the channel: nothing of the mosaic beyond is read
            slice(start + self._step * part.start, start + self._step * (part.stop - 1) + 1)
            for start, part in zip(self._origin, check_region(region or whole(self.shape), self.shape), strict=True)
        )
        return np.ascontiguousarray(self.source.read(index, (rows, columns))[:: self._step, :: self._step])

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the channel's samples."""
        return Frames.samples(self, index, region)


class BalancedSource(SourceView):
    """A mosaic as float32 with each pattern position multiplied by its gain; use it on dark-corrected frames."""

    def __init__(self, source: FrameSource, gains: Sequence[float] | None = None) -> None:
        super().__init__(source)
        cfa = self.known.cfa
        names = channel_names(cfa)
        given = self.known.gains if gains is None else gains
        values = () if given is None or isinstance(given, float | int) else tuple(float(g) for g in given)
        if not names or len(values) != len(names) or not all(np.isfinite(values)) or min(values) <= 0:
            raise InputError.expected(
                "gains of the colours",
                f"positive numbers for {', '.join(names) or 'a colour mosaic'}",
                given,
                "measure them on a white frame and give them",
            )
        self.gains = values
        self._side = pattern_side(cfa)
        self._phases = phases(cfa)

    @property
    def dtype(self) -> np.dtype[Any]:
        """float32."""
        return np.dtype(np.float32)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return what is known of the mosaic, with the gains used; saturation differs by colour from here on."""
        return replace(known, saturation=None, bit_depth=None, gains=None, balanced_by=self.gains)

    def read(self, index: int, region: Region | None = None) -> NDArray[np.float32]:
        """Return frame ``index``, or a part of it, with its colours balanced."""
        rows, columns = check_region(region or whole(self.shape), self.shape)
        part = self.source.read(index, (rows, columns)).astype(np.float32)
        # a part of the sensor has its pattern from its own first pixel, cutouts have that of the sensor
        place = (0, 0) if self.known.origin is not None else self.source.info(index).origin
        top, left = (a.start + b for a, b in zip((rows, columns), place, strict=True))
        for k, gain in enumerate(self.gains):
            r0, c0 = divmod(k, self._side)
            part[(r0 - top) % self._side :: self._side, (c0 - left) % self._side :: self._side] *= np.float32(gain)
        return part

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the balanced samples; which of them are saturated is the mosaic's to say."""
        return self.source.samples(index, region)._replace(values=self.read(index, region), noise=None)


def channel_source(source: FrameSource, channel: str) -> ChannelSource:
    """Return one colour of a mosaic, e.g. ``"R"``, ``"G1"``, ``"G2"``, ``"B"``, as a frame source.

    Greens are numbered by rows of the pattern: in ``GRBG`` G1 is the first pixel.

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
    """Return the whole mosaic with its colours multiplied by ``gains``, one per pattern position by rows.

    Without ``gains`` those of the camera's white balance are taken.

    Raises
    ------
    InputError
        If the frames are monochrome, or the gains are not known or not positive.

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
