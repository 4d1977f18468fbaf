"""Parse camera values: with units, as lists in the order of an option, or as a pitch in pixels."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from lfcal.base import InputError, choose
from lfcal.camera.quantities import QUANTITIES

__all__ = ["read_camera_value", "read_length", "read_pitch", "read_sensor", "read_values"]

LENGTHS = {"nm": 1e-3, "um": 1.0, "µm": 1.0, "mm": 1e3, "m": 1e6}
WHOLE = ("optics.blades", "lattice.type_step", "sensor.bit_depth")
TEXT = ("lattice.kind", "lattice.aperture", "sensor.cfa")
SEVERAL = ("lattice.types", "lattice.focal_lengths_um", "lattice.offset_um", "lattice.focus")
NUMBER = re.compile(r"\s*([-+]?(?:inf|[0-9.]+(?:[eE][-+]?\d+)?))\s*([a-zµ°]*)\s*")


def read_camera_value(path: str, text: str) -> Any:
    """Return the value of the camera entry ``path``, such as ``"sensor.pixel_um"``, that ``text`` states.

    Lengths are in µm unless they have a unit (nm, um, mm, m), and angles in rad unless they end in deg. Several values
    are separated by commas, and the centres of lenslets by semicolons.
    """
    known = [quantity.path for quantity in QUANTITIES] + ["lattice.focus"]
    if path not in known:
        raise InputError.expected(
            "entry of a camera", f"PATH=VALUE, where PATH is one of {', '.join(known)}", path, choose(path, known)
        )
    text = text.strip()
    if path in TEXT:
        return text
    if path == "sensor.shape":
        return read_sensor(text)["sensor.shape"]
    convert: Callable[[str], Any] = (
        (lambda part: _whole(part, path)) if path in WHOLE else lambda part: _one(part, path)
    )
    if path == "lattice.lens_centres_um":
        return tuple(_centre(part) for part in text.split(";"))
    if path in SEVERAL:
        return tuple(convert(part) for part in text.split(","))
    return convert(text)


def _centre(text: str) -> tuple[float, float]:
    parts = text.split(",")
    if len(parts) != 2:
        raise InputError.expected(
            "centres of the lenslets (µm)",
            "X,Y of each centre, with ; between centres",
            repr(text),
            "write them in the form 0,0; 2500,0",
        )
    x, y = (read_length(part, "µm", "lattice.lens_centres_um") for part in parts)
    return x, y


def _one(text: str, path: str) -> float:
    if path.endswith("_um") or path == "lattice.types":
        return read_length(text, "µm", path)
    value, unit = _number(text, path)
    if path.endswith("_rad") and unit in ("deg", "°"):
        return math.radians(value)
    if unit:
        raise InputError.expected(path, "a number without a unit", repr(text), "remove the unit")
    return value


def _whole(text: str, path: str) -> int:
    value, unit = _number(text, path)
    if unit or not value.is_integer():
        raise InputError.expected(path, "a whole number", repr(text), "round this value")
    return int(value)


def _number(text: str, what: str) -> tuple[float, str]:
    match = NUMBER.fullmatch(text)
    try:
        if match is None:
            raise ValueError
        return float(match[1]), match[2]
    except ValueError:
        raise InputError.expected(what, "a number", repr(text), "write it like 5.5 or 5.5um") from None


def read_length(text: str, usual: str, what: str) -> float:
    """Return a length in µm from a text; ``usual`` is the default unit, ``what`` the name of the value in messages."""
    value, unit = _number(text, what)
    if (unit or usual) not in LENGTHS:
        raise InputError.expected(
            what, f"a length in {usual}, or with nm, um, mm, m", repr(text), "use one of these units"
        )
    # 12 digits: 0.55 µm stays 0.55 when converted through nanometres
    return float(f"{value * LENGTHS[unit or usual]:.12g}")


def read_sensor(text: str) -> dict[str, Any]:
    """Return the shape and the pixel pitch (µm) in a text ``ROWSxCOLUMNS,PIXEL``, by path; the pitch may be omitted."""
    match = re.fullmatch(r"\s*(\d{1,6})\s*[x×*]\s*(\d{1,6})\s*(?:,(.+))?", text)
    if match is None:
        raise InputError.expected(
            "--sensor", "ROWSxCOLUMNS,PIXEL", repr(text), "give rows, columns and the pixel size (µm): 4384x6576,5.5"
        )
    found: dict[str, Any] = {"sensor.shape": (int(match[1]), int(match[2]))}
    if match[3]:
        found["sensor.pixel_um"] = read_length(match[3], "µm", "--sensor, pixel pitch")
    return found


def read_values(text: str, paths: tuple[str, ...], units: tuple[str, ...], shape: str, example: str) -> dict[str, Any]:
    """Return the values in a comma-separated list by ``paths``, in this order; the last values may be omitted.

    ``units`` contains the default unit of each length, and an empty string for each plain number. Lengths are returned
    in µm. Error messages state the expected form as ``shape`` and ``example``.
    """
    parts = text.split(",")
    if len(parts) > len(paths) or not all(part.strip() for part in parts):
        raise InputError.expected(shape.split()[0], shape, repr(text), f"write it in this form: {example}")
    given = zip(parts, paths, units, strict=False)
    return {path: read_length(part, unit, path) if unit else _one(part, path) for part, path, unit in given}


def read_pitch(text: str, pixel_um: float | None) -> float:
    """Return a pitch in µm from a text such as ``125um``, ``125`` (µm) or ``31.7px``.

    ``pixel_um`` is the pixel pitch (µm). If it is None, a pitch in pixels raises `InputError`.
    """
    if not text.strip().endswith("px"):
        return read_length(text, "µm", "--pitch")
    if pixel_um is None:
        raise InputError.expected("--pitch", "the pixel size for a pitch in pixels", "none", "state it (--sensor)")
    value, _ = _number(text.strip()[:-2], "--pitch")
    return float(f"{value * pixel_um:.12g}")
