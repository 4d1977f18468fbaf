"""Fields of forms: what is shown of a value, and what a typed text means. Pure functions, no Qt."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from lfcal.base import InputError, check_commas

__all__ = ["UNKNOWN", "Field", "means", "parse", "same", "text_of"]

UNKNOWN: Any = object()
"""In the place of a value or default that is not known."""

_WANTED = {"float": "a number", "int": "a whole number", "floats": "numbers separated by ', ' or ';'"}


@dataclass(frozen=True)
class Field:
    """One entry of a form.

    Attributes
    ----------
    key
        Name of the value.
    label, unit, tip
        What is shown: name, unit, and what the quantity means.
    kind
        ``"float"``, ``"int"``, ``"choice"``, ``"text"``, ``"bool"``, ``"floats"`` (a list of numbers), or ``"shown"``:
        words that cannot be changed.
    scale
        Shown value = stored value / scale: 1000 shows µm as mm.
    choices
        For ``"choice"``: pairs of stored value and shown text.
    optional
        An empty entry is None.
    endless
        Numbers may be infinite; they are never NaN.
    empty
        What an empty entry means, in a word or two.
    read
        Of ``"text"``: what a text means, if several texts mean the same; it may raise `InputError`.
    default
        Value that a reset restores, as the form shows it; `UNKNOWN`: there is none.
    group
        Heading of the field where it is folded.
    file
        Kinds of files of a path, as a file dialog has them; empty: it is none.
    late
        Whether a text is reported when typing ends, not letter by letter.
    """

    key: str
    label: str
    unit: str = ""
    tip: str = ""
    kind: str = "float"
    scale: float = 1.0
    choices: tuple[tuple[Any, str], ...] = ()
    optional: bool = False
    endless: bool = False
    empty: str = ""
    read: Callable[[str], Any] | None = None
    default: Any = UNKNOWN
    group: str = ""
    file: str = ""
    late: bool = False


def text_of(field: Field, value: Any) -> str:
    """Return the text that shows ``value``; `parse` reads it back."""
    if value is None:
        return ""
    if field.kind == "float":
        return f"{value / field.scale:.10g}"
    if field.kind == "floats":
        return ", ".join(f"{v / field.scale:.10g}" for v in value)
    return str(value)


def parse(field: Field, text: str) -> Any:
    """Return the stored value that ``text`` means; raise `InputError` in one line where it means none.

    A comma directly between digits is refused everywhere: "2,5" may be 2.5 or two numbers, "1,000" one or a thousand,
    and no guess is right for everybody.
    """
    text = text.strip()
    if not text and field.optional:
        return None
    if field.kind not in _WANTED:
        return text
    check_commas(field.label, text, whole=field.kind == "int", several=field.kind == "floats")
    try:
        if "_" in text:  # to Python 1_00 is a hundred
            raise ValueError
        if field.kind == "float":
            return _number(field, text)
        if field.kind == "int":
            return int(text)
        return tuple(_number(field, part) for part in text.replace(";", ",").split(",") if part.strip())
    except ValueError:
        raise InputError.expected(field.label, _WANTED[field.kind], repr(text), "correct it") from None


def means(field: Field, text: str, value: Any) -> bool:
    """Return whether ``text`` already says ``value``, in whatever words: "5.0" is 5."""
    try:
        if field.read is not None and isinstance(value, str):
            return bool(field.read(text) == field.read(value))
        return bool(parse(field, text) == value)
    except InputError:
        return False


def same(field: Field, one: Any, other: Any) -> bool:
    """Return whether two values of a field are the same for the user."""
    if field.kind in ("choice", "bool"):
        return bool(one == other)
    text = text_of(field, one)
    return text == text_of(field, other) or (bool(text) and means(field, text, other))


def _number(field: Field, text: str) -> float:
    """Return the stored number; raise `ValueError` for one that no project file could hold."""
    value = float(text) * field.scale
    if math.isnan(value) or (math.isinf(value) and not field.endless):
        raise ValueError
    return value
