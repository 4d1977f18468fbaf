"""Single magnitudes of an effect: name, unit for display, value, and source of the value."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from lfcal.base import InputError, check_choice, check_commas
from lfcal.camera import QUANTITIES, Camera
from lfcal.simulate.effects.base import Effect

__all__ = ["GIVEN", "Magnitude", "magnitudes_of", "number_in", "units_of"]

GIVEN = ("stated", "measured")
"""Ways in which a magnitude given by the user is known."""

LENGTHS = {"um": 1.0, "µm": 1.0, "nm": 1e-3, "mm": 1e3}
ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180}
TIMES = {"s": 1.0, "ms": 1e-3}
SHARES = {"%": 0.01}
NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S*)")

TRIPLES = {"Wavefront": ("n,m,waves", "4,0,0.1;3,1,0.05"), "Defects": ("row,column,transmission", "0,0,0;1,-2,0.4")}
"""Magnitudes that are lists of three numbers, the first two whole: the meaning of the three, and an example."""

SHOWN = {"_um": "µm", "_rad": "°", "_s": "s"}
"""Display unit for each unit at the end of a field's name."""


def units_of(kind: type[Effect], field: str) -> dict[str, float]:
    """Return the units in which the magnitude ``field`` of ``kind`` may be given, with their sizes in the field's unit.

    For a fraction, for example, the result is ``{"%": 0.01}``.
    """
    named = kind.units.get(field)
    if named is not None:
        return SHARES if named in ("share", "%") else {named: 1.0} if named else {}
    for ending, units in (("_um", LENGTHS), ("_rad", ANGLES), ("_s", TIMES)):
        if field.endswith(ending):
            return units
    return SHARES


def number_in(what: str, text: str, units: Mapping[str, float], plain: float = 1.0) -> float:
    """Return the number in ``text``, converted to the field's unit.

    ``units`` maps the allowed units to their size in the field's unit; ``plain`` is the size for a number without unit.
    ``what`` names the quantity in error messages.

    Raises
    ------
    InputError
        If the text is not a finite number, or its unit is not in ``units``.
    """
    match = NUMBER.fullmatch(text.strip())
    known = {"": plain, **units}
    value = float(match[1]) * known[match[2]] if match is not None and match[2] in known else math.nan
    if not math.isfinite(value):
        allowed = "".join(f"{unit}, " for unit in units if unit).rstrip(", ")
        wanted = f"a number, with {allowed} or no unit" if allowed else "a number"
        got = "inf" if math.isinf(value) else repr(text)
        raise InputError.expected(what, wanted, got, "give a value such as 0.3")
    return value


@dataclass(frozen=True, slots=True)
class Magnitude:
    """One magnitude of an effect, as it is displayed and edited.

    Attributes
    ----------
    field
        Name of the field.
    title, unit
        Displayed name and unit: ``"direction"`` in ``"°"``.
    kind
        ``"number"``, ``"whole"`` (an integer), ``"text"`` or ``"terms"`` (a list of triples); ``"other"``: only files
        can contain the value.
    scale
        Ratio of the value to the displayed number.
    units
        Units that may be entered, with their size in the field's unit.
    value
        Value in the effect. None: the value in the camera's description, or a typical value.
    counts
        Effective value: ``value``, or the camera's or typical value if that is None; None if there is no value at all.
    default
        Value in an effect that is created without this magnitude.
    limits
        Smallest and largest value, in the field's unit; infinite if there is no limit.
    source
        ``"given"`` by the user; ``"camera"``: from the camera's description; ``"typical"``: the usual size of a
        deviation, which is not specific to this camera.
    mark
        Mark of the value: for a given value one of `GIVEN`, for the camera's value its mark (`lfcal.camera.Marks`), and
        for a typical value an empty string.
    otherwise
        Source and mark of the effective value if no value is given.
    columns
        Names of the three numbers of triples; empty for other kinds.
    """

    field: str
    title: str
    unit: str
    kind: str
    scale: float
    units: Mapping[str, float]
    value: Any
    counts: Any
    default: Any
    limits: tuple[float, float]
    source: str
    mark: str
    otherwise: tuple[str, str]
    columns: tuple[str, ...] = ()

    def text(self, value: Any) -> str:
        """Return ``value``, given in the field's unit, as text in the displayed `unit`, without the unit itself.

        The text is empty for None. `read` converts the text of a number back.
        """
        if value is None or isinstance(value, str):
            return value or ""
        if self.kind == "terms":
            return "; ".join(f"{a}, {b}, {c:g}" for a, b, c in value)
        return f"{value / self.scale:.10g}" if self.kind in ("number", "whole") else str(value)

    def range_text(self) -> str:
        """Return the limits as text in the displayed `unit`; empty if any number is allowed."""
        low, high = (None if math.isinf(limit) else f"{limit / self.scale:g}" for limit in self.limits)
        words = f"{low} to {high}" if low and high else f"at least {low}" if low else f"at most {high}" if high else ""
        return f"{words} {self.unit}".rstrip() if words else ""

    def read(self, text: str) -> Any:
        """Return the value in ``text``, in the field's unit; for the kind ``"text"``, the text itself.

        A number without a unit is in the displayed `unit`; otherwise, its unit must be one of `units`.

        Raises
        ------
        InputError
            If the text is not such a number, or the value is outside the limits or not whole where it must be.
        """
        text = text.strip()
        if self.kind == "text":
            return text
        check_commas(self.title, text, whole=self.kind == "whole")
        value = number_in(self.title, text, self.units, self.scale)
        low, high = self.limits
        if not low <= value <= high:
            raise InputError.expected(
                self.title, self.range_text(), f"{text} {self.unit}".rstrip(), "choose a value in this range"
            )
        if self.kind != "whole":
            return value
        if value != int(value):
            raise InputError.expected(self.title, "a whole number", text, "round this value")
        return int(value)


