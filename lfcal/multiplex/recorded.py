"""Read frames with the metadata of their files: samples, colour filters, and black level."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import note
from lfcal.camera import Sensor
from lfcal.frames import open_image
from lfcal.multiplex._sensor_noise import pixel_weights
from lfcal.multiplex.colour_planes import lost_pixels

__all__ = ["RecordedFrame", "read_recorded"]


class RecordedFrame(NamedTuple):
    """Recorded frame, with the colour filters (else empty) and the black level (else None) that its file states."""

    path: Path
    raw: NDArray[Any]
    filters: str
    black_level: Any

    def level(self, given: float | None = None, sensor: Sensor | None = None) -> Any:
        """Return the black level (counts): ``given``, else that of the file, else that of the sensor, else 0."""
        if given is not None:
            return given
        if self.black_level is not None:
            return self.black_level
        return 0.0 if sensor is None else sensor.black_level

    def weights(self, level: Any, sensor: Sensor | None, mask: Path | None, **how: Any) -> NDArray[Any] | None:
        """Return the weight ``(rows, columns)`` of each pixel; None without sensor, mask and non-finite pixels.

        Pixels that are not finite, and those that the file ``mask`` marks, have the weight 0. With ``sensor``,
        saturated pixels also have the weight 0, and the weights of the others are inverse variances. Without
        ``sensor``, the weights of the others are 1. ``level`` is the black level (counts). ``how`` contains further
        options of `lfcal.multiplex.pixel_weights`.
        """
        lost = lost_pixels(self.raw, self.path, mask)
        missing = int(np.count_nonzero(~np.isfinite(self.raw)))
        if missing:
            note(f"{self.path.name}: excluded pixels (without a finite value): {missing}")
        if sensor is None:
            return np.where(lost, 0.0, 1.0) if missing or mask is not None else None
        return pixel_weights(self.filled, sensor, dead=lost, black_level=level, **how)

    @property
    def filled(self) -> NDArray[Any]:
        """The frame, with 0 at pixels that are not finite."""
        return self.raw if self.raw.dtype.kind != "f" else np.where(np.isfinite(self.raw), self.raw, 0)


def read_recorded(path: str | os.PathLike[str], page: int = 0) -> RecordedFrame:
    """Return one page of an image file with its colour filters and black level; the first page is 0."""
    image = open_image(path)
    try:
        frame: NDArray[Any] = image.read(image.check_page(page))
        return RecordedFrame(Path(path), frame, str(image.metadata.get("cfa", "")), image.metadata.get("black_level"))
    finally:
        image.close()
