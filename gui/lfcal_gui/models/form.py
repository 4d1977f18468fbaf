"""Form fields: conversion between values and text, and fields derived from records. No Qt."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass
from typing import Any

from lfcal.base import InputError, check_commas
from lfcal.records import FieldRow, read_names, read_share, rows, show_share

UNKNOWN: Any = object()
"""Placeholder for an unknown value or default."""

_WANTED = {"float": "a number", "int": "a whole number", "floats": "numbers separated by ', ' or ';'"}


@dataclass(frozen=True)
class Field:
    """One entry of a form.

    Attributes
    ----------
    key
        Key of the value.
    label, unit, tip
        Displayed name, unit and tooltip of the quantity.
    kind
        ``"float"``, ``"int"``, ``"choice"``, ``"text"``, ``"bool"``, ``"floats"`` (a list of numbers), or ``"shown"``:
        read-only text.
    scale
        Shown value = stored value / scale: 1000 shows µm as mm.
    choices
        For ``"choice"``: pairs of stored value and shown text.
    optional
        Whether an empty entry means None.
    endless
        Whether numbers may be infinite; NaN is never allowed.
    empty
        Meaning of an empty entry, in one or two words.
    read
        For ``"text"``: function that converts a text to its value if several texts are equivalent; it may raise
        `InputError`.
    default
        Value restored by a reset, as shown in the form; `UNKNOWN` if there is none.
    group
        Heading of the field in the folded part of the form.
    file
        For paths: file filter of the file dialog; empty if the field is not a path.
    late
        Whether a text is reported when typing ends instead of after each letter.
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
    """Return the text that represents ``value``; `parse` reads it back."""
    if value is None:
        return ""
    if field.kind == "float":
        return f"{value / field.scale:.10g}"
    if field.kind == "floats":
        return ", ".join(f"{v / field.scale:.10g}" for v in value)
    return str(value)


BETWEEN = re.compile(r"(?<=[\d.]),(?=[-\d])")
"""Comma between the numbers of a list."""

DIGITS = 6
"""Significant digits of a number that is shown and not typed."""


def rounded(text: str) -> str:
    """Return the text of a number rounded to `DIGITS` digits; any other text is unchanged."""
    try:
        value = float(text)
    except ValueError:
        return text
    short = f"{value:.{DIGITS}g}"
    return short if len(short) < len(text) and "e" not in short else text


def parse(field: Field, text: str) -> Any:
    """Return the stored value for ``text``; raise a one-line `InputError` if it is invalid.

    A comma directly between digits is refused everywhere, since it is ambiguous: "2,5" may be 2.5 or two numbers,
    and "1,000" one or a thousand.
    """
    text = text.strip()
    if not text and field.optional:
        return None
    if field.kind not in _WANTED:
        return text
    check_commas(field.label, text, whole=field.kind == "int", several=field.kind == "floats")
    try:
        if "_" in text:  # Python reads 1_00 as a hundred
            raise ValueError
        if field.kind == "float":
            return _number(field, text)
        if field.kind == "int":
            return int(text)
        return tuple(_number(field, part) for part in text.replace(";", ",").split(",") if part.strip())
    except ValueError:
        raise InputError.expected(field.label, _WANTED[field.kind], repr(text), "correct this value") from None


def means(field: Field, text: str, value: Any) -> bool:
    """Return whether ``text`` represents ``value`` in any notation, such as "5.0" for 5."""
    try:
        if field.read is not None and isinstance(value, str):
            return bool(field.read(text) == field.read(value))
        return bool(parse(field, text) == value)
    except InputError:
        return False


def same(field: Field, one: Any, other: Any) -> bool:
    """Return whether two values of a field are equal as displayed."""
    if field.kind in ("choice", "bool"):
        return bool(one == other)
    text = text_of(field, one)
    return text == text_of(field, other) or (bool(text) and means(field, text, other))


