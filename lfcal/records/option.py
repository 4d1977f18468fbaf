"""Fields that people set, declared once: command line, form, job file, script and provenance are made of them.

A field is an attribute of a frozen dataclass that is declared by `opt`, or by `required` where it has no default.
`panel` declares a record within a record, and `one_of` one of several kinds, each with other fields. `rows` gives
the fields of a record and of those within it, in order.
"""

from __future__ import annotations

import dataclasses
import inspect
import textwrap
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any, TypeVar, Union, cast, get_args, get_origin

from lfcal.base import InputError, check_choice, check_number, choose
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
"""What values of a plain type are called in messages."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Opt:
    """What people should know of a field besides its name, type and default.

    Attributes
    ----------
    help
        One or two sentences, for the command line, the form and the reference.
    label
        Name in forms and tables; by default made of the field's name.
    unit
        Unit of the value; empty: none.
    choices
        Names that it may have, or a function that returns them; empty: any.
    examples
        Values that a shell offers, and a form, where others are possible as well.
    above, below, at_least, at_most
        Range of a number.
    flag, short
        Option of the command line (by default ``--`` and the name), and its one-letter form.
    argument
        Whether the command takes it by its place, without an option.
    more
        Whether it is rarely needed: it comes last in ``--help`` and is folded in forms.
    empty
        What applies if it is not set, in words.
    read, show
        Of a value that is none of the plain types: what a text means, and the text of a value. Of a tuple without
        ``show`` each value is given separately, and read.
    chooses
        Whether giving it chooses the kind of a task. A flag of this sort is True in the kinds that have it.
    file
        Of a path: ``"in"`` or ``"out"``.
    is_path
        Of a text that may be a path, such as a preset or a camera file: whether it is one.
    needs
        Another field of the same record without which it has no effect, and the value that this must have; an empty
        value: any that is set. Or an empty name and a suffix, which the name of an input file must have.
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
        """The range, by the parameters of `lfcal.base.check_number`."""
        names = ("above", "below", "at_least", "at_most")
        return {name: bound for name in names if (bound := getattr(self, name)) is not None}

    @property
    def range_words(self) -> str:
        """The range in words: ``> 0, < 1``; empty: none."""
        signs = {"above": ">", "at_least": "≥", "below": "<", "at_most": "≤"}
        return ", ".join(f"{signs[name]} {self.bounds[name]:g}" for name in signs if name in self.bounds)

    def described(self, default: str = "") -> str:
        """Return the help with unit, range, choices and the text of the default."""
        choices = ", ".join(self.choices) if isinstance(self.choices, tuple) else ""
        notes = [part for part in (self.unit, self.range_words, choices, default and f"default: {default}") if part]
        return self.help + (f" ({'; '.join(notes)})" if notes else "")


def opt(default: T, help: str, **more: Any) -> T:
    """Declare a field with its default; ``more`` are attributes of `Opt`."""
    return dataclasses.field(default=default, metadata={"opt": Opt(help=help, **more)})


def required(help: str, **more: Any) -> Any:
    """Declare a field that must be given; ``more`` are attributes of `Opt`."""
    return dataclasses.field(metadata={"opt": Opt(help=help, **more)})


def panel(default: T, title: str, without: tuple[str, ...] = ()) -> T:
    """Declare a record within a record: the heading of its fields, and those that are not asked for here."""
    return dataclasses.field(default=default, metadata={"panel": (title, without)})


@dataclass(frozen=True)
class Variants:
    """Kinds of a record within a record, of which the value of one field decides.

    A field that several kinds have is declared alike in all of them.

    Attributes
    ----------
    kinds
        Those whose fields are known beforehand, the default first.
    by
        The field that names the kind; every kind has it, with its own name as the default.
    find
        Returns the kind of a name, which may be none of ``kinds``; raises `InputError` where there is none.
    names
        Returns the names of all kinds.
    """

    kinds: tuple[type, ...]
    by: str
    find: Callable[[str], type]
    names: Callable[[], tuple[str, ...]]

    def name_of(self, kind: type) -> str:
        """Return the name of a kind."""
        return str(_defaults(kind)[self.by])


def one_of(default: T, title: str, variants: Variants) -> T:
    """Declare a record within a record that is one of several kinds: the heading of their fields, and the kinds."""
    return dataclasses.field(default=default, metadata={"panel": (title, ()), "variants": variants})


@typing.dataclass_transform(frozen_default=True, kw_only_default=True)
def record(kind: type[T]) -> type[T]:
    """Make a frozen dataclass of fields by name, whose docstring lists them with their help."""
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


