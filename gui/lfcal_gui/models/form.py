"""Fields of forms: what is shown of a value, what a typed text means, and fields made of records. No Qt."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass
from typing import Any

from lfcal.base import InputError, check_commas
from lfcal.records import FieldRow, read_names, read_share, rows, show_share

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


DIGITS = 6
"""Significant digits of a number that is shown and not typed."""


def rounded(text: str) -> str:
    """Return a number with at most so many digits as are read at a glance; any other text is unchanged."""
    try:
        value = float(text)
    except ValueError:
        return text
    short = f"{value:.{DIGITS}g}"
    return short if len(short) < len(text) else text


def parse(field: Field, text: str) -> Any:
    """Return the stored value that ``text`` means; raise a one-line `InputError` if it has none.

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


KINDS = {bool: "bool", float: "float", int: "int"}


def fields_of(record: type, *, without: Iterable[str] = (), more: bool | None = None) -> tuple[Field, ...]:
    """Return the entries of a form for a record.

    Parameters
    ----------
    record
        Its class.
    without
        Names of fields that other widgets show.
    more
        Whether to return only those that are rarely needed, or only the others; None: all.
    """
    held = set(without)
    chosen = (row for row in rows(record) if row.name not in held and more in (None, row.opt.more))
    return tuple(_field(row) for row in chosen)


def _field(row: FieldRow) -> Field:
    opt = row.opt
    # several names are typed as a text
    names = () if opt.read is read_names else row.choices
    choices: tuple[tuple[Any, str], ...] = tuple((name, name) for name in names)
    if row.kind is bool and row.optional:
        choices = ((True, "yes"), (False, "no"))
    if choices and row.default not in dict(choices):
        words = f"default ({opt.empty})" if opt.empty in row.choices else opt.empty or "default"
        choices = ((row.default, words), *choices)
    kind = "choice" if choices else "text" if opt.read or row.many else KINDS.get(row.kind, "text")
    share = opt.read is read_share
    notes = [part for part in ("0.03 or 3 %" if share else opt.unit, opt.range_words) if part]
    # if a value is on by default, its help describes turning it off
    tip = ("Off: " if row.turns_off else "") + opt.help + (f" ({'; '.join(notes)})" if notes else "")
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
    """Return what a form shows: ``values`` by the names of their fields, and the defaults of all others."""
    return {row.name: _shown(row, values.get(row.name, row.default)) for row in rows(record)}


def _shown(row: FieldRow, value: Any) -> Any:
    if row.many and isinstance(value, tuple):
        return "; ".join(map(row.text, value))
    plain = row.opt.read is None and (KINDS.get(row.kind) or row.choices)
    return value if plain else text_in_form(row, value)


def text_in_form(row: FieldRow, value: Any) -> str:
    """Return the text of a value in a form: as on a command line, but shares in per cent."""
    if row.opt.read is read_share and isinstance(value, int | float):
        return show_share(value)
    return row.text(value)


def _value(row: FieldRow, given: Any) -> Any:
    """Return what an entry means; several values in one entry have a semicolon between them."""
    if row.many and isinstance(given, str):
        given = [one.strip() for one in given.split(";") if one.strip()]
    return row.value(given, row.label)


def value_in(record: type, key: str, given: Any) -> Any:
    """Return the value of an entry as the record has it."""
    return _value(next(row for row in rows(record) if row.name == key), given)


def check_of(record: type) -> Callable[[str, Any], str]:
    """Return what says why a value of a field is refused; empty: it is not. It is the ``check`` of a form."""
    named = {row.name: row for row in rows(record)}

    def check(key: str, value: Any) -> str:
        try:
            _value(named[key], value)
        except InputError as error:
            return str(error)
        return ""

    return check


def options_in(record: type, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a form as the record has them; those at their defaults are left out."""
    named = {row.name: row for row in rows(record)}
    found = {key: _value(named[key], value) for key, value in given.items()}
    return {key: value for key, value in found.items() if value != named[key].default}