def _number(field: Field, text: str) -> float:
    """Return the stored number; raise `ValueError` for one that a project file cannot store."""
    value = float(f"{float(text) * field.scale:.15g}")  # 28.3 ms are 0.0283 s
    if math.isnan(value) or (math.isinf(value) and not field.endless):
        raise ValueError
    return value


KINDS = {bool: "bool", float: "float", int: "int"}


def fields_of(record: type, *, without: Iterable[str] = (), more: bool | None = None) -> tuple[Field, ...]:
    """Return the fields of a form for a record.

    Parameters
    ----------
    record
        Class of the record.
    without
        Names of fields to omit, because other widgets show them.
    more
        True: only rarely needed fields. False: only the others. None: all.
    """
    held = set(without)
    chosen = (row for row in rows(record) if row.name not in held and more in (None, row.opt.more))
    return tuple(_field(row) for row in chosen)


def _field(row: FieldRow) -> Field:
    opt = row.opt
    # several names are typed as a text
    names = () if opt.read is read_names else row.choices
    choices: tuple[tuple[Any, str], ...] = tuple((name, name or opt.empty) for name in names)
    if row.kind is bool and row.optional:
        choices = ((True, "yes"), (False, "no"))
    if choices and row.default not in dict(choices):
        words = f"default ({opt.empty})" if opt.empty in row.choices else opt.empty or "default"
        choices = ((row.default, words), *choices)
    kind = "choice" if choices else "text" if opt.read or row.many else KINDS.get(row.kind, "text")
    share = opt.read is read_share
    notes = [part for part in ("0.03 or 3 %" if share else opt.unit, opt.range_words) if part]
    tip = f"{opt.help.removesuffix('.')} ({'; '.join(notes)})." if notes else opt.help
    empty = opt.empty or ("" if row.default is MISSING else text_in_form(row, row.default))
    return Field(
        row.name,
        row.label,
        "" if share else opt.unit,
        tip,
        kind,
        choices=choices,
        optional=row.optional,
        empty=empty,
        read=(lambda text: _value(row, text)) if opt.read or row.many else None,
        default=UNKNOWN if row.default is MISSING else _shown(row, row.default),
        group=row.panel,
        file="All files (*)" if opt.file == "in" and not row.many else "",
    )


def shown_of(record: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a form displays in each field, by field name: the entry in ``values``, or else the default."""
    return {row.name: _shown(row, values.get(row.name, row.default)) for row in rows(record)}


def _shown(row: FieldRow, value: Any) -> Any:
    if row.many and isinstance(value, tuple):
        return "; ".join(map(row.text, value))
    plain = row.opt.read is None and (KINDS.get(row.kind) or row.choices)
    return value if plain else text_in_form(row, value)


def text_in_form(row: FieldRow, value: Any) -> str:
    """Return the text of a value in a form: as on the command line, but fractions in per cent and spaced numbers."""
    if row.opt.read is read_share and isinstance(value, int | float):
        return show_share(value)
    text = row.text(value)
    return BETWEEN.sub(", ", text) if isinstance(value, tuple) else text


def _value(row: FieldRow, given: Any) -> Any:
    """Return the value of an entry, in which semicolons separate several values."""
    if row.many and isinstance(given, str):
        given = [one.strip() for one in given.split(";") if one.strip()]
    return row.value(given, row.label)


def value_in(record: type, key: str, given: Any) -> Any:
    """Return the value of a form entry in the form that the record stores."""
    return _value(next(row for row in rows(record) if row.name == key), given)


def check_of(record: type) -> Callable[[str, Any], str]:
    """Return a function that gives the reason why a value is refused (empty: accepted), for the ``check`` of a form."""
    named = {row.name: row for row in rows(record)}

    def check(key: str, value: Any) -> str:
        try:
            _value(named[key], value)
        except InputError as error:
            return str(error)
        return ""

    return check


def options_in(record: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a form in the form that the record stores, without those at their defaults."""
    named = {row.name: row for row in rows(record)}
    found = {key: _value(named[key], value) for key, value in given.items()}
    return {key: value for key, value in found.items() if value != named[key].default}
