"""Validation of values from users and files, for all packages."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from numbers import Integral, Real
from typing import TYPE_CHECKING, Any

from lfcal.base.errors import InputError, any_of, choose

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "MAX_SAMPLE",
    "array_words",
    "as_sensor_frame",
    "check_choice",
    "check_commas",
    "check_exposure",
    "check_length",
    "check_number",
    "check_tuple",
    "check_type",
    "check_wavelength",
]

MAX_SAMPLE = 1e12
"""Limit of values in a frame or a PSF matrix: larger ones cannot be counts, and their squared sums would overflow."""

MAX_NUMBER = 1e15
"""Limit of numbers: larger ones come from damaged files, and their squared sums would overflow."""


def check_number(
    what: str,
    value: object,
    *,
    above: float | None = None,
    below: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    integer: bool = False,
    remedy: str = "correct this value",
) -> None:
    """Raise `InputError` unless ``value`` is a finite number within the bounds.

    The bounds ``above`` and ``below`` themselves are not allowed, ``at_least`` and ``at_most`` are. If a side has no
    bound, the limit is `MAX_NUMBER` or its negative. A bool is refused. With ``integer``, so is a value without an
    integer type, such as 2.0. ``what`` names the value in the message, which ends with ``remedy``.
    """
    # plain types first: checking abstract ones takes as long as everything else. A bool is an Integral in Python.
    plain = isinstance(value, int if integer else (float, int))
    good = (plain or isinstance(value, Integral if integer else Real)) and not isinstance(value, bool)
    if good and _finite(value):
        number = float(value)  # type: ignore[arg-type]
        if abs(number) > MAX_NUMBER:
            at_most = MAX_NUMBER if below is None and at_most is None else at_most
            at_least = -MAX_NUMBER if above is None and at_least is None else at_least
        if (
            (above is None or number > above)
            and (at_least is None or number >= at_least)
            and (below is None or number < below)
            and (at_most is None or number <= at_most)
        ):
            return
    bounds = [
        f"{sign} {limit:g}"
        for sign, limit in ((">", above), ("≥", at_least), ("<", below), ("≤", at_most))
        if limit is not None
    ]
    wanted = " ".join([("a whole number" if integer else "a number"), " and ".join(bounds)]).strip()
    raise InputError.expected(what, wanted, repr(value), remedy)


def check_commas(what: str, text: str, *, whole: bool = False, several: bool = False) -> None:
    """Raise `InputError` if a comma is directly between digits of ``text``.

    "2,5" may mean 2.5 or two numbers, and "1,000" may mean one or a thousand, depending on the user's conventions. The
    message, in which ``what`` names the value, states the possible meanings. Set ``whole`` if a number with decimals is
    not possible, and ``several`` if a list is possible.
    """
    found = re.search(r"\d+(?:,\d+)+", text)
    if found is None:
        return
    parts = found.group().split(",")
    readings = []
    if all(len(part) == 3 for part in parts[1:]) and len(parts[0]) <= 3 and parts[0] != "0":
        readings.append("".join(parts))
    if len(parts) == 2 and not whole:
        readings.append(f"{'.'.join(parts)} with a decimal point")
    if several:
        readings.append(f"{', '.join(parts)} with a space after the comma")
    remedy = f"write {' or '.join(readings)}" if readings else "write one number"
    raise InputError.expected(what, "no comma between digits", repr(text), remedy)


def check_length(what: str, value_um: object, **bounds: Any) -> None:
    """Raise `InputError` unless ``value_um`` is a length within the ``bounds`` of `check_number` (default: >= 1e-9 µm).

    Lengths above `MAX_NUMBER` µm are refused unless ``bounds`` has another ``at_most``. The default limits are far from
    any real instrument, and keep squares of lengths and of their ratios from overflowing. ``what`` names the length in
    the message.
    """
    check_number(what, value_um, **{"at_most": MAX_NUMBER, **(bounds or {"at_least": 1e-9})})


def check_exposure(what: str, value_s: object) -> None:
    """Raise `InputError` unless the exposure ``value_s``, named ``what`` in the message, is from 1e-12 to 1e9 s."""
    check_number(what, value_s, at_least=1e-12, at_most=1e9)


def check_wavelength(value_um: object) -> None:
    """Raise `InputError` unless the wavelength ``value_um`` is between 0.05 and 20 µm, exclusive."""
    remedy = "give it in µm (--wavelength takes nm)"
    check_number("wavelength (µm)", value_um, above=0.05, below=20, remedy=remedy)


def _finite(value: Any) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # Python integers are unbounded
        return False


def check_choice(what: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise `InputError` unless ``value``, named ``what`` in the message, is one of ``choices``."""
    if value not in choices:
        raise InputError.expected(what, any_of(choices), repr(value), choose(value, choices))


def check_tuple(what: str, values: object, count: int | None = None, **bounds: Any) -> tuple[Any, ...]:
    """Return ``values`` as a tuple of ``count`` numbers (None: one or more); raise `InputError` unless they are.

    Each number must be within the ``bounds`` of `check_number`. ``what`` names the values in the message.
    """
    wanted = "one or more numbers" if count is None else f"{count} numbers"
    if not isinstance(values, Sequence) or isinstance(values, str) or (len(values) != count if count else not values):
        raise InputError.expected(what, wanted, repr(values)[:60], "correct this value")
    for value in values:
        check_number(what, value, **bounds)
    return tuple(int(v) if bounds.get("integer") else float(v) for v in values)


def check_type(what: str, value: object, kind: type | tuple[type, ...]) -> None:
    """Raise `InputError` unless ``value``, named ``what`` in the message, is an instance of ``kind``."""
    if not isinstance(value, kind):
        names = any_of(k.__name__ for k in (kind if isinstance(kind, tuple) else (kind,)))
        raise InputError.expected(what, names, repr(value)[:60], "correct this value")


def array_words(values: ArrayLike) -> str:
    """Return the shape and, for numbers, the range of an array, in words for a message."""
    import numpy as np  # imported late: records are checked without numpy

    array = np.asarray(values)
    if not array.size or array.dtype.kind not in "biuf":
        return f"shape {array.shape}"
    span = f"{float(array.min()):.4g} to {float(array.max()):.4g}" if np.isfinite(array).all() else "NaN or infinity"
    return f"shape {array.shape}, values {span}"


def as_sensor_frame(what: str, frame: ArrayLike) -> NDArray[np.float32]:
    """Return a read-only, contiguous float32 copy of ``frame``, which is named ``what`` in a message.

    Raise `InputError` unless ``frame`` is a 2-D array of finite numbers that is not empty.
    """
    import numpy as np  # imported late: records are checked without numpy

    array = np.asarray(frame)
    if array.ndim != 2 or not array.size or array.dtype.kind not in "iuf":
        raise InputError.expected(
            what, "a 2-D frame of numbers", f"{array.dtype} of shape {array.shape}", "give one frame or their mean"
        )
    if not np.isfinite(array).all():
        raise InputError.expected(what, "finite values", "NaN or infinity", "record it again")
    result = np.array(array, np.float32, order="C")
    result.setflags(write=False)
    return result
