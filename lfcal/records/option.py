"""Fields that users set, each declared once. Commands, forms, job files, scripts and provenance follow from them.

A field is an attribute of a frozen dataclass, declared by `opt`, or by `required` if it has no default. `panel`
declares a nested record. `one_of` declares a nested record of one of several kinds, which have different fields. `rows`
returns the fields of a record and of its nested records, in order.
"""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any, TypeVar, Union, cast, get_args, get_origin

from lfcal.base import InputError, any_of, check_choice, check_number, choose
from lfcal.records.reading import read_as

__all__ = [
    "FieldRow",
    "Opt",
    "Variants",
    "check_needs",
    "check_record",
    "described_by",
    "flat",
    "from_dict",
    "from_flat",
    "one_of",
    "opt",
    "panel",
    "record",
    "required",
    "rows",
    "rows_of",
    "to_dict",
    "value_at",
]

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])
PLAIN = (bool, int, float, str, Path)
WORDS: dict[type, str] = {
    float: "a number",
    int: "a whole number",
    str: "text",
    Path: "a path",
    bool: "true or false",
}
"""Names of plain types in messages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opt:
    """Attributes of a record's field in addition to its name, type and default.

    Attributes
    ----------
    help
        Help text of one or two sentences for the command line, the form and the reference.
    label
        Name in forms and tables; empty: derived from the field's name.
    unit
        Unit of the value; empty: none.
    choices
        Allowed names, or a function that returns them; empty: any.
    examples
        Values that a shell or a form suggests, or a function that returns them; other values are also allowed.
    above, below, at_least, at_most
        Range of a number.
    flag, short
        Command-line option (by default ``--`` followed by the name), and its one-letter form.
    argument
        Whether the command takes the value as a positional argument.
    more
        Whether the field is advanced: it is listed last in ``--help`` and collapsed in forms.
    empty
        Text that states what applies if the field is not set.
    read, show
        Functions for a value that is not of a plain type: ``read`` parses a text, and ``show`` returns a value as
        text. Without ``show``, the values of a tuple are given and parsed separately.
    chooses
        Whether setting the field selects one of the variants of a task. A flag with this attribute is never False.
    file
        For a path: ``"in"`` or ``"out"``.
    is_path
        Function that decides whether a text is a path: a camera, for example, is a preset or a file.
    needs
        Name of another field of the same record that must be set for this field to have an effect. The second entry is
        the value that it must have (empty: any). If the name is empty, the value is a suffix that an input file must
        have.
    """

    help: str
    label: str = ""
    unit: str = ""
    choices: Callable[[], tuple[str, ...]] | tuple[str, ...] = ()
    examples: Callable[[], tuple[str, ...]] | tuple[str, ...] = ()
    above: float | None = None
    below: float | None = None
    at_least: float | None = None
    at_most: float | None = None
    flag: str = ""
    short: str = ""
    argument: bool = False
    more: bool = False
    empty: str = ""
    read: Callable[[str], Any] | None = None
    show: Callable[[Any], str] | None = None
    chooses: bool = False
    file: str = ""
    is_path: Callable[[str], bool] = "none".__ne__
    needs: tuple[str, str] | None = None

    @property
    def bounds(self) -> dict[str, Any]:
        """The range as keyword arguments of `lfcal.base.check_number`."""
        names = ("above", "below", "at_least", "at_most")
        return {name: bound for name in names if (bound := getattr(self, name)) is not None}

    @property
    def range_words(self) -> str:
        """The range as text, such as ``> 0, < 1``; empty if there is none."""
        signs = {"above": ">", "at_least": "≥", "below": "<", "at_most": "≤"}
        return ", ".join(f"{signs[name]} {self.bounds[name]:g}" for name in signs if name in self.bounds)

    def described(self, default: str = "") -> str:
        """Return the help text with the unit, the range, the choices and ``default`` in brackets.

        ``default`` is the default value as text; empty: not stated. Choices that a function returns are left out.
        """
        choices = ", ".join(filter(None, self.choices)) if isinstance(self.choices, tuple) else ""
        notes = [part for part in (self.unit, self.range_words, choices, default and f"default: {default}") if part]
        return self.help + (f" ({'; '.join(notes)})" if notes else "")


def opt(default: T, help: str, **more: Any) -> T:
    """Declare a field of a record with its default and help text; ``more`` contains further attributes of `Opt`."""
    return dataclasses.field(default=default, metadata={"opt": Opt(help=help, **more)})


def required(help: str, **more: Any) -> Any:
    """Declare a field of a record without a default; ``more`` contains further attributes of `Opt`."""
    return dataclasses.field(metadata={"opt": Opt(help=help, **more)})


def panel(default: T, title: str, without: tuple[str, ...] = ()) -> T:
    """Declare a nested record, by default ``default``.

    ``title`` is the heading of its fields in forms. ``without`` contains the names of fields to omit.
    """
    return dataclasses.field(default=default, metadata={"panel": (title, without)})


@dataclass(frozen=True)
class Variants:
    """Kinds of a nested record; the value of one of its fields selects the kind.

    A field that several kinds share is declared identically in all of them.

    Attributes
    ----------
    kinds
        Kinds whose fields are known in advance, the default first.
    by
        Name of the field that states the kind. Every kind has this field, whose default is the name of the kind.
    find
        Function that returns the kind with a name, even if it is not in ``kinds``, and raises `InputError` for unknown
        names.
    names
        Function that returns the names of all kinds.
    """

    kinds: tuple[type, ...]
    by: str
    find: Callable[[str], type]
    names: Callable[[], tuple[str, ...]]

    def name_of(self, kind: type) -> str:
        """Return the name of ``kind``: the default of its field `by`."""
        return str(_defaults(kind)[self.by])


def one_of(default: T, title: str, variants: Variants) -> T:
    """Declare a nested record that is of one of several kinds, by default ``default``.

    ``title`` is the heading of its fields in forms.
    """
    return dataclasses.field(default=default, metadata={"panel": (title, ()), "variants": variants})


@typing.dataclass_transform(frozen_default=True, kw_only_default=True)
def record(kind: type[T]) -> type[T]:
    """Make a class a frozen dataclass with keyword-only fields, and list them with their help in its docstring."""
    made = dataclass(frozen=True, kw_only=True)(kind)
    said, mark, examples = inspect.cleandoc(made.__doc__ or "").partition("\nExamples\n")
    lines = ["", "Attributes", "----------"]
    for field in dataclasses.fields(cast(Any, made)):
        if "opt" in field.metadata:
            lines += [field.name, _indented(field.metadata["opt"].described())]
        elif "panel" in field.metadata:
            variants = field.metadata.get("variants")
            kinds = variants.kinds if variants else (type(field.default),)
            names = ", ".join(f"`{kind.__name__}`" for kind in kinds)
            lines += [field.name, f"    {field.metadata['panel'][0]}: {names}."]
    made.__doc__ = said.rstrip() + "\n" + "\n".join(lines) + "\n" + mark + examples
    return made


_BEFORE_UNIT = re.compile(r"(?<=\d) (?=\S{1,4}(?:\s|$))")
"""Space between a number and what may be its unit."""


def _indented(text: str) -> str:
    """Return a text as an indented paragraph; no line ends between a number and its unit."""
    kept = _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", text)
    filled = textwrap.fill(kept, 100, initial_indent="    ", subsequent_indent="    ")
    return filled.replace("\N{NO-BREAK SPACE}", " ")


@dataclass(frozen=True, slots=True)
class FieldRow:
    """A field of a record or of a nested record, with its path from the outermost record.

    Attributes
    ----------
    path
        Field names from the outermost record to this field.
    kind
        Plain type of the values of the field; ``str`` for values that only ``opt.read`` can parse.
    optional, many
        Whether None is allowed, and whether the value is a tuple of elements of type ``kind``.
    default
        Default value; `dataclasses.MISSING` if there is none.
    opt
        Help, label, unit, range and choices of the field.
    panel
        Heading above the field in forms; empty for the outermost record.
    variants, only
        For a nested record of several kinds: all kinds, and the names of those that have the field (empty: all).
    """

    path: tuple[str, ...]
    kind: type
    optional: bool
    many: bool
    default: Any
    opt: Opt
    panel: str
    variants: Variants | None = None
    only: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """Name of the field, which is unique within the whole record."""
        return self.path[-1]

    @property
    def flag(self) -> str:
        """Command-line option of the field. For a flag that is on by default, the option that turns it off."""
        return self.opt.flag or f"--{'no-' * self.turns_off}{self.name.replace('_', '-')}"

    @property
    def turns_off(self) -> bool:
        """Whether the field is a flag that is on by default, so that its option turns it off."""
        return self.default is True and not self.opt.chooses

    @property
    def off(self) -> str:
        """Option that turns off a flag that may be None; empty for other fields."""
        return f"--no-{self.name.replace('_', '-')}" if self.kind is bool and self.optional else ""

    @property
    def called(self) -> str:
        """Name of the field on the command line: its option, or its name in capitals for a positional argument."""
        return self.name.upper() if self.opt.argument else self.flag

    def paths_of(self, value: Any) -> tuple[Path, ...]:
        """Return the paths in ``value``, a value of the field or a tuple of values; empty if it contains none."""
        every = value if isinstance(value, tuple) else (value,)
        return tuple(Path(one) for one in every if self.opt.file and one and self.opt.is_path(str(one)))

    def placed(self, value: Any, place: Callable[[Path], Any]) -> Any:
        """Return ``value`` with each of its paths replaced by ``place(path)``."""
        if isinstance(value, tuple):
            return tuple(self.placed(one, place) for one in value)
        return self.kind(place(Path(value))) if self.paths_of(value) else value

    @property
    def label(self) -> str:
        """Name of the field in forms and tables."""
        return self.opt.label or self.name.replace("_", " ").capitalize()

    @property
    def described(self) -> str:
        """Help text of the field with its unit, range, choices and default; the default of a flag is not stated."""
        shown = self.default is not MISSING and self.kind is not bool
        return self.opt.described(self.opt.empty or self.text(self.default) if shown else "")

    @property
    def option_help(self) -> str:
        """Help text for the command line; that of an option that turns a flag off begins with "Do not"."""
        said = self.described
        return f"Do not {said[0].lower()}{said[1:]}" if self.turns_off else said

    @property
    def choices(self) -> tuple[str, ...]:
        """Allowed names; empty: any."""
        return self.opt.choices() if callable(self.opt.choices) else self.opt.choices

    @property
    def offered(self) -> tuple[str, ...]:
        """Values to suggest to users: the examples, or else the choices."""
        examples = self.opt.examples() if callable(self.opt.examples) else self.opt.examples
        return examples or self.choices

    @property
    def empty(self) -> Any:
        """Value of the field if the user leaves it empty: None if that is allowed, else the default."""
        return None if self.optional else self.default

    def text(self, value: Any) -> str:
        """Return ``value`` as text for the command line and for forms; empty for None."""
        if value is None:
            return ""
        text = self.opt.show(value) if self.opt.show else str(value)
        return text.removesuffix(".0") if isinstance(value, float) else text

    def value(self, given: Any, called: str) -> Any:
        """Return the value of the field from ``given``, a text or an entry of a file; messages call it ``called``.

        The value is `empty` if ``given`` is None, or an empty string that is not itself a value of the field.

        Raises
        ------
        InputError
            If a required value is missing, or ``given`` cannot be parsed or is not allowed.
        """
        found = self._value(given, called)
        self.check(found, called)
        return found

    def _value(self, given: Any, called: str) -> Any:
        nothing = isinstance(given, str) and not given.strip()
        if given is None or (nothing and (self.kind is not str or (self.optional and self.opt.read is not None))):
            if self.default is MISSING and not self.optional:
                raise InputError.expected(called, "a value", "none", "state this value")
            return self.empty
        if self.many:
            return tuple(self._one(one, called) for one in (given if isinstance(given, list | tuple) else (given,)))
        return self._one(given, called)

    def _one(self, given: Any, called: str) -> Any:
        if self.opt.read is not None and self.opt.show is not None and isinstance(given, list | tuple):
            given = self.opt.show(tuple(given))  # a list may hold no value that a text could not express
        if self.opt.read is not None and isinstance(given, str):
            return read_as(called, self.opt.read, given)
        if isinstance(given, list):
            return tuple(tuple(one) if isinstance(one, list) else one for one in given)
        if self.opt.read is not None:
            return given
        return self._plain(given, called)

    def _plain(self, given: Any, called: str) -> Any:
        kind = self.kind
        if isinstance(given, str | Path) and (kind is Path or (kind is str and self.opt.file)):
            return kind(given)
        if isinstance(given, str) and kind in (int, float):
            try:
                return int(given) if kind is int else float(given)
            except ValueError:
                self.check(given, called)  # for a number with a range, the message names the range
                raise InputError.expected(called, WORDS[kind], repr(given), "correct this value") from None
        kinds = (int, float) if kind is float else (kind,)
        if not isinstance(given, kinds) or isinstance(given, bool) is not (kind is bool):
            raise InputError.expected(called, WORDS[kind], repr(given), "correct this value")
        return given

    def check(self, value: Any, called: str) -> None:
        """Raise `InputError` unless ``value`` is within the range and among the choices; messages call it ``called``.

        The default and empty values need not be among the choices. A flag that selects a variant must not be False.
        """
        if self.opt.chooses and value is False:
            raise InputError.expected(called, "true", "false", "leave it out")
        for one in value if isinstance(value, tuple) else (value,):
            if self.opt.bounds and one is not None:
                check_number(called, one, integer=self.kind is int, **self.opt.bounds)
            if one and one != self.default and self.choices:
                check_choice(called, one, self.choices)


_KNOWN: dict[type, tuple[FieldRow, ...]] = {}


def rows(kind: type) -> tuple[FieldRow, ...]:
    """Return the fields of the record class ``kind`` and of its nested records, in the order of declaration."""
    if kind not in _KNOWN:  # a dictionary, because mypy does not know that the type is hashable
        _KNOWN[kind] = tuple(_rows(kind, (), "", ()))
    return _KNOWN[kind]


def _rows(kind: type, path: tuple[str, ...], heading: str, without: tuple[str, ...]) -> Iterator[FieldRow]:
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(cast(Any, kind)):
        here = (*path, field.name)
        if field.name in without:
            continue
        if "variants" in field.metadata:
            yield from _rows_of_kinds(field.metadata["variants"], here, field.metadata["panel"][0])
        elif "panel" in field.metadata:
            yield from _rows(type(field.default), here, *field.metadata["panel"])
        elif "opt" in field.metadata:
            one: Opt = field.metadata["opt"]
            kind_of, optional, many = _kind(hints[field.name])
            yield FieldRow(here, kind_of, optional, many and one.show is None, field.default, one, heading)


def _rows_of_kinds(variants: Variants, path: tuple[str, ...], heading: str) -> Iterator[FieldRow]:
    """Yield the fields of all kinds, those of the default kind first."""
    first: dict[str, FieldRow] = {}
    having: dict[str, list[str]] = {}
    for kind in variants.kinds:
        for row in _rows(kind, path, heading, ()):
            first.setdefault(row.name, row)
            having.setdefault(row.name, []).append(variants.name_of(kind))
    for row in first.values():
        said = dataclasses.replace(row.opt, examples=variants.names) if row.name == variants.by else row.opt
        names = having[row.name]
        only = () if len(names) == len(variants.kinds) else tuple(names)
        yield dataclasses.replace(row, opt=said, variants=variants, only=only)


def described_by(kind: type) -> Callable[[F], F]:
    """Return a decorator that documents the parameters of a function with the help texts of the fields of ``kind``.

    It applies to parameters that are named like a field, and inserts them before the others.
    """

    def add(function: F) -> F:
        said, mark, more = inspect.cleandoc(function.__doc__ or "").partition("Parameters\n----------\n")
        known = {row.name: row for row in rows(kind)}
        lines = [
            f"{name} : {function.__annotations__[name]}\n{_indented(known[name].described)}\n"
            for name in inspect.signature(function).parameters
            if name in known
        ]
        function.__doc__ = "".join([said, mark, *lines, more])
        return function

    return add


def rows_of(whole: Any) -> tuple[FieldRow, ...]:
    """Return the fields of the record ``whole`` and of its nested records.

    Of a nested record of several kinds, only the fields of its current kind are returned.
    """
    return tuple(row for row in rows(type(whole)) if row.variants is None or _has(whole, row))


def _has(whole: Any, row: FieldRow) -> bool:
    for name in row.path[:-1]:
        whole = getattr(whole, name)
    return hasattr(whole, row.name)


def _defaults(kind: type) -> dict[str, Any]:
    return {field.name: field.default for field in dataclasses.fields(cast(Any, kind))}


def _kind(hint: Any) -> tuple[type, bool, bool]:
    """Return the plain type, whether None is allowed, and whether there are several values."""
    parts = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    kinds = [part for part in parts if part is not type(None)]
    many = get_origin(kinds[0]) is tuple and get_args(kinds[0])[-1] is Ellipsis
    kind = get_args(kinds[0])[0] if many else next((k for k in kinds if k in PLAIN), str)
    return kind, type(None) in parts, many


def value_at(whole: Any, row: FieldRow) -> Any:
    """Return the value of the field ``row`` in the record ``whole``."""
    for name in row.path:
        whole = getattr(whole, name)
    return whole


def check_record(whole: Any) -> None:
    """Raise `InputError` if a value is out of its range, not among its choices, or would have no effect."""
    known = rows_of(whole)
    for row in known:
        row.check(value_at(whole, row), row.name)
    check_needs(known, {row.name: value_at(whole, row) for row in known}, lambda row: row.name)
    for field in dataclasses.fields(whole):
        inner = getattr(whole, field.name)
        for name in field.metadata.get("panel", ("", ()))[1]:
            if getattr(inner, name) != _defaults(type(inner))[name]:
                raise InputError.expected(
                    f"{field.name}.{name}", "its default", repr(getattr(inner, name)), "leave it out"
                )


def check_needs(known: tuple[FieldRow, ...], values: Mapping[str, Any], called: Callable[[FieldRow], str]) -> None:
    """Raise `InputError` for the first value that has no effect because of the value of another field.

    ``known`` contains the fields, ``values`` maps field names to values, and ``called`` returns the name of a field for
    messages. A value equal to its default counts as not set, unless the chosen kind of record lacks the field.
    """
    paths = {row.path: row for row in known}
    for row in known:
        if row.variants is not None and row.name in values:
            _check_kind(row, paths[(*row.path[:-1], row.variants.by)], values, called)
        if row.opt.needs is None or values.get(row.name, row.default) == row.default:
            continue
        name, wanted = row.opt.needs
        if not name:
            _check_suffix(called(row), known, values, wanted)
            continue
        other = paths[(*row.path[:-1], name)]
        value = values.get(name, other.default)
        if value != wanted if wanted else not value:
            got = "none" if value is False else other.text(value) or other.opt.empty or "none"
            words = wanted or ("above 0" if other.kind in (int, float) else "")
            raise InputError.expected(called(row), f"{called(other)} {words}".strip(), got, f"leave {called(row)} out")


def _check_suffix(called: str, known: tuple[FieldRow, ...], values: Mapping[str, Any], suffix: str) -> None:
    """Raise `InputError` unless an input file has the suffix."""
    paths = [path for row in known if row.opt.file == "in" for path in row.paths_of(values.get(row.name))]
    if not any(path.suffix.lower() == suffix for path in paths):
        names = ", ".join(path.name for path in paths)
        raise InputError.expected(called, f"a {suffix} file", names or "none", f"leave {called} out")


def _check_kind(row: FieldRow, by: FieldRow, values: Mapping[str, Any], called: Callable[[FieldRow], str]) -> None:
    """Raise `InputError` if the kind of record named by the value of ``by`` does not have a field."""
    assert row.variants is not None
    name = values.get(by.name, by.default)
    if row.name not in _defaults(row.variants.find(name)):
        names = row.only or tuple(row.variants.name_of(kind) for kind in row.variants.kinds)
        raise InputError.expected(called(row), f"{called(by)} {any_of(names)}", name, f"leave {called(row)} out")


def to_dict(whole: Any) -> dict[str, Any]:
    """Return a record as a dictionary of plain JSON types with all fields; nested records become dictionaries."""
    found: dict[str, Any] = {}
    for row in rows_of(whole):
        place = found
        for name in row.path[:-1]:
            place = place.setdefault(name, {})
        place[row.name] = _plain(value_at(whole, row))
    return found


def _plain(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_plain(one) for one in value]
    return str(value) if isinstance(value, Path) else value


def from_dict(kind: type[T], data: Mapping[str, Any], what: str = "") -> T:
    """Return a record of class ``kind`` from a dictionary in the form of `to_dict`; missing entries get their defaults.

    ``what`` is the name of the record in messages; empty: that of the class.

    Raises
    ------
    InputError
        If an entry is unknown or missing, or a value is not allowed.
    """
    return from_flat(kind, flat(rows(kind), data, what or kind.__name__))


def flat(known: tuple[FieldRow, ...], data: Mapping[str, Any], what: str, fields: str = "its fields") -> dict[str, Any]:
    """Return the checked values of the nested dictionary ``data`` by field name.

    ``known`` contains the allowed fields. An error for an unknown entry refers to the record as ``what``, and states
    ``fields`` as what was expected. Required fields that are None, and flags that choose a kind but are off, are left
    out.
    """
    found: dict[str, Any] = {}
    paths = {row.path: row for row in known}

    def visit(part: Mapping[str, Any], path: tuple[str, ...]) -> None:
        for name, value in part.items():
            here = (*path, name)
            called, row = ".".join(here), paths.get(here)
            if isinstance(value, Mapping):
                visit(value, here)
            elif row is None:
                raise InputError.expected(what, fields, called, choose(called, map(".".join, paths)))
            elif not (value is None and row.default is MISSING) and not (row.opt.chooses and value is False):
                found[name] = row.value(value, called)

    visit(data, ())
    return found


def from_flat(kind: type[T], values: Mapping[str, Any]) -> T:
    """Return a record of class ``kind``, given the values by field name, including those of nested records."""
    given: dict[str, Any] = {}
    inner: dict[str, dict[str, Any]] = {}
    for row in rows(kind):
        if row.name in values:
            (given if len(row.path) == 1 else inner.setdefault(row.path[0], {}))[row.name] = values[row.name]
        elif row.default is MISSING:
            raise InputError.expected(row.called, "a value", "none", "give it")
    check_needs(tuple(row for row in rows(kind) if row.variants), values, lambda row: row.name)
    parts = {
        field.name: _part(field, inner[field.name])
        for field in dataclasses.fields(cast(Any, kind))
        if field.name in inner
    }
    return kind(**given, **parts)


def _part(field: Any, own: Mapping[str, Any]) -> Any:
    """Return the nested record that has the values ``own``."""
    default, variants = field.default, field.metadata.get("variants")
    if variants is not None:
        chosen = variants.find(own.get(variants.by, getattr(default, variants.by)))
        if chosen is not type(default):
            return chosen(**own)
    return dataclasses.replace(default, **own)
