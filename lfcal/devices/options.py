"""Reading the text options of backends."""

from __future__ import annotations

import math
from collections.abc import Mapping

from lfcal.base import InputError
from lfcal.devices.protocols import Limits

__all__ = ["limits_option", "number_option"]


def number_option(
    options: Mapping[str, str], key: str, default: float, *, low: float = -math.inf, high: float = math.inf
) -> float:
    """Return option ``key`` as a number within [``low``, ``high``].

    Examples
    --------
    >>> from lfcal.devices import number_option
    >>> number_option({"speed": "250"}, "speed", 100.0, low=0.0), number_option({}, "speed", 100.0)
    (250.0, 100.0)
    """
    text = options.get(key)
    if text is None:
        return default
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not low <= value <= high:
        raise InputError.expected(f"option {key}", f"a number from {low:g} to {high:g}", repr(text), "correct it")
    return value


def limits_option(options: Mapping[str, str], key: str = "limits") -> Limits | None:
    """Return option ``key``, ``x0:x1,y0:y1,z0:z1`` in µm, as limits; None if it is not given.

    Examples
    --------
    >>> from lfcal.devices import limits_option
    >>> limits_option({"limits": "0:50000,0:50000,-1000:1000"})  # of each axis (um)
    ((0.0, 50000.0), (0.0, 50000.0), (-1000.0, 1000.0))
    """
    text = options.get(key)
    if text is None:
        return None
    try:
        pairs = [tuple(float(v) for v in part.split(":")) for part in text.split(",")]
        (x0, x1), (y0, y1), (z0, z1) = pairs
    except ValueError:
        x0, x1, y0, y1, z0, z1 = 1.0, 0.0, 1.0, 0.0, 1.0, 0.0
    if not (x0 < x1 and y0 < y1 and z0 < z1):
        raise InputError.expected(f"option {key}", "x0:x1,y0:y1,z0:z1 in µm, low before high", repr(text), "correct it")
    return (x0, x1), (y0, y1), (z0, z1)
