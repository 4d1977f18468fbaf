"""Effects in words and in files: magnitudes with their units, as command lines and JSON files give them."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from lfcal.errors import FileFormatError, InputError
from lfcal.files import read_text
from lfcal.simulate.effects import CATALOGUE, Effect

__all__ = ["SETTINGS", "effect_from", "parse_effects", "read_effects"]

SETTINGS = ("auto", "on", "off")

LENGTHS = {"": 1.0, "um": 1.0, "µm": 1.0, "nm": 1e-3, "mm": 1e3}
ANGLES = {"": 1.0, "rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180}
SHARES = {"": 1.0, "%": 0.01}
NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([a-zµ%]*)")


TRIPLES = {"Wavefront": ("n,m,waves", "4,0,0.1;3,1,0.05"), "Defects": ("row,column,transmission", "0,0,0;1,-2,0.4")}
"""Kinds of magnitudes that are lists of three numbers: what the three are, and an example."""


def parse_effects(items: Sequence[str]) -> tuple[dict[str, str], tuple[Effect, ...]]:
    """Return settings by name, and effects with magnitudes, from words and files.

    Parameters
    ----------
    items
        ``NAME=on``, ``off`` or ``auto``; ``NAME=VALUE``, for example ``coma=0.3@40deg``, ``lenslet_gap=5um`` or
        ``drift=rows:2um,columns:1um``: the first magnitude, or named ones, ``@`` being the direction; or a JSON file of
        effects (`read_effects`). Of one name the last counts.

    Raises
    ------
    InputError
        For an unknown effect or magnitude, or a value that is none.
    """
    settings: dict[str, str] = {}
    given: dict[str, Effect] = {}
    for item in items:
        name, sign, text = (part.strip() for part in item.partition("="))
        if not sign and item.strip().lower().endswith(".json"):
            given |= {effect.name: effect for effect in read_effects(item.strip())}
        elif not sign:
            raise InputError.expected(
                "effect", "NAME=on, off, auto or a magnitude, or a JSON file", repr(item), "for example coma=0.3@40deg"
            )
        elif text in SETTINGS:
            settings[name] = text
        else:
            given[name] = _from_words(name, text)
    return settings, tuple(given.values())


def read_effects(path: str | os.PathLike[str]) -> tuple[Effect, ...]:
    """Return the effects of a JSON file: a list of ``{"name": "coma", "waves": 0.3}``, as H's provenance has them.

    Raises
    ------
    FileFormatError
        If the file holds no such list.
    InputError
        For an unknown effect or magnitude.
    """
    source = Path(path)
    wanted = 'a list of effects, as [{"name": "coma", "waves": 0.3}]'
    try:
        data = json.loads(read_text(source))
    except (ValueError, RecursionError):
        raise FileFormatError.expected(str(source), wanted, "no JSON", "correct the file") from None
    if isinstance(data, dict):
        data = data.get("effects")
    if not isinstance(data, list) or not all(
        isinstance(one, dict) and isinstance(one.get("name"), str) for one in data
    ):
        raise FileFormatError.expected(str(source), wanted, "something else", "correct the file")
    return tuple(effect_from(one["name"], {key: value for key, value in one.items() if key != "name"}) for one in data)


def effect_from(name: str, magnitudes: Mapping[str, Any]) -> Effect:
    """Return the effect ``name`` with ``magnitudes`` by field, in the units of its fields; others are the catalogue's.

    Raises
    ------
    InputError
        For an unknown effect or magnitude, or a value out of its limits.
    """
    kind = CATALOGUE.get(name)
    known = {field.name: str(field.type) for field in fields(kind)}  # type: ignore[arg-type]  # effects are dataclasses
    for key in magnitudes:
        if key not in known:
            raise InputError.expected(f"magnitude of {name}", " or ".join(known) or "none", key, "correct it")
    values = {key: _frozen(f"{key} of {name}", known[key], value) for key, value in magnitudes.items()}
    return kind(**values)


def _frozen(what: str, kind: str, value: Any) -> Any:
    """Return a value of a file as a field of type ``kind`` holds it; raise where it is no magnitude."""
    triples = f"triples ({TRIPLES[kind][0]})" if kind in TRIPLES else ""
    if triples and isinstance(value, list | tuple):
        try:
            found = tuple((int(n), int(m), float(w)) for n, m, w in value)
            # what is no whole number is not to become one silently
            if any(a != n or b != m for (a, b, _), (n, m, _) in zip(found, value, strict=True)):
                raise ValueError
        except (TypeError, ValueError, OverflowError):
            raise InputError.expected(what, triples, str(value)[:60], "correct it") from None
        return found
    if isinstance(value, str) and kind.startswith("str"):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and not (triples or kind.startswith("str")):
        return value
    if value is None and kind.endswith("None"):
        return value
    wanted = "a text" if kind.startswith("str") else triples or "a number"
    raise InputError.expected(what, wanted, repr(value)[:60], "correct it")


def _from_words(name: str, text: str) -> Effect:
    kind = CATALOGUE.get(name)
    known = {field.name: str(field.type) for field in fields(kind)}  # type: ignore[arg-type]
    if not known:
        raise InputError.expected(f"effect {name}", "on, off or auto", repr(text), "it has no magnitude of its own")
    first = next(iter(known))
    if known[first] in TRIPLES:
        return effect_from(name, {first: _terms(name, text, *TRIPLES[known[first]])})
    main, sign, direction = text.partition("@")
    parts = dict(_parts(main, first))
    if sign:
        parts["angle"] = direction
    found = {}
    for word, value in parts.items():
        key = _field(name, word, known)
        found[key] = value.strip() if known[key].startswith("str") else _value(f"{key} of {name}", key, value)
    return effect_from(name, found)


def _parts(text: str, first: str) -> Iterable[tuple[str, str]]:
    for part in text.split(","):
        key, sign, value = part.partition(":")
        yield (key.strip(), value) if sign else (first, part)


def _field(name: str, word: str, known: Mapping[str, str]) -> str:
    """Return the field that a word means: its name, with or without the unit that it ends with."""
    found = [key for key in known if word == key or word == key.rpartition("_")[0]]
    if not found:
        raise InputError.expected(f"magnitude of {name}", " or ".join(known), repr(word), "correct it")
    return found[0]


def _value(what: str, key: str, text: str) -> float:
    """Return a number in the unit of the field ``key``, which its name ends with."""
    units = LENGTHS if key.endswith("_um") else ANGLES if key.endswith("_rad") else SHARES
    match = NUMBER.fullmatch(text.strip())
    if match is None or match[2] not in units:
        allowed = ", ".join(unit for unit in units if unit)
        raise InputError.expected(what, f"a number, with {allowed} or no unit", repr(text), "for example 0.3")
    value = float(match[1]) * units[match[2]]
    # whole numbers of blades stay such
    return int(value) if key == "blades" and value == int(value) else value


def _terms(name: str, text: str, three: str, example: str) -> list[list[float]]:
    """Return the terms of ``n,m,waves;n,m,waves``, or what else the ``three`` are."""
    try:
        terms = [[float(v) for v in part.split(",")] for part in text.split(";") if part.strip()]
    except ValueError:
        terms = []
    if not terms or any(len(term) != 3 for term in terms):
        raise InputError.expected(f"terms of {name}", f"{three};{three}", repr(text), f"for example {example}")
    return terms
