"""Parse values from text: one parser for each kind of value, for all commands, forms and job files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from numbers import Real
from typing import Any, TypeVar

from lfcal.base import InputError

__all__ = [
    "check_count",
    "check_planes",
    "check_voxel",
    "read_as",
    "read_count",
    "read_cutout",
    "read_cutout_or_auto",
    "read_depths",
    "read_effect",
    "read_length_um",
    "read_names",
    "read_orientation",
    "read_pair",
    "read_pixel",
    "read_planes",
    "read_position",
    "read_range",
    "read_share",
    "read_virtual_depths",
    "read_voxel",
    "show_names",
    "show_pair",
    "show_planes",
    "show_share",
]

T = TypeVar("T")

UNITS = {"": 1.0, "um": 1.0, "µm": 1.0, "mm": 1e3, "nm": 1e-3}
"""Micrometres in each unit of length."""

MAX_PLANES = 10_000
NUMBER = r"[-+−]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


def _number(text: str) -> float:
    return float(text.replace("−", "-"))


def read_as(called: str, read: Callable[[str], T], text: str) -> T:
    """Return ``read(text)``; in error messages, the value is called ``called``."""
    try:
        return read(text)
    except InputError as error:
        raise InputError(f"{called}: {str(error).partition(': ')[2]}") from None


def read_pair(text: str) -> tuple[float, float]:
    """Return (a, a) for the text ``"a"``, and (a, b) for ``"a,b"`` or ``"axb"``."""
    fields = [field.strip() for field in re.split("[,x×]", text)]
    if len(fields) in (1, 2) and all(re.fullmatch(NUMBER, field) for field in fields):
        return _number(fields[0]), _number(fields[-1])
    raise InputError.expected(
        "value", "one number or two (rows,columns)", repr(text), "write it in the form 181 or 181,181"
    )


def read_range(text: str) -> tuple[float, float]:
    """Return the two ends of a range from a text such as ``"2,6"``, in the order of the text."""
    fields = [field.strip() for field in text.split(",")]
    if len(fields) != 2 or not all(re.fullmatch(NUMBER, field) for field in fields):
        raise InputError.expected(
            "value", "the smallest and the largest value, MIN,MAX", repr(text), "write two numbers with a comma: 2,6"
        )
    return _number(fields[0]), _number(fields[1])


def read_cutout(text: str) -> tuple[int, int] | None:
    """Return (rows, columns) in pixels from ``"41"``, ``"41x61"`` or ``"41,61"``; None for an empty string."""
    if not text.strip():
        return None
    rows, columns = read_pair(text)
    if not (rows.is_integer() and columns.is_integer()):
        raise InputError.expected(
            "cutout", "whole numbers of pixels", f"{rows:g}, {columns:g}", "give odd whole numbers"
        )
    return int(rows), int(columns)


def read_cutout_or_auto(text: str) -> tuple[int, int] | str | None:
    """Return ``"auto"`` for the text ``"auto"``, or else the cutout as `read_cutout` does."""
    return "auto" if text.strip() == "auto" else read_cutout(text)


def read_position(text: str) -> tuple[int, int]:
    """Return the indices (y, x) of a source position from a text such as ``"9,16"``."""
    found = re.fullmatch(r"\s*(-?\d+)\s*,\s*(-?\d+)\s*", text)
    if found is None:
        raise InputError.expected("position", "y,x", repr(text), "write two whole numbers with a comma: 9,16")
    return int(found[1]), int(found[2])


def show_pair(value: Any) -> str:
    """Return a pair, or the text ``"auto"``, as text that `read_pair` and `read_cutout_or_auto` parse."""
    return value if isinstance(value, str) else show_planes(value)


def read_share(text: str) -> float:
    """Return the fraction from a text such as ``"0.03"`` or ``"3%"``."""
    found = re.fullmatch(rf"({NUMBER})\s*(%)?", text.strip())
    if found is None:
        raise InputError.expected("share", "a number, or percent", repr(text), "write it in the form 0.03 or 3%")
    return _times_ten(found[1], -2) if found[2] else _number(found[1])


def show_share(value: float) -> str:
    """Return a fraction as text, in per cent if `read_share` parses that to exactly the same number."""
    percent = f"{show_planes((_times_ten(repr(float(value)), 2),))} %"
    return percent if read_share(percent) == value else repr(value)


def _times_ten(number: str, power: int) -> float:
    """Return a number times a power of ten, rounded only once, unlike a product of floats."""
    digits, _, exponent = number.lower().partition("e")
    return _number(f"{digits}e{int(exponent or 0) + power}")


def read_length_um(text: str) -> float:
    """Return a length in µm from a number with a unit (nm, um, µm or mm); a number without a unit is in µm."""
    found = re.fullmatch(rf"({NUMBER})\s*(nm|um|µm|mm)?", text.strip())
    if found is None:
        raise InputError.expected(
            "length", "a number with nm, um or mm", repr(text), "write it in the form 250 um or 1.5 mm"
        )
    return _number(found[1]) * UNITS[found[2] or ""]


def read_planes(text: str, *, lengths: bool) -> tuple[float, ...]:
    """Return the values for each plane from ``"a,b,c"``, or from ``"start:stop:step"`` with ``stop`` included.

    With ``lengths``, the numbers may have a unit (um, µm or mm; none: µm), and the result is in µm.
    """
    fields = re.split("[,:]", text)
    values = [_plane(field, lengths) for field in fields]
    if ":" not in text:
        return tuple(values)
    if "," in text or len(values) != 3 or values[2] == 0:
        raise InputError.expected(
            "planes", "a,b,c or start:stop:step", repr(text), "write it in the form 2,3,5 or 2:5.5:0.5"
        )
    start, stop, step = values
    # rounded generously: 0.1:0.7:0.1 means seven planes, although 0.6 / 0.1 is below 6 in floating point
    count = math.floor((stop - start) / step * (1 + 1e-12) + 1e-9) + 1
    if not 1 <= count <= MAX_PLANES:
        wanted = f"1 to {MAX_PLANES} steps from start to stop"
        raise InputError.expected("planes", wanted, repr(text), "change the step, or the sign of it")
    return tuple(start + k * step for k in range(count))


def read_depths(text: str) -> tuple[float, ...]:
    """Return depths in µm, parsed by `read_planes`; an empty tuple for an empty string."""
    return read_planes(text, lengths=True) if text.strip() else ()


def read_virtual_depths(text: str) -> tuple[float, ...]:
    """Return virtual depths, parsed by `read_planes`; an empty tuple for an empty string."""
    return read_planes(text, lengths=False) if text.strip() else ()


def show_planes(values: Iterable[Any]) -> str:
    """Return values with all their digits as text that `read_planes` parses."""
    return ",".join(repr(float(v)).removesuffix(".0") if isinstance(v, Real) else str(v) for v in values)


def check_planes(depths: object, virtual_depths: object) -> None:
    """Raise `InputError` unless exactly one of depths and virtual depths is given."""
    if bool(depths) == bool(virtual_depths):
        raise InputError.expected(
            "planes",
            "depths in µm (--depths) or virtual depths (--virtual-depths)",
            "both" if depths else "neither",
            "give one of them, such as --virtual-depths 2:5.5:0.5",
        )


def _plane(field: str, lengths: bool) -> float:
    found = re.fullmatch(rf"({NUMBER})\s*(um|µm|mm)?", field.strip())
    # virtual depths are ratios: a unit indicates that the wrong option was used
    if found is None or (found[2] and not lengths):
        wanted = "numbers, in µm or with mm" if lengths else "numbers"
        raise InputError.expected("planes", wanted, repr(field), "separate numbers by commas: 2,3,5")
    # the second number of "1,000", which would mean the planes 1 and 0
    if re.match(r"[-+−]?0\d", found[1]):
        raise InputError.expected("planes", "numbers without leading zeros", repr(field), "write 1000 for 1,000")
    return _number(found[1]) * UNITS[found[2] or ""]


def read_effect(text: str) -> str:
    """Return the setting of an effect in the form ``"NAME=VALUE"``, or the path of a JSON file of effects."""
    name, sign, value = (part.strip() for part in text.partition("="))
    if name and value:
        return f"{name}={value}"
    if not sign and name.lower().endswith(".json"):
        return name
    wanted = "NAME=on, off, auto or a magnitude, or a JSON file"
    raise InputError.expected("effect", wanted, repr(text), "write name and value in the form coma=0.3@40deg")


def read_orientation(text: str) -> str:
    """Return the name of an orientation as in options; ``"mirror x"`` becomes ``"mirror-x"``."""
    return "-".join(text.split())


def read_pixel(text: str) -> tuple[float, float]:
    """Return the pixel (row, column) from a text such as ``"12,7"``; fractions of a pixel are allowed."""
    fields = [field.strip() for field in text.split(",")]
    if len(fields) != 2 or not all(re.fullmatch(NUMBER, field) for field in fields):
        raise InputError.expected("pixel", "ROW,COLUMN", repr(text), "write two numbers with a comma: 12,7")
    return _number(fields[0]), _number(fields[1])


def read_count(text: str, at_least: int, words: tuple[str, ...]) -> int | str:
    """Return the whole number in ``text``, which must be at least ``at_least``, or a text that is one of ``words``."""
    value = int(text) if re.fullmatch(r"\s*[-+]?\d+\s*", text) else text.strip()
    check_count("number", value, at_least, *words)
    return value


def check_count(name: str, value: object, at_least: int, *words: str) -> None:
    """Raise `InputError` unless ``value`` is a whole number of at least ``at_least``, or one of ``words``.

    ``name`` is the name of the value in the message.
    """
    if value in words:
        return
    if isinstance(value, bool) or not isinstance(value, int) or value < at_least:
        raise InputError.expected(
            name, f"a whole number ≥ {at_least}, or {' or '.join(words)}", repr(value), "give one of these"
        )


def read_voxel(text: str) -> float | str:
    """Return the side of a voxel in µm, parsed by `read_length_um`; ``"auto"`` is returned unchanged."""
    try:
        return text.strip() if text.strip() == "auto" else read_length_um(text)
    except InputError:
        raise InputError.expected("voxel", "a number of µm, or auto", repr(text), "give one of these") from None


def check_voxel(name: str, value: object) -> None:
    """Raise `InputError` unless ``value`` is None, ``"auto"`` or a positive, finite number of µm.

    ``name`` is the name of the value in the message.
    """
    if value in (None, "auto"):
        return
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
        raise InputError.expected(name, "a positive number of µm, or auto", repr(value), "give one of these")


def read_names(text: str) -> tuple[str, ...]:
    """Return the names from a text such as ``"A,B,C"``, without duplicates."""
    return tuple(dict.fromkeys(part.strip() for part in text.split(",") if part.strip()))


def show_names(value: tuple[str, ...]) -> str:
    """Return names as text that `read_names` parses."""
    return ",".join(value)