def _indented(text: str) -> str:
    return textwrap.fill(text, 100, initial_indent="    ", subsequent_indent="    ")


@dataclass(frozen=True, slots=True)
class FieldRow:
    """A field as it is reached from the outermost record.

    Attributes
    ----------
    path
        Names that lead to it.
    kind
        Type of its values, a plain one; of those that only ``opt.read`` understands ``str``.
    optional, many
        Whether None is a value, and whether a value is a tuple of ``kind``.
    default
        `dataclasses.MISSING`: it has none.
    opt
        What people should know of it.
    panel
        Heading that it is under; empty: that of the outermost record.
    variants, only
        Of a record that is one of several kinds: these kinds, and the names of those that have the field; no names:
        all of them.
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
        """Its own name, which no other field of the whole record has."""
        return self.path[-1]

    @property
    def flag(self) -> str:
        """Its option of the command line; of what is on by default the one that turns it off."""
        return self.opt.flag or f"--{'no-' * self.turns_off}{self.name.replace('_', '-')}"

    @property
    def turns_off(self) -> bool:
        """Whether its option turns off what is on by default."""
        return self.default is True and not self.opt.chooses

    @property
    def off(self) -> str:
        """Its second option, which turns off what is neither on nor off by default; else empty."""
        return f"--no-{self.name.replace('_', '-')}" if self.kind is bool and self.optional else ""

    @property
    def called(self) -> str:
        """What the command line calls it."""
        return self.name.upper() if self.opt.argument else self.flag

    def paths_of(self, value: Any) -> tuple[Path, ...]:
        """Return the paths in a value."""
        every = value if isinstance(value, tuple) else (value,)
        return tuple(Path(one) for one in every if self.opt.file and one and self.opt.is_path(str(one)))

    def placed(self, value: Any, place: Callable[[Path], Any]) -> Any:
        """Return a value with each of its paths where ``place`` says it is."""
        if isinstance(value, tuple):
            return tuple(self.placed(one, place) for one in value)
        return self.kind(place(Path(value))) if self.paths_of(value) else value

    @property
    def label(self) -> str:
        """Its name in forms and tables."""
        return self.opt.label or self.name.replace("_", " ").capitalize()

    @property
    def described(self) -> str:
        """Its help, with unit, range, choices and default."""
        shown = self.default is not MISSING and self.kind is not bool
        return self.opt.described(self.opt.empty or self.text(self.default) if shown else "")

    @property
    def choices(self) -> tuple[str, ...]:
        """Names that it may have; empty: any."""
        return self.opt.choices() if callable(self.opt.choices) else self.opt.choices

    @property
    def offered(self) -> tuple[str, ...]:
        """Values to offer where one is typed."""
        examples = self.opt.examples() if callable(self.opt.examples) else self.opt.examples
        return examples or self.choices

    @property
    def empty(self) -> Any:
        """The value of a field that is left empty."""
        return None if self.optional else self.default

    def text(self, value: Any) -> str:
        """Return the text of ``value`` on a command line and in a form."""
        if value is None:
            return ""
        text = self.opt.show(value) if self.opt.show else str(value)
        return text.removesuffix(".0") if isinstance(value, float) else text

    def value(self, given: Any, called: str) -> Any:
        """Return what a text, or a value of a file, means; ``called`` names it in messages.

        Raises
        ------
        InputError
            If it means nothing, or nothing that is allowed.
        """
        found = self._value(given, called)
        self.check(found, called)
        return found

    def _value(self, given: Any, called: str) -> Any:
        nothing = isinstance(given, str) and not given.strip()
        if given is None or (nothing and (self.kind is not str or (self.optional and self.opt.read is not None))):
            if self.default is MISSING and not self.optional:
                raise InputError.expected(called, "a value", "none", "give it")
            return self.empty
        if self.many:
            return tuple(self._one(one, called) for one in (given if isinstance(given, list | tuple) else (given,)))
        return self._one(given, called)

    def _one(self, given: Any, called: str) -> Any:
        if self.opt.read is not None and self.opt.show is not None and isinstance(given, list | tuple):
            given = self.opt.show(tuple(given))  # what a text cannot mean, a list cannot either
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
                self.check(given, called)  # a number within a range is what is expected
                raise InputError.expected(called, WORDS[kind], repr(given), "correct this value") from None
        kinds = (int, float) if kind is float else (kind,)
        if not isinstance(given, kinds) or isinstance(given, bool) is not (kind is bool):
            raise InputError.expected(called, WORDS[kind], repr(given), "correct this value")
        return given

    def check(self, value: Any, called: str) -> None:
        """Raise `InputError` unless ``value`` is within the range and among the choices."""
        if self.opt.chooses and value is False:
            raise InputError.expected(called, "true", "false", "leave it out")
        for one in value if isinstance(value, tuple) else (value,):
            if self.opt.bounds and one is not None:
                check_number(called, one, integer=self.kind is int, **self.opt.bounds)
            if one and one != self.default and self.choices:
                check_choice(called, one, self.choices)


_KNOWN: dict[type, tuple[FieldRow, ...]] = {}


def rows(kind: type) -> tuple[FieldRow, ...]:
    """Return the fields of a record and of those within it, in order."""
    if kind not in _KNOWN:  # functools.cache would want a type that mypy knows is hashable
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
    """Yield the fields of all kinds, those of the default first."""
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
    """Return what adds the fields of a record to the docstring of a function that has them as parameters."""

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
    """Return the fields that a record has: of one within it that is one of several kinds, those of its kind."""
    return tuple(row for row in rows(type(whole)) if row.variants is None or _has(whole, row))


def _has(whole: Any, row: FieldRow) -> bool:
    for name in row.path[:-1]:
        whole = getattr(whole, name)
    return hasattr(whole, row.name)


def _defaults(kind: type) -> dict[str, Any]:
    return {field.name: field.default for field in dataclasses.fields(cast(Any, kind))}


def _kind(hint: Any) -> tuple[type, bool, bool]:
    """Return the plain type, whether None is allowed, and whether there are many."""
    parts = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    kinds = [part for part in parts if part is not type(None)]
    many = get_origin(kinds[0]) is tuple and get_args(kinds[0])[-1] is Ellipsis
    kind = get_args(kinds[0])[0] if many else next((k for k in kinds if k in PLAIN), str)
    return kind, type(None) in parts, many


def value_at(whole: Any, row: FieldRow) -> Any:
    """Return the value of a field in a record."""
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
    """Raise `InputError` for the first value that has no effect without a value of another field.

    ``values`` by the names of fields; one that is at its default counts as not given, unless its kind of record
    does not have the field.
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
            raise InputError.expected(called(row), f"{called(other)} {words}".strip(), got, "leave it out")


