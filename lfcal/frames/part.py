"""Frames that show a part of the sensor: their position on it, from metadata or from the light in them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError, check_tuple

if TYPE_CHECKING:
    from lfcal.camera import Camera
    from lfcal.frames.source import FrameSource

__all__ = [
    "binned",
    "check_inside",
    "check_origin",
    "check_stated",
    "is_part_of_sensor",
    "parse_origin",
    "parse_roi",
    "part_refusal",
    "stated_origin",
]

Place = tuple[int, int]


def parse_origin(text: str) -> Place | None:
    """Return (row, column) from a text such as ``"120,64"``; None if empty. Raise `InputError` for other texts."""
    if not text.strip():
        return None
    fields = [field.strip() for field in text.split(",")]
    if len(fields) != 2 or not all(field.isascii() and field.isdigit() for field in fields):
        remedy = "give two whole numbers: 120,64"
        raise InputError.expected("origin of the frames", "ROW,COLUMN", repr(text), remedy)
    return int(fields[0]), int(fields[1])


def check_origin(origin: Sequence[int]) -> Place:
    """Return ``origin``, the row and the column of the frames' first pixel on the sensor, after checking it.

    Raises
    ------
    InputError
        If ``origin`` does not consist of two non-negative whole numbers.
    """
    row, column = check_tuple("origin of the frames (row, column)", origin, 2, at_least=0, integer=True)
    return int(row), int(column)


def parse_roi(value: Any) -> tuple[int, int, int, int] | None:
    """Return (column, row, width, height) from a text such as ``"8-5-80-78"`` or four numbers; otherwise None."""
    parts: Iterable[Any] = value if isinstance(value, list | tuple) else re.split(r"[-,; ]+", str(value).strip(" []()"))
    try:
        numbers = [int(part) for part in parts]
    except (TypeError, ValueError):
        return None
    if len(numbers) != 4 or min(numbers) < 0:
        return None
    column, row, width, height = numbers
    return column, row, width, height


def stated_origin(roi: tuple[int, int, int, int] | None, shape: Place) -> Place | None:
    """Return (row, column) of the first pixel of a camera's region ``roi`` (column, row, width, height; px).

    The result is None if ``roi`` is None, or the frames' ``shape`` (rows, columns) differs from that of the region.
    """
    if roi is None or (roi[3], roi[2]) != shape:
        return None
    return roi[1], roi[0]


def binned(sensor: Place, shape: Place) -> int:
    """Return the smallest binning factor, 2 to 8, that explains frames of ``shape`` from a sensor of shape ``sensor``.

    Both shapes are (rows, columns). The result is 0 if no factor does.
    """
    for times in range(2, 9):
        if all(side // times <= length <= -(-side // times) for side, length in zip(sensor, shape, strict=True)):
            return times
    return 0


def is_part_of_sensor(shape: Place, camera: Camera) -> bool:
    """Return whether frames of ``shape`` show a part of the camera's sensor.

    False if they may be binned frames of the whole sensor, or if the size of the sensor is only assumed.
    """
    sensor = camera.sensor.shape
    if shape == sensor or binned(sensor, shape) or camera.marks["sensor.shape"] == "assumed":
        return False
    return all(n <= m for n, m in zip(shape, sensor, strict=True))


def check_inside(origin: Place, shape: Place, sensor: Place) -> None:
    """Raise `InputError` unless frames of ``shape`` at ``origin`` fit on the sensor, upright or turned by 90 degrees.

    ``origin`` is the position of their first pixel. All arguments are (row, column) or (rows, columns) in px.
    """
    if any(all(o + n <= size for o, n, size in zip(origin, shape, one, strict=True)) for one in (sensor, sensor[::-1])):
        return
    raise InputError.expected(
        "origin of the frames (row, column)",
        f"a position at which all of the frame is on the sensor of {sensor[0]} x {sensor[1]} px",
        f"{origin[0]},{origin[1]} for frames of {shape[0]} x {shape[1]} px",
        "correct the origin (the row comes first), or the camera's sensor",
    )


def check_stated(source: FrameSource, camera: Camera) -> None:
    """Raise `InputError` if frames extend beyond the sensor, or show a part whose origin only their metadata state.

    Frames of one channel of a colour filter pattern are not checked.
    """
    known = source.metadata
    if known.channel:  # one colour of a mosaic has fewer pixels than the sensor
        return
    if known.origin is not None:
        check_inside(known.origin, source.shape, camera.sensor.shape)
    elif known.stated_origin is not None and is_part_of_sensor(source.shape, camera):
        raise part_refusal(source.shape, camera.sensor.shape, known.stated_origin, "as their metadata say")


def part_refusal(shape: Place, sensor: Place, origin: Sequence[float] | None, why: str) -> InputError:
    """Return the error for frames of a part of the sensor whose position was not stated.

    ``origin`` is the likely position (row, column) of their first pixel (px). None: unknown. ``why`` is the clause of
    the message that states how it was found.
    """
    got, words = f"{shape[0]} x {shape[1]} px", "ROW,COLUMN"
    if origin is not None:
        row, column = (max(0, math.floor(n + 0.5)) for n in origin)
        got, words = f"{got} whose first pixel is row {row}, column {column} of it, {why}", f"{row},{column}"
    return InputError.expected(
        "frames",
        f"the camera's whole sensor, {sensor[0]} x {sensor[1]} px",
        got,
        f"state the sensor row and column of their first pixel (--origin {words}); if the sensor is this small, "
        "correct its size in the camera (lfcal camera import CAMERA --frame FRAME)",
    )
