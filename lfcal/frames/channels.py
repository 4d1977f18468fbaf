"""Colour mosaics channel by channel, or all channels with their gains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.frames.cfa import channel_names, channel_phase, pattern_side, phases
from lfcal.frames.delegate import SourceView
from lfcal.frames.regions import check_region, read_region, whole
from lfcal.frames.source import FrameSource

__all__ = ["BalancedSource", "ChannelSource", "balanced_source", "channel_source"]


class ChannelSource(SourceView):
    """One position of the colour filter pattern as frames of their own: half the rows and columns for Bayer.

    Pixel ``(r, c)`` is pixel ``(r0 + step r, c0 + step c)`` of the mosaic; ``origin_px`` (r0, c0) and
    ``pixel_step`` are in the metadata, drifts are in pixels of the channel.
    """

    def __init__(self, source: FrameSource, channel: str) -> None:
        super().__init__(source)
        cfa = str(source.metadata.get("cfa", ""))
        self.channel = channel
        self._origin = channel_phase(cfa, channel)
        self._step = pattern_side(cfa)
        self._position = channel_names(cfa).index(channel)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the channel."""
        (r0, c0), (rows, columns) = self._origin, self.source.shape
        return -(-(rows - r0) // self._step), -(-(columns - c0) // self._step)

    @property
    def metadata(self) -> Mapping[str, Any]:
        """The mosaic's metadata with what is the channel's own."""
        known = {key: value for key, value in self.source.metadata.items() if key != "cfa"}
        for key in ("black_level", "gains"):
            if isinstance(known.get(key), tuple):
                known[key] = known[key][self._position]
        return known | {"channel": self.channel, "origin_px": self._origin, "pixel_step": self._step}

    def drift(self, index: int) -> tuple[float, float]:
        """Return the drift ``(dy, dx)`` of frame ``index`` in pixels of the channel."""
        dy, dx = super().drift(index)
        return dy / self._step, dx / self._step

    def label(self, index: int) -> str:
        """Return the name of the frame with that of the channel."""
        return f"{self.source.label(index)} {self.channel}"

    def read(self, index: int) -> NDArray[Any]:
        """Return the channel of frame ``index``."""
        return self.read_region(index, *whole(self.shape))

    def read_region(self, index: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of the channel of frame ``index``."""
        spans = [
            slice(start + self._step * part.start, start + self._step * (part.stop - 1) + 1)
            for start, part in zip(self._origin, check_region((rows, columns), self.shape), strict=True)
        ]
        return np.ascontiguousarray(read_region(self.source, index, *spans)[:: self._step, :: self._step])


class BalancedSource(SourceView):
    """A mosaic as float32 with each pattern position multiplied by its gain; use it on dark-corrected frames."""

    def __init__(self, source: FrameSource, gains: Sequence[float] | None = None) -> None:
        super().__init__(source)
        cfa = str(source.metadata.get("cfa", ""))
        names = channel_names(cfa)
        given = source.metadata.get("gains") if gains is None else gains
        values = () if given is None else tuple(float(g) for g in given)
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

    @property
    def metadata(self) -> Mapping[str, Any]:
        """The mosaic's metadata with the gains used; saturation differs by colour from here on."""
        dropped = ("saturation", "bit_depth", "gains")
        known = {key: value for key, value in self.source.metadata.items() if key not in dropped}
        return known | {"balanced_by": self.gains}

    def read(self, index: int) -> NDArray[np.float32]:
        """Return frame ``index`` with its colours balanced."""
        return self.read_region(index, *whole(self.shape))

    def read_region(self, index: int, rows: slice, columns: slice) -> NDArray[np.float32]:
        """Return the part ``[rows, columns]`` of frame ``index``."""
        rows, columns = check_region((rows, columns), self.shape)
        part = read_region(self.source, index, rows, columns).astype(np.float32)
        for k, gain in enumerate(self.gains):
            r0, c0 = divmod(k, self._side)
            part[(r0 - rows.start) % self._side :: self._side, (c0 - columns.start) % self._side :: self._side] *= (
                np.float32(gain)
            )
        return part


def channel_source(source: FrameSource, channel: str) -> ChannelSource:
    """Return one colour of a mosaic, e.g. ``"R"``, ``"G1"``, ``"G2"``, ``"B"``, as a frame source.

    Greens are numbered by rows of the pattern: in ``GRBG`` G1 is the first pixel.

    Raises
    ------
    InputError
        If the frames are monochrome or have no such channel.
    """
    return ChannelSource(source, channel)


def balanced_source(source: FrameSource, gains: Sequence[float] | None = None) -> BalancedSource:
    """Return the whole mosaic with its colours multiplied by ``gains``, one per pattern position by rows.

    Without ``gains`` those of the camera's white balance are taken.

    Raises
    ------
    InputError
        If the frames are monochrome, or the gains are not known or not positive.
    """
    return BalancedSource(source, gains)