def _check_suffix(called: str, known: tuple[FieldRow, ...], values: Mapping[str, Any], suffix: str) -> None:
    """Raise `InputError` unless an input file has the suffix."""
    paths = [path for row in known if row.opt.file == "in" for path in row.paths_of(values.get(row.name))]
    if not any(path.suffix.lower() == suffix for path in paths):
        names = ", ".join(path.name for path in paths)
        raise InputError.expected(called, f"a {suffix} file", names or "none", "leave it out")


def _check_kind(row: FieldRow, by: FieldRow, values: Mapping[str, Any], called: Callable[[FieldRow], str]) -> None:
    """Raise `InputError` where the kind of record that the value of ``by`` names does not have a field."""
    assert row.variants is not None
    name = values.get(by.name, by.default)
    if row.name not in _defaults(row.variants.find(name)):
        names = row.only or tuple(row.variants.name_of(kind) for kind in row.variants.kinds)
        raise InputError.expected(called(row), f"{called(by)} {' or '.join(names)}", name, "leave it out")


def to_dict(whole: Any) -> dict[str, Any]:
    """Return a record as plain JSON types, every field of it, with records within it as objects."""
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
    """Return the record that `to_dict`, or a hand, wrote.

    Raises
    ------
    InputError
        For an entry that the record does not have, or a value that it cannot have.
    """
    return from_flat(kind, flat(rows(kind), data, what or kind.__name__))


def flat(known: tuple[FieldRow, ...], data: Mapping[str, Any], what: str, fields: str = "its fields") -> dict[str, Any]:
    """Return the values in nested objects by the names of their fields; errors name ``what`` and its ``fields``.

    What must be given and is null, and a flag that would choose the kind of a task and is off, are left out.
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
    """Return the record of values by the names of fields, those within records among them."""
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
    """Return the record within a record that has the values ``own``."""
    default, variants = field.default, field.metadata.get("variants")
    if variants is not None:
        chosen = variants.find(own.get(variants.by, getattr(default, variants.by)))
        if chosen is not type(default):
            return chosen(**own)
    return dataclasses.replace(default, **own)
