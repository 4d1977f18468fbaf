"""Frames of a colour mosaic as full frames of one colour: what the calibration core takes from a colour camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.checks import check_choice
from lfcal.frames.regions import Region, check_region, part_of, whole
from lfcal.frames.source import FrameInfo, Frames, FrameSource, Samples
from lfcal.frames.view import SourceView
from lfcal.multiplex.colour_filters import cfa
from lfcal.multiplex.demultiplexing import demultiplex
from lfcal.multiplex.filters import SPATIAL_FILTERS

__all__ = ["ColourSource", "colour_source"]

REACH = 4
"""Super-pixels about a region that a filter may look at."""


class ColourSource(SourceView):
    """One colour of a mosaic at every pixel, float32, by the spatial route; pixels and drifts are the mosaic's.

    `lfcal.frames.channel_source` gives the recorded samples alone, at half the pitch of a Bayer sensor.
    """

    def __init__(self, source: FrameSource, colour: str, filter: str = "cubic") -> None:
        super().__init__(source)
        check_choice("filter", filter, tuple(f for f in SPATIAL_FILTERS if f != "sinc"))
        self.modulator = cfa(str(source.metadata.get("cfa", "")))
        check_choice("colour", colour, self.modulator.colours)
        self.colour, self.filter = colour, filter

    @property
    def dtype(self) -> np.dtype[Any]:
        """float32."""
        return np.dtype(np.float32)

    @property
    def metadata(self) -> Mapping[str, Any]:
        """The mosaic's metadata without what holds for its single samples."""
        dropped = ("cfa", "saturation", "bit_depth", "gains", "black_level")
        return {k: v for k, v in self.source.metadata.items() if k not in dropped} | {"colour": self.colour}

    def info(self, index: int) -> FrameInfo:
        """Return what is known of frame ``index``, named with the colour."""
        info = self.source.info(index)
        return replace(info, label=f"{info.label} {self.colour}")

    def read(self, index: int, region: Region | None = None) -> NDArray[np.float32]:
        """Return the colour's frame ``index``, or a part of it."""
        inside = check_region(region or whole(self.shape), self.shape)
        rows, columns = (
            slice(max(0, p.start // s - REACH) * s, min(n, p.stop + REACH * s))
            for p, s, n in zip(inside, self.modulator.side, self.shape, strict=True)
        )
        mosaic = self.source.read(index, (rows, columns))
        exact = mosaic.astype(np.float32) if mosaic.dtype == np.float64 else mosaic
        light = demultiplex(exact, self.modulator, filter=self.filter, workers=1)
        part = part_of(inside, (rows, columns))
        return np.ascontiguousarray(light[self.modulator.colours.index(self.colour)][part])

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the colour's samples; every one is made of several of the mosaic's."""
        return Frames.samples(self, index, region)


def colour_source(source: FrameSource, colour: str, *, filter: str = "cubic") -> ColourSource:
    """Return ``"R"``, ``"G"`` or ``"B"`` of a mosaic at every pixel as a frame source.

    Parameters
    ----------
    source
        Frames with their pattern in ``metadata["cfa"]``, background subtracted.
    colour
        Red, green or blue, also where the filters are cyan, yellow and magenta.
    filter
        As in `demultiplex`, not the sinc, for which a frame has no regions.

    Raises
    ------
    InputError
        If the frames are monochrome or the colour is not known.
    """
    return ColourSource(source, colour, filter)
