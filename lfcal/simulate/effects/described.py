"""Read and write effects as text: magnitudes with their units, as in command lines and JSON files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from lfcal.base import FileFormatError, InputError, any_of, check_choice, read_text
from lfcal.simulate.effects import CATALOGUE, Effect
from lfcal.simulate.effects.magnitudes import GIVEN, TRIPLES, Magnitude, kind_of, magnitudes_of, number_in, units_of

__all__ = [
    "SETTINGS",
    "Entry",
    "Magnitude",
    "effect_entries",
    "effect_from",
    "effect_words",
    "entries_json",
    "magnitudes_of",
    "parse_effects",
    "parse_entries",
    "read_entries",
]

SETTINGS = ("auto", "on", "off")

MEASURED = " measured"
"""Suffix of a magnitude that was measured; others are stated."""


@dataclass(frozen=True, slots=True)
class Entry:
    """Entry for one effect in a text or a file.

    Attributes
    ----------
    effect
        The effect with its magnitudes; None if the entry contains only a setting.
    name
        Name of the effect.
    given
        Mapping from the names of the fields given in the entry to ``"stated"`` or ``"measured"``.
    setting
        ``"auto"``, ``"on"`` or ``"off"``.
    """

    effect: Effect | None
    name: str
    given: Mapping[str, str] = field(default_factory=dict)
    setting: str = "auto"


def parse_effects(items: Sequence[str]) -> tuple[dict[str, str], tuple[Effect, ...]]:
    """Return settings by name, and effects with magnitudes, from texts and files; see `effect_entries`.

    If a name occurs several times, its last setting and its last magnitudes count.
    """
    settings: dict[str, str] = {}
    given: dict[str, Effect] = {}
    for entry in effect_entries(items):
        if entry.effect is not None:
            given[entry.name] = entry.effect
        if entry.effect is None or entry.setting != "auto":
            settings[entry.name] = entry.setting
    return settings, tuple(given.values())


def effect_entries(items: Sequence[str]) -> tuple[Entry, ...]:
    """Return an entry for each effect or setting in texts and files.

    Parameters
    ----------
    items
        Each item is ``NAME=on``, ``NAME=off`` or ``NAME=auto``, or ``NAME=VALUE``, or the path of a JSON file of
        effects (`read_entries`). ``VALUE`` is the first magnitude, with ``@`` before a direction (``coma=0.3@40deg``),
        or a list of named magnitudes (``drift=rows:2um,columns:1um``). A magnitude may be followed by the word
        measured: ``coma=0.3 measured``.

    Raises
    ------
    InputError
        If an effect or magnitude is unknown, or a value is invalid.
    """
    found: list[Entry] = []
    for item in items:
        name, sign, text = (part.strip() for part in item.partition("="))
        if not sign and item.strip().lower().endswith(".json"):
            found += read_entries(item.strip())
        elif not sign:
            raise InputError.expected(
                "effect",
                "NAME=on, off, auto or a magnitude, or a JSON file",
                repr(item),
                "write name and value in the form coma=0.3@40deg",
            )
        else:
            found.append(Entry(None, name, setting=text) if text in SETTINGS else _from_words(name, text))
    return tuple(found)


def effect_words(entries: Iterable[Entry]) -> tuple[str, ...]:
    """Return entries as texts for `effect_entries`: the given magnitudes and the setting of each effect.

    The setting ``"auto"`` is left out.
    """
    words = []
    for entry in entries:
        parts = []
        given = ((key, mark, getattr(entry.effect, key)) for key, mark in entry.given.items())
        for key, mark, value in (one for one in given if one[2] != ()):
            triples = isinstance(value, tuple)
            text = ";".join(",".join(map(str, three)) for three in value) if triples else f"{key}:{value}"
            parts.append(text + (MEASURED if mark == "measured" else ""))
        words += [f"{entry.name}={','.join(parts)}"] if parts else []
        words += [f"{entry.name}={entry.setting}"] if entry.setting != "auto" else []
    return tuple(words)


def parse_entries(path: str | os.PathLike[str]) -> tuple[dict[str, str], tuple[Effect, ...]]:
    """Return settings by name, and effects with magnitudes, from a JSON file.

    Settings ``"auto"`` are left out. The errors are those of `read_entries`.
    """
    entries = read_entries(path)
    settings = {entry.name: entry.setting for entry in entries if entry.setting != "auto"}
    return settings, tuple(entry.effect for entry in entries if entry.effect is not None)


def read_entries(path: str | os.PathLike[str]) -> tuple[Entry, ...]:
    """Return the entries in a JSON file, which contains a list such as ``[{"name": "coma", "waves": 0.3}]``.

    The file may also contain an object with this list as ``"effects"``. Besides the magnitudes, an entry may contain
    ``"setting"`` (``"on"``, ``"off"`` or ``"auto"``), and ``"sources"``, which marks magnitudes as ``"measured"``
    instead of ``"stated"``: ``{"waves": "measured"}``.

    Raises
    ------
    FileFormatError
        If the file contains no such list.
    InputError
        If an effect, magnitude, setting or source is unknown, or a value is invalid.
    """
    source = Path(path)
    wanted = 'a list of effects, such as [{"name": "coma", "waves": 0.3}]'
    try:
        data = json.loads(read_text(source))
    except (ValueError, RecursionError):
        raise FileFormatError.expected(str(source), wanted, "text that is not JSON", "correct the file") from None
    if isinstance(data, dict):
        data = data.get("effects")
    if not isinstance(data, list) or not all(
        isinstance(one, dict) and isinstance(one.get("name"), str) for one in data
    ):
        raise FileFormatError.expected(str(source), wanted, "JSON of another form", "correct the file")
    return tuple(_entry(one) for one in data)


def _entry(data: Mapping[str, Any]) -> Entry:
    name, setting, sources = data["name"], data.get("setting", "auto"), data.get("sources", {})
    check_choice(f"setting of {name}", setting, SETTINGS)
    magnitudes = {key: value for key, value in data.items() if key not in ("name", "setting", "sources")}
    effect = effect_from(name, magnitudes)
    given = {key: "stated" for key, value in magnitudes.items() if value is not None}
    if not isinstance(sources, dict) or any(sources[key] not in GIVEN or key not in given for key in sources):
        wanted = 'stated or measured for each magnitude of the entry, such as {"waves": "measured"}'
        raise InputError.expected(f"sources of {name}", wanted, str(sources)[:60], "correct the sources")
    return Entry(None if "setting" in data and not magnitudes else effect, name, given | sources, setting)


def entries_json(entries: Iterable[Entry]) -> str:
    """Return the text of a JSON file for `read_entries`.

    It contains the given magnitudes, which of them were measured, and settings other than ``"auto"``.
    """
    listed = []
    for entry in entries:
        one: dict[str, Any] = {"name": entry.name}
        one |= {key: getattr(entry.effect, key) for key in entry.given}
        measured = {key: mark for key, mark in entry.given.items() if mark != "stated"}
        listed.append(
            one
            | ({"sources": measured} if measured else {})
            | ({"setting": entry.setting} if entry.setting != "auto" else {})
        )
    return json.dumps(listed, indent=2, allow_nan=False) + "\n"


def effect_from(name: str, magnitudes: Mapping[str, Any]) -> Effect:
    """Return the effect ``name`` with the given ``magnitudes``; the others have their defaults.

    ``magnitudes`` maps the names of fields to values in the units of the fields.

    Raises
    ------
    InputError
        If the effect or a magnitude is unknown, or a value has the wrong type or is outside its limits.
    """
    kind = CATALOGUE.get(name)
    known = {field.name: str(field.type) for field in fields(kind)}  # type: ignore[arg-type]  # effects are dataclasses
    for key in magnitudes:
        if key not in known:
            raise InputError.expected(f"magnitude of {name}", any_of(known) or "none", key, "choose one of these names")
    values = {key: _frozen(f"{key} of {name}", known[key], value) for key, value in magnitudes.items()}
    return kind(**values)


def _frozen(what: str, kind: str, value: Any) -> Any:
    """Return a value from a file in the form of a field of type ``kind``; raise an error if it is not a magnitude."""
    triples = f"triples ({TRIPLES[kind][0]})" if kind in TRIPLES else ""
    if triples and isinstance(value, list | tuple):
        try:
            return tuple((_whole(n), _whole(m), float(w)) for n, m, w in value)
        except (TypeError, ValueError, OverflowError):
            raise InputError.expected(what, triples, str(value)[:60], "correct this value") from None
    if isinstance(value, str) and kind.startswith("str"):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and not (triples or kind.startswith("str")):
        if kind_of(kind) != "whole":
            return value
        try:
            return _whole(value)
        except (ValueError, OverflowError):
            raise InputError.expected(what, "a whole number", repr(value)[:60], "round this value") from None
    if value is None and kind.endswith("None"):
        return value
    wanted = "a text" if kind.startswith("str") else triples or "a number"
    raise InputError.expected(what, wanted, repr(value)[:60], "correct this value")


def _whole(value: Any) -> int:
    """Return an integer as such; raise `ValueError` for any other value."""
    if value != int(value):
        raise ValueError
    return int(value)


def _from_words(name: str, text: str) -> Entry:
    kind = CATALOGUE.get(name)
    known = {field.name: str(field.type) for field in fields(kind)}  # type: ignore[arg-type]
    if not known:
        raise InputError.expected(
            f"effect {name}",
            "on, off or auto",
            repr(text),
            "write one of these words, because this effect has no magnitude",
        )
    first = next(iter(known))
    if known[first] in TRIPLES:
        text, mark = _marked(text)
        return Entry(effect_from(name, {first: _terms(name, text, *TRIPLES[known[first]])}), name, {first: mark})
    main, sign, direction = text.partition("@")
    parts = dict(_parts(main, first))
    if sign:
        parts["angle"] = direction
    found, marks = {}, {}
    for word, value in parts.items():
        key = _field(name, word, known)
        value, marks[key] = _marked(value)
        found[key] = value if known[key].startswith("str") else _value(kind, key, value)
    return Entry(effect_from(name, found), name, marks)


def _marked(text: str) -> tuple[str, str]:
    """Return a magnitude, and how it is known."""
    text = text.strip()
    value = text.removesuffix(MEASURED).strip()
    return value, "stated" if value == text else "measured"


def _parts(text: str, first: str) -> Iterable[tuple[str, str]]:
    for part in text.split(","):
        key, sign, value = part.partition(":")
        yield (key.strip(), value) if sign else (first, part)


def _field(name: str, word: str, known: Mapping[str, str]) -> str:
    """Return the field that a word means: its name, with or without the unit that it ends with."""
    if word in known:
        return word
    found = [key for key in known if word == key.rpartition("_")[0]]
    if not found:
        raise InputError.expected(f"magnitude of {name}", any_of(known), repr(word), "choose one of these names")
    return found[0]


def _value(kind: type[Effect], key: str, text: str) -> float:
    """Return a number in the unit of the field ``key``."""
    return number_in(f"{key} of {kind.name}", text, units_of(kind, key))


def _terms(name: str, text: str, three: str, example: str) -> list[list[float]]:
    """Return the triples in a text such as ``n,m,waves;n,m,waves``; ``three`` names the numbers of a triple."""
    try:
        terms = [[float(v) for v in part.split(",")] for part in text.split(";") if part.strip()]
    except ValueError:
        terms = []
    if not terms or any(len(term) != 3 for term in terms):
        raise InputError.expected(
            f"terms of {name}", f"{three};{three}", repr(text), f"write it in this form: {example}"
        )
    return terms
