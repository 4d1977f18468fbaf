"""Frames of ``lfcal multiplex``: read with the level of no light they state, weighed, written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from lfcal.base import InputError
from lfcal.base import write_tiff as write_pages

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.camera import Sensor
    from lfcal.multiplex import Modulator

__all__ = [
    "ROUTES",
    "RecordedFrame",
    "Weighing",
    "check_told",
    "fourier_file",
    "level_of",
    "read_frame",
    "without_dark_frame",
    "write_tiff",
]

ROUTES = ("spatial", "fourier", "both")


class RecordedFrame(NamedTuple):
    """A frame as recorded, its colour filters where the file names them, and its black level where it states one."""

    raw: NDArray[Any]
    filters: str
    black_level: Any


def read_frame(path: Path, page: int = 0) -> RecordedFrame:
    """Return one page of a file with what the file says of it."""
    from lfcal.frames import open_image

    image = open_image(path)
    try:
        frame: NDArray[Any] = image.read(image.check_page(page))
        return RecordedFrame(frame, str(image.metadata.get("cfa", "")), image.metadata.get("black_level"))
    finally:
        image.close()


def level_of(frame: RecordedFrame, given: float | None, sensor: Sensor | None = None) -> Any:
    """Return the level of no light: the one given, else the file's, else the sensor's, else 0."""
    if given is not None:
        return given
    if frame.black_level is not None:
        return frame.black_level
    return 0.0 if sensor is None else sensor.black_level


class Weighing(NamedTuple):
    """By what pixels are weighed: the sensor's noise and saturation, a map of dead ones, or both."""

    sensor: Sensor | None
    dead: Path | None
    gain: float
    exposure_s: float

    def weights(self, raw: NDArray[Any], level: Any) -> NDArray[Any] | None:
        """Return the weight of every pixel, None where all count alike."""
        import numpy as np

        from lfcal.frames import read_image
        from lfcal.multiplex import pixel_weights

        dead = None if self.dead is None else read_image(self.dead)
        if dead is not None and dead.shape != raw.shape:
            raise InputError.expected("dead pixels", f"{raw.shape} px", dead.shape, "use the frame's own camera's")
        if self.sensor is None:
            return None if dead is None else np.where(dead == 0, 1.0, 0.0)
        return pixel_weights(raw, self.sensor, dead=dead, gain=self.gain, exposure_s=self.exposure_s, black_level=level)


def fourier_file(out: Path) -> Path:
    """Return where the samples of the Fourier route go where both routes are asked for: ``views_fourier.tif``."""
    return out.with_name(f"{out.stem}_fourier{out.suffix}")


def without_dark_frame(frame: NDArray[Any], dark: Path) -> NDArray[Any]:
    """Return a frame less a dark frame, or less the mean of a folder of them."""
    import numpy as np

    from lfcal.frames.corrections import read_average

    level = read_average(dark)
    if level.shape != frame.shape:
        raise InputError.expected(f"{dark}", f"{frame.shape} px", f"{level.shape} px", "use one sensor setting")
    dimmed: NDArray[Any] = frame.astype(np.float32) - level
    return dimmed


def check_told(modulator: Modulator) -> None:
    """Raise where some sample is not told by the pixels at any place: it would be written as 0, or as a guess."""
    lost = [name for name, share in zip(modulator.sample_names, modulator.lost(), strict=True) if share > 1e-9]
    if lost:
        names = ", ".join(lost[:4]) + (f" and {len(lost) - 4} more" if len(lost) > 4 else "")
        raise InputError.expected(
            f"pixels of {modulator.name}",
            "some that tell every sample",
            f"none for {names}",
            "correct the pattern or matrix; `lfcal multiplex compare` says what is lost",
        )


def write_tiff(path: Path, planes: NDArray[Any]) -> None:
    """Write ``(n, rows, columns)`` as float32 TIFF, one page each, whole or not at all."""
    import numpy as np

    write_pages(path, planes.astype(np.float32), metadata=None)
