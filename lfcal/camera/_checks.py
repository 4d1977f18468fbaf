"""Validation shared by the camera's descriptions."""

from __future__ import annotations

import math
from numbers import Integral, Real

from lfcal.errors import InputError, expectation

__all__ = ["check_choice", "check_number"]


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
    """Raise `InputError` unless ``value`` is a finite number within the bounds."""
    kind = Integral if integer else Real
    bounds = [
        f"{sign} {limit:g}"
        for sign, limit in ((">", above), ("≥", at_least), ("<", below), ("≤", at_most))
        if limit is not None
    ]
    wanted = " ".join([("a whole number" if integer else "a number"), " and ".join(bounds)]).strip()
    good = isinstance(value, kind) and not isinstance(value, bool) and math.isfinite(float(value))
    if good:
        number = float(value)  # type: ignore[arg-type]
        good = (
            (above is None or number > above)
            and (at_least is None or number >= at_least)
            and (below is None or number < below)
            and (at_most is None or number <= at_most)
        )
    if not good:
        raise InputError(expectation(what, wanted, repr(value), remedy))


def check_choice(what: str, value: object, choices: tuple[str, ...]) -> None:
    """Raise `InputError` unless ``value`` is one of ``choices``."""
    if value not in choices:
        raise InputError(expectation(what, " or ".join(choices), repr(value), "choose one of these"))
