"""Fields of forms made of fields of records: labels, units, choices, tips and checks are declared once. No Qt."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING
from typing import Any

from lfcal.base import InputError
from lfcal.records import FieldRow, read_names, read_share, rows, show_share
from lfcal_gui.models.form import UNKNOWN, Field

__all__ = ["check_of", "fields_of", "options_in", "shown_of", "text_in_form", "value_in"]

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
    # of several names a text is typed
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
    # of what is on by default, the help says what turning it off does
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