def magnitudes_of(effect: Effect, camera: Camera, given: Mapping[str, str] | None = None) -> tuple[Magnitude, ...]:
    """Return the magnitudes of ``effect`` in the order of its fields.

    Parameters
    ----------
    effect
        Effect with its values.
    camera
        Camera whose description provides the values of magnitudes that are None.
    given
        Fields given by the user, each with one of `GIVEN`. A field that differs from its default always counts as
        given, and one whose value is None never does.

    Raises
    ------
    InputError
        If a value of ``given`` is not in `GIVEN`.
    """
    known = dict(given or {})
    for name, mark in known.items():
        check_choice(f"how {name} is known", mark, GIVEN)
    return tuple(_magnitude(effect, field, camera, known) for field in fields(effect))  # type: ignore[arg-type]


def _magnitude(effect: Effect, field: Any, camera: Camera, given: Mapping[str, str]) -> Magnitude:
    kind, name = type(effect), field.name
    value = getattr(effect, name)
    unit, scale = shown_unit(kind, name)
    otherwise = ("typical", "")
    if field.default is None and kind.is_described(name, camera):
        otherwise = ("camera", camera.marks[kind.described[name]])
    stated = value is not None and (name in given or value != field.default)
    source, mark = ("given", given.get(name, "stated")) if stated else otherwise
    return Magnitude(
        name,
        kind.titles.get(name) or plain_title(name),
        unit,
        kind_of(str(field.type)),
        scale,
        units_of(kind, name),
        value,
        effect.magnitude(name, camera),
        field.default,
        kind.limits.get(name, (-math.inf, math.inf)),
        source,
        mark,
        otherwise,
        tuple(TRIPLES[str(field.type)][0].split(",")) if str(field.type) in TRIPLES else (),
    )


def kind_of(annotation: str) -> str:
    """Return the `Magnitude.kind` of a field with this type annotation, such as ``"float | None"``."""
    base = annotation.removesuffix(" | None").strip()
    if base in TRIPLES:
        return "terms"
    return {"float": "number", "int": "whole", "str": "text"}.get(base, "other")


def shown_unit(kind: type[Effect], field: str) -> tuple[str, float]:
    """Return the display unit of the magnitude ``field``, and its size in the field's unit.

    They are ``""`` and 1 if there is no unit. Unless ``kind`` names a unit, a magnitude of the camera's description has
    the same unit as there.
    """
    named = kind.units.get(field)
    if named is not None:
        return ("%", 0.01) if named in ("share", "%") else (named, 1.0)
    quantity = next((q for q in QUANTITIES if q.path == kind.described.get(field)), None)
    if quantity is not None:
        return quantity.unit, quantity.scale
    unit = next((unit for ending, unit in SHOWN.items() if field.endswith(ending)), "")
    return unit, ANGLES["deg"] if unit == "°" else 1.0


def plain_title(field: str) -> str:
    """Return the name of a field as words, without ``_um``, ``_rad`` or ``_s`` at its end."""
    base, _, unit = field.rpartition("_")
    return (base if f"_{unit}" in SHOWN and base else field).replace("_", " ")
