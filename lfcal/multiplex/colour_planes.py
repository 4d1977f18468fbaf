"""Read frames as colour planes: grey, RGB, or behind a mosaic of filters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import FileFormatError, InputError, check_choice, format_pixels, note

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = [
    "CHANNELS",
    "ColourReading",
    "Planes",
    "dark_level",
    "interpolated",
    "mean_plane",
    "read_planes",
    "read_white",
]

CHANNELS = ("", "R", "G", "B", "each")
"""Selectable colours. Empty: all colours of a mosaic, or the only plane of a grey frame; ``each``: R, G and B."""

COLOURS = ("R", "G", "B")

Planes = dict[str, "NDArray[np.float32]"]


@dataclass(frozen=True)
class ColourReading:
    """Settings for reading frames.

    ``channel`` is one of `CHANNELS`, and ``cfa`` is the pattern of colour filters (empty: that of the file). ``dark``
    is a dark frame, or a folder of them; None: no dark frame. ``origin`` is the sensor position (row, column) of the
    first pixel; None: the frames show the whole sensor. With ``repair``, pixels that are not finite or that the file
    ``mask`` marks are interpolated; otherwise, ``mask`` is not used.
    """

    channel: str
    cfa: str
    dark: Path | None
    origin: tuple[int, int] | None
    mask: Path | None = None
    repair: bool = False


def read_planes(path: Path, reading: ColourReading) -> Planes:
    """Return a mapping from each colour of a frame to its image ``(rows, columns)`` minus the dark frame.

    A grey frame has the colour "". Frame and dark frame are files, or folders whose frames are averaged. A mosaic is
    demosaiced. Without a dark frame, only the black level stated in the file of a mosaic is subtracted.

    Raises
    ------
    FileFormatError
        If the file contains several colours and no colour is selected.
    InputError
        If a colour is selected but the frame is grey, or if the dark frame has another shape.
    """
    from lfcal.frames import open_image
    from lfcal.frames.corrections import first_image

    wanted = COLOURS if reading.channel == "each" else (reading.channel,) if reading.channel else ()
    try:
        image = open_image(first_image(path))
    except FileFormatError as error:
        if 'colour="G"' not in str(error):
            raise
        if not wanted:
            # replace the name of the library's option by that of the command
            raise FileFormatError(str(error).replace(' (colour="G")', ", or all: --channel each")) from None
        return {name: _plane(path, reading, name) for name in wanted}
    cfa = reading.cfa or str(image.metadata.get("cfa", ""))
    level = image.metadata.get("black_level", 0)
    image.close()
    if cfa:
        return _mosaic(path, cfa, level, reading, wanted or COLOURS)
    if wanted:
        raise InputError.expected(
            f"colour of {path}",
            "a colour frame or mosaic",
            "a grey frame",
            "leave the channel out (--channel), or state the colour filter (--cfa, such as GRBG)",
        )
    return {"": _plane(path, reading, None)}


def _plane(path: Path, reading: ColourReading, colour: str | None) -> NDArray[np.float32]:
    from lfcal.frames.corrections import read_average

    image, dark = read_average(path, colour=colour), reading.dark
    return _repaired(image if dark is None else image - dark_level(dark, image.shape, colour), path, reading)


def _repaired(image: NDArray[np.float32], path: Path, reading: ColourReading, cfa: str = "") -> NDArray[np.float32]:
    return interpolated(image, path, reading.mask, reading.origin or (0, 0), cfa) if reading.repair else image


def lost_pixels(
    image: NDArray[Any], path: Path, mask: Path | None, origin: tuple[int, int] = (0, 0)
) -> NDArray[np.bool_]:
    """Return a mask ``(rows, columns)`` of the pixels of ``image`` that are not finite, or marked in the file ``mask``.

    ``path`` is the file of the image, for messages. ``origin`` is the sensor position (row, column) of the first pixel.

    Raises
    ------
    InputError
        If no other pixels remain, or the shape of the mask does not match.
    """
    import numpy as np

    from lfcal.frames.corrections import frame_map

    lost: NDArray[np.bool_] = ~np.isfinite(image)
    if mask is not None:
        lost |= frame_map(mask, "mask", (image.shape[0], image.shape[1]), origin)
    if lost.all():
        raise InputError.expected(path.name, "pixels with a value", "none", "check the frame and the mask (--mask)")
    return lost


def interpolated(
    image: NDArray[np.float32], path: Path, mask: Path | None, origin: tuple[int, int] = (0, 0), cfa: str = ""
) -> NDArray[np.float32]:
    """Return ``image`` with the pixels that `lost_pixels` finds interpolated from their neighbours.

    In a mosaic with the pattern ``cfa`` (empty: no mosaic), the neighbours behind the same filter are used. Pixels
    without a good neighbour are set to the median of the other pixels. ``path``, ``mask`` and ``origin`` are as in
    `lost_pixels`.
    """
    import numpy as np

    from lfcal.frames.corrections import repair_nan

    lost = lost_pixels(image, path, mask, origin)
    if lost.any():
        note(f"{path.name}: interpolated pixels (masked, or without a finite value): {int(lost.sum())}")
        image = np.where(lost, np.float32(np.nan), image)
        repair_nan(image, (0, 0), np.zeros(3), _square(cfa))
        # the middle of a large hole has no neighbours
        image[np.isnan(image)] = np.nanmedian(image)
    return image


def _square(cfa: str) -> str:
    """Return the letters of a square that repeats the pattern, in row-major order; empty for no pattern."""
    from lfcal.multiplex.colour_filters import parse_pattern

    if not cfa:
        return ""
    rows = parse_pattern(cfa)
    side = math.lcm(len(rows), len(rows[0]))
    return "".join(row * (side // len(row)) for row in rows * (side // len(rows)))


def dark_level(dark: Path, shape: tuple[int, ...], colour: str | None = None) -> NDArray[Any]:
    """Return the dark frame in a file, or the mean of those in a folder, ``(rows, columns)``.

    ``colour`` is the component to read from colour images; None: the images are grey.

    Raises
    ------
    InputError
        If the shape of the dark frame is not ``shape``.
    """
    from lfcal.frames.corrections import read_average

    level = read_average(dark, colour=colour)
    if level.shape != shape:
        raise InputError.expected(
            str(dark),
            format_pixels(shape),
            format_pixels(level.shape),
            "record dark frames with the sensor settings of the other frames",
        )
    return level


def _mosaic(path: Path, cfa: str, black: Any, reading: ColourReading, names: tuple[str, ...]) -> Planes:
    import numpy as np

    from lfcal.frames.corrections import read_average
    from lfcal.multiplex._sensor_noise import without_black_level
    from lfcal.multiplex.colour_filters import cfa as modulator_of
    from lfcal.multiplex.demultiplexing import demultiplex

    frame, dark = read_average(path), reading.dark
    light = (
        without_black_level(frame, black) if dark is None else frame - dark_level(dark, frame.shape).astype(np.float32)
    )
    light = _repaired(light, path, reading, cfa)
    # to measure a response, the filter must neither depend on the scene nor mix the colours
    colours = demultiplex(light, modulator_of(cfa), filter="cubic")
    return {name: np.ascontiguousarray(colours[COLOURS.index(name)], np.float32) for name in names}


def mean_plane(planes: Planes) -> NDArray[np.float32]:
    """Return the mean of all colours, float32 ``(rows, columns)``."""
    mean: NDArray[np.float32] = sum(planes.values()) / len(planes)  # type: ignore[assignment]
    return mean


def read_white(
    path: Path,
    dark: Path | None,
    channel: str = "",
    cfa: str = "",
    *,
    mask: Path | None = None,
    origin: tuple[int, int] | None = None,
) -> NDArray[np.float32]:
    """Return a white image ``(rows, columns)`` minus its dark frame.

    It is a grey frame, the colour ``channel`` or, if ``channel`` is empty, the mean of the colours of a mosaic.
    ``path`` and ``dark`` are files, or folders whose frames are averaged. Without ``dark``, only the black level stated
    in the file of a mosaic is subtracted. ``cfa`` is the pattern of the colour filters (empty: that of the file).
    Pixels that are not finite, and those that the file ``mask`` marks, are interpolated. ``origin`` is the sensor
    position (row, column) of the first pixel; None: the image shows the whole sensor.

    Raises
    ------
    FileFormatError
        If the file contains several colour planes and ``channel`` is empty.
    """
    check_choice("channel", channel, ("", *COLOURS))
    try:
        return mean_plane(read_planes(path, ColourReading(channel, cfa, dark, origin, mask, repair=True)))
    except FileFormatError as error:
        # a lattice is measured in one image only
        raise FileFormatError(str(error).replace(", or all: --channel each", "")) from None
