"""Frames of one array: in memory, a memory map, or an HDF5 dataset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.frames.regions import check_region
from lfcal.frames.source import FrameSource, Position

__all__ = ["ArraySource", "frame_drift", "frame_exposure"]


def frame_exposure(source: FrameSource, index: int) -> float | None:
    """Return the exposure of frame ``index`` (s), or None where it is not known.

    A source gives one exposure per frame with a method ``exposure_s(index)``, or one for all in its metadata.
    """
    method = getattr(source, "exposure_s", None)
    value = method(index) if callable(method) else None
    value = source.metadata.get("exposure_s") if value is None else value
    return None if value is None else float(value)


def frame_drift(source: FrameSource, index: int) -> tuple[float, float]:
    """Return how far the paraxial image in frame ``index`` lies from where the plan puts it, ``(dy, dx)`` in px."""
    method = getattr(source, "drift", None)
    if not callable(method):
        return 0.0, 0.0
    dy, dx = method(index)
    return float(dy), float(dx)


def check_index(index: int, count: int) -> int:
    """Return ``index`` or raise `InputError` unless it is one of ``count`` frames."""
    if not 0 <= index < count:
        raise InputError.expected("frame index", f"0 … {count - 1}", index, "ask for a frame that is there")
    return int(index)


class ArraySource:
    """Frames of an array ``(frame, row, column)`` or ``(z, y, x, row, column)``.

    Parameters
    ----------
    frames
        Array, memory map or HDF5 dataset of numbers.
    positions
        One `Position` (or ``(z, y, x)``) per frame; for a 5-D array they follow from its axes.
    exposures_s
        Exposure of each frame (s), or None.
    drifts
        Drift ``(dy, dx)`` of each frame (px), or None.
    metadata
        What is known of the frames.
    name
        Name for messages.

    Raises
    ------
    InputError
        If axes, dtype or counts do not fit.
    """

    def __init__(
        self,
        frames: Any,
        positions: Sequence[tuple[int, int, int]] | None = None,
        *,
        exposures_s: Sequence[float] | None = None,
        drifts: Sequence[tuple[float, float]] | None = None,
        metadata: Mapping[str, Any] | None = None,
        name: str = "frames",
    ) -> None:
        if len(frames.shape) not in (3, 5) or 0 in frames.shape or frames.dtype.kind not in "iuf":
            raise InputError.expected(
                name,
                "numbers with axes (frame, row, column) or (z, y, x, row, column)",
                f"{frames.dtype} {tuple(frames.shape)}",
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
        for what, values in (("positions", positions), ("exposures", exposures_s), ("drifts", drifts)):
            if values is not None and len(values) != count:
                raise InputError.expected(
                    f"{what} of {name}", f"{count}, one per frame", len(values), "check the frame count"
                )
        self._positions = [Position(*(int(n) for n in p)) for p in positions]
        self._exposures = None if exposures_s is None else [float(t) for t in exposures_s]
        self._drifts = None if drifts is None else [(float(dy), float(dx)) for dy, dx in drifts]
        self._metadata = dict(metadata or {})
        self._name = name

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of every frame."""
        return int(self._frames.shape[-2]), int(self._frames.shape[-1])

    @property
    def dtype(self) -> np.dtype[Any]:
        """Sample type, in native byte order."""
        dtype: np.dtype[Any] = np.dtype(self._frames.dtype)
        return dtype.newbyteorder("=")

    @property
    def metadata(self) -> Mapping[str, Any]:
        """What is known of the frames."""
        return self._metadata

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._positions)

    def position(self, index: int) -> Position:
        """Return the scan position of frame ``index``."""
        return self._positions[check_index(index, len(self))]

    def exposure_s(self, index: int) -> float | None:
        """Return the exposure of frame ``index`` (s), or None."""
        return None if self._exposures is None else self._exposures[check_index(index, len(self))]

    def drift(self, index: int) -> tuple[float, float]:
        """Return the drift ``(dy, dx)`` of frame ``index`` (px)."""
        return (0.0, 0.0) if self._drifts is None else self._drifts[check_index(index, len(self))]

    def label(self, index: int) -> str:
        """Return ``name[index]``."""
        return f"{self._name}[{index}]"

    def read(self, index: int) -> NDArray[Any]:
        """Return frame ``index`` as a new array."""
        return self._part(index, slice(0, self.shape[0]), slice(0, self.shape[1]))

    def read_region(self, index: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of frame ``index`` as a new array."""
        return self._part(index, *check_region((rows, columns), self.shape))

    def _part(self, index: int, rows: slice, columns: slice) -> NDArray[Any]:
        at = np.unravel_index(check_index(index, len(self)), self._lead)
        part = self._frames[(*(int(k) for k in at), rows, columns)]
        return np.array(part, dtype=self.dtype, order="C")
