"""Frames flipped or turned upright."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.frames.orientation import AS_IS, Orientation
from lfcal.frames.regions import Region, check_region
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, FrameSource, Samples
from lfcal.frames.view import SourceView

__all__ = ["OrientedSource", "oriented"]


class OrientedSource(SourceView):
    """The frames of ``source`` as ``turn`` puts them; a region costs no more than the region.

    The last view of all: frames, darks and whites come from one camera in one orientation and are combined in it,
    and only the clean result is turned. Where frames are cutouts, their places are turned about the ``sensor``.

    Parameters
    ----------
    source
        Corrected frames as delivered.
    turn
        What makes them upright.
    sensor
        Rows and columns of the sensor as delivered; None: of the frames, which are then whole.
    """

    def __init__(self, source: FrameSource, turn: Orientation, sensor: tuple[int, int] | None = None) -> None:
        super().__init__(source)
        self.turn = turn
        self.sensor = sensor or source.shape

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of every frame, turned."""
        return self.turn.shape(self.source.shape)

    def derived(self, known: FrameMetadata) -> FrameMetadata:
        """Return what is known of the source's frames without what belongs to single delivered pixels."""
        origin = self.info(0).origin if known.origin is not None and len(self.source) else known.origin
        return replace(known, cfa="", channel_phase=None, darks={}, origin=origin, orientation=self.turn.name)

    def info(self, index: int) -> FrameInfo:
        """Return what is known of frame ``index``: origin and mask turned; a drift is of the plan's upright image."""
        info = self.source.info(index)
        # the pixel that becomes the first one is at the corner nearest to that of the turned sensor
        first = np.array(info.origin)
        last = first + self.source.shape - 1
        if (last >= self.sensor).any():
            raise InputError.expected(
                f"{info.label}, frame to turn",
                f"one on the sensor of {self.sensor}",
                f"{first} … {last}",
                "name its sensor",
            )
        row, column = self.turn.places([first, last], self.sensor).min(axis=0).astype(int).tolist()
        mask = None if info.mask is None else self.turn.apply(info.mask)
        return replace(info, origin=(row, column), mask=mask)

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return frame ``index``, or the rows and columns ``region`` of the turned frame."""
        return self._turned(self.source.read(index, self._behind(region)))

    def samples(self, index: int, region: Region | None = None) -> Samples:
        """Return the source's samples, turned with what is known of each."""
        found = self.source.samples(index, self._behind(region))
        return found._replace(
            values=self._turned(found.values),
            valid=None if found.valid is None else self._turned(found.valid),
            noise=None if found.noise is None else found.noise.moved(self._turned),
        )

    def repeats(self) -> FrameSource | None:
        """Return the source's repeated frames, turned."""
        found = self.source.repeats() if isinstance(self.source, Frames) else None
        return None if found is None else OrientedSource(found, self.turn, self.sensor)

    def _turned(self, array: NDArray[Any]) -> NDArray[Any]:
        return np.ascontiguousarray(self.turn.apply(array))

    def _behind(self, region: Region | None) -> Region | None:
        if region is None:
            return None
        return self.turn.region(check_region(region, self.shape), self.source.shape)


def oriented(source: FrameSource, turn: Orientation, sensor: tuple[int, int]) -> FrameSource:
    """Return the frames of ``source`` turned upright; themselves where nothing is to be turned.

    Parameters
    ----------
    source
        Corrected frames as delivered.
    turn
        What makes them upright.
    sensor
        Rows and columns of the upright sensor, about which cutouts are turned.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource, OrientedSource, named_orientation, oriented
    >>> source = ArraySource(np.array([[[1, 2, 3], [4, 5, 6]]]), [(0, 0, 0)])
    >>> upright: OrientedSource = oriented(source, named_orientation("mirror-x"), sensor=(2, 3))
    >>> upright.read(0).tolist()
    [[3, 2, 1], [6, 5, 4]]
    """
    if turn.name == AS_IS:
        return source
    whole = all(source.info(k).origin == (0, 0) for k in range(len(source)))
    return OrientedSource(source, turn, None if whole else turn.inverse.shape(sensor))
