"""Frames of one array: in memory, a memory map, or an HDF5 dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import InputError, Region, check_region, whole
from lfcal.frames.source import FrameInfo, FrameMetadata, Frames, Position, check_index, check_mask

__all__ = ["ArraySource"]


class ArraySource(Frames):
    """A frame source whose frames are in an array ``(frame, row, column)`` or ``(z, y, x, row, column)``.

    Parameters
    ----------
    frames
        Array, memory map or HDF5 dataset of numbers.
    positions
        `Position` (z, y, x) of each frame; not needed for a 5-D array, whose first three axes define the positions.
    exposures_s
        Exposure time of each frame (s). None: unknown.
    drifts
        Displacement (rows, columns) of the image from its planned position in each frame (px). None: unknown.
    origins
        Position (row, column) on the sensor of each frame's first pixel (px). None: every frame shows the whole sensor.
    mask
        Mask ``(rows, columns)``, True at pixels that are valid in every frame. None: all pixels.
    metadata
        Metadata common to all frames: `FrameMetadata`, or a mapping of its fields. In a mapping, ``exposure_s`` may
        state the common exposure of all frames if ``exposures_s`` is None.
    name
        Name for messages.

    Raises
    ------
    InputError
        If the array is empty or has the wrong number of axes or dtype, or positions are missing for a 3-D array. Also
        if the arguments differ in length, or ``mask`` has no valid pixel or another shape than the frames.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.frames import ArraySource
    >>> scan = np.zeros((1, 2, 3, 40, 60), np.uint16)
    >>> source = ArraySource(scan, metadata={"bit_depth": 12, "exposure_s": 0.02})
    >>> print(len(source), source.shape, source.info(5).position, source.info(5).exposure_s)
    6 (40, 60) Position(z=0, y=1, x=2) 0.02
    """

    def __init__(
        self,
        frames: Any,
        positions: Sequence[tuple[int, int, int]] | None = None,
        *,
        exposures_s: Sequence[float] | None = None,
        drifts: Sequence[tuple[float, float]] | None = None,
        origins: Sequence[tuple[int, int]] | None = None,
        mask: ArrayLike | None = None,
        metadata: FrameMetadata | Mapping[str, Any] | None = None,
        name: str = "frames",
    ) -> None:
        if len(frames.shape) not in (3, 5) or 0 in frames.shape or frames.dtype.kind not in "iuf":
            raise InputError.expected(
                name,
                "numbers with axes (frame, row, column) or (z, y, x, row, column)",
                f"{frames.dtype} of shape {tuple(frames.shape)}",
                "reshape the array",
            )
        self._frames = frames
        self._lead = tuple(int(n) for n in frames.shape[:-2])
        count = int(np.prod(self._lead))
        if positions is None:
            if len(self._lead) != 3:
                raise InputError.expected(
                    f"positions of {name}", f"{count} positions", "none", "give positions or a scan order"
                )
            positions = [Position(*(int(n) for n in np.unravel_index(k, self._lead))) for k in range(count)]
        for what, values in (
            ("positions", positions),
            ("exposures", exposures_s),
            ("drifts", drifts),
            ("origins", origins),
        ):
            if values is not None and len(values) != count:
                raise InputError.expected(
                    f"{what} of {name}", f"{count}, one per frame", len(values), "check the frame count"
                )
        self._positions = [Position(*(int(n) for n in p)) for p in positions]
        self._exposures = None if exposures_s is None else [float(t) for t in exposures_s]
        self._drifts = None if drifts is None else [(float(dy), float(dx)) for dy, dx in drifts]
        self._origins = None if origins is None else [(int(r), int(c)) for r, c in origins]
        self._mask = None if mask is None else check_mask(mask, self.shape, name)
        common = None
        if isinstance(metadata, Mapping) and "exposure_s" in metadata:
            common = metadata["exposure_s"]
            metadata = {key: value for key, value in metadata.items() if key != "exposure_s"}
        self._metadata = FrameMetadata() if metadata is None else FrameMetadata.of(metadata)
        if self._exposures is None and common is not None:
            self._exposures = [float(common)] * count
        self._name = name

    @property
    def shape(self) -> tuple[int, int]:
        """Shape ``(rows, columns)`` of every frame (px)."""
        return int(self._frames.shape[-2]), int(self._frames.shape[-1])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type, in native byte order."""
        dtype: np.dtype[Any] = np.dtype(self._frames.dtype)
        return dtype.newbyteorder("=")

    @property
    def metadata(self) -> FrameMetadata:
        """Metadata common to all frames."""
        return self._metadata

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._positions)

    def info(self, index: int) -> FrameInfo:
        """Return the metadata of frame ``index`` without reading its samples."""
        k = check_index(index, len(self))
        return FrameInfo(
            (self._positions[k],),
            (0, 0) if self._origins is None else self._origins[k],
            None if self._exposures is None else self._exposures[k],
            None if self._drifts is None else self._drifts[k],
            label=f"{self._name}[{k}]",
            mask=self._mask,
        )

    def read(self, index: int, region: Region | None = None) -> NDArray[Any]:
        """Return a copy of frame ``index``, or of the part of it in ``region``."""
        at = np.unravel_index(check_index(index, len(self)), self._lead)
        rows, columns = check_region(region or whole(self.shape), self.shape)
        part = self._frames[(*(int(k) for k in at), rows, columns)]
        return np.array(part, dtype=self.dtype, order="C")
