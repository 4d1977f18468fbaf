"""Read frames with the metadata of their files: samples, colour filters, and black level."""

from __future__ import annotations

import os
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.camera import Sensor
from lfcal.frames import open_image, read_image
from lfcal.multiplex._sensor_noise import pixel_weights

__all__ = ["RecordedFrame", "read_recorded"]


class RecordedFrame(NamedTuple):
    """Recorded frame, with its colour filters and black level if the file states them."""

    raw: NDArray[Any]
    filters: str
    black_level: Any

    def level(self, given: float | None = None, sensor: Sensor | None = None) -> Any:
        """Return ``given``, or the black level stated in the file, or that of the sensor, or 0 if none is known."""
        if given is not None:
            return given
        if self.black_level is not None:
            return self.black_level
        return 0.0 if sensor is None else sensor.black_level

    def weights(
        self, level: Any, sensor: Sensor | None, dead: str | os.PathLike[str] | None, **how: Any
    ) -> NDArray[Any] | None:
        """Return the weight ``(rows, columns)`` of each pixel; None if neither ``sensor`` nor ``dead`` is given.

        ``level`` is the black level (counts), and ``dead`` an image that is not 0 at dead pixels. ``how`` contains
        further options of `lfcal.multiplex.pixel_weights`.
        """
        bad = None if dead is None else read_image(dead)
        if bad is not None and bad.shape != self.raw.shape:
            wanted = f"{self.raw.shape} px"
            raise InputError.expected(
                "dead pixels", wanted, f"shape {bad.shape}", "use the dead pixels of the camera that recorded the frame"
            )
        if sensor is None:
            return None if bad is None else np.where(bad == 0, 1.0, 0.0)
        return pixel_weights(self.raw, sensor, dead=bad, black_level=level, **how)


def read_recorded(path: str | os.PathLike[str], page: int = 0) -> RecordedFrame:
    """Return one page of an image file with its metadata; pages are counted from 0."""
    image = open_image(path)
    try:
        frame: NDArray[Any] = image.read(image.check_page(page))
        return RecordedFrame(frame, str(image.metadata.get("cfa", "")), image.metadata.get("black_level"))
    finally:
        image.close()
