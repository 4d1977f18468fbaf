"""The part of JSON Schema (draft 2020-12) used in the schema of the H file, with two additions.

``dimensions`` names each axis of a dataset, or the length of a list; ``extents`` names the numbers of a list. A name
represents the same number throughout a matrix: the first dataset that has it defines it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

__all__ = ["Deviation", "deviations"]

Schema = Mapping[str, Any]
Place = tuple[str | int, ...]

_TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "number": (int, float),
}


class Deviation(NamedTuple):
    """A deviation from a schema: its place in the value, as names and indices from the top level, and what is wrong."""

    place: Place
    what: str


def deviations(value: Any, schema: Schema) -> Iterator[Deviation]:
    """Yield every deviation of ``value`` (plain JSON types) from ``schema``."""
    yield from _Check(schema).look(value, schema, (), {})


class _Check:
    def __init__(self, root: Schema) -> None:
        self._root = root
        self._rules: dict[str, Callable[..., Iterator[Deviation]]] = {
            "allOf": self._all,
            "properties": self._properties,
            "additionalProperties": self._additional,
            "items": self._items,
            "prefixItems": self._prefix,
        }

    def look(self, value: Any, schema: Schema, place: Place, names: dict[str, int]) -> Iterator[Deviation]:
        """Yield the deviations of ``value`` at ``place``; ``names`` are the sizes known so far."""
        if "$ref" in schema:
            # a definition describes another matrix, which has separate sizes
            yield from self.look(value, self._definition(schema["$ref"]), place, {})
            return
        wrong = [what for what in _own_faults(value, schema, names) if what]
        yield from (Deviation(place, what) for what in wrong)
        if isinstance(value, dict):
            lacking = [key for key in schema.get("required", ()) if key not in value]
            yield from (Deviation((*place, key), "missing") for key in lacking)
        for keyword, rule in self._rules.items():
            if keyword in schema:
                yield from rule(value, schema, place, names)

    def _definition(self, reference: str) -> Schema:
        found: Any = self._root
        for part in reference.removeprefix("#/").split("/"):
            found = found[part]
        schema: Schema = found
        return schema

    def _all(self, value: Any, schema: Schema, place: Place, names: dict[str, int]) -> Iterator[Deviation]:
        for part in schema["allOf"]:
            yield from self.look(value, part, place, names)

    def _properties(self, value: Any, schema: Schema, place: Place, names: dict[str, int]) -> Iterator[Deviation]:
        # in the order of the schema: H comes first and defines the sizes
        for key, part in schema["properties"].items() if isinstance(value, dict) else ():
            if key in value:
                yield from self.look(value[key], part, (*place, key), names)

    def _additional(self, value: Any, schema: Schema, place: Place, names: dict[str, int]) -> Iterator[Deviation]:
        for key in value if isinstance(value, dict) else ():
            if key not in schema.get("properties", {}):
                yield from self.look(value[key], schema["additionalProperties"], (*place, key), names)

    def _items(self, value: Any, schema: Schema, place: Place, names: dict[str, int]) -> Iterator[Deviation]:
        for k, one in enumerate(value) if isinstance(value, list) else ():
            yield from self.look(one, schema["items"], (*place, k), names)

    def _prefix(self, value: Any, schema: Schema, place: Place, names: dict[str, int]) -> Iterator[Deviation]:
        for k, (one, part) in enumerate(zip(value, schema["prefixItems"], strict=False)):
            yield from self.look(one, part, (*place, k), names)


def _own_faults(value: Any, schema: Schema, names: dict[str, int]) -> Iterator[str]:
    """Yield the deviations of ``value`` itself, without those of its parts."""
    if "type" in schema and not (isinstance(value, _TYPES[schema["type"]]) and not isinstance(value, bool)):
        yield f"expected {schema['type']}, got {_shown(value)}"
        return
    if "const" in schema and value != schema["const"]:
        yield f"expected {_shown(schema['const'])}, got {_shown(value)}"
    if "enum" in schema and value not in schema["enum"]:
        yield f"expected {' or '.join(map(str, schema['enum']))}, got {_shown(value)}"
    if "minimum" in schema and value < schema["minimum"]:
        yield f"expected {schema['minimum']} or more, got {_shown(value)}"
    if "not" in schema and not list(_denied(value, schema["not"])):
        yield f"expected any value except {_words(schema['not'])}, got {_shown(value)}"
    if schema.get("contentMediaType") == "application/json" and not _is_json(value):
        yield f"expected JSON, got {_shown(value)}"
    if "dimensions" in schema:
        shape = value.get("shape", []) if isinstance(value, dict) else list(np.shape(value))
        yield _sizes_fault("shape", shape, schema["dimensions"], names)
    if "extents" in schema and isinstance(value, list):
        yield _sizes_fault("sizes", value, schema["extents"], names)


def _denied(value: Any, schema: Schema) -> Iterator[str]:
    """Yield the name of each rule inside a ``not`` that ``value`` does not satisfy, as the schema requires."""
    if "const" in schema and value != schema["const"]:
        yield "const"
    if "multipleOf" in schema and value % schema["multipleOf"]:
        yield "multipleOf"


def _words(schema: Schema) -> str:
    return f"a multiple of {schema['multipleOf']}" if "multipleOf" in schema else _shown(schema["const"])


def _sizes_fault(what: str, sizes: list[int], wanted: list[str | int], names: dict[str, int]) -> str:
    """Return the deviation of ``sizes`` in words, empty if there is none; they define names that have no size yet."""
    reported = f"({', '.join(map(str, wanted))})"
    if len(sizes) != len(wanted):
        return f"expected {what} {reported}, got {tuple(sizes)}"
    for name, size in zip(wanted, sizes, strict=True):
        if isinstance(name, str):
            names.setdefault(name, size)
    if {"nt", "ns"} <= names.keys():
        names.setdefault("mask_bytes", -(-names["nt"] * names["ns"] // 8))
    numbers = [names[name] if isinstance(name, str) else name for name in wanted]
    return "" if numbers == list(sizes) else f"expected {what} {reported} = {tuple(numbers)}, got {tuple(sizes)}"


def _is_json(value: Any) -> bool:
    try:
        json.loads(value)
    except (ValueError, RecursionError):
        return False
    return True


def _shown(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:60]}…"
