"""Conversion of values to plain JSON types, and strict parsing of JSON text."""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lfcal.base.errors import FileFormatError

__all__ = ["parse_json", "plain", "stated_format"]

MAX_NESTING = 50
"""Largest nesting depth of lists and objects; lfcal files have 6 levels."""


def plain(value: Any) -> Any:
    """Return ``value`` as JSON types: arrays as lists, dataclasses as objects, NaN and infinity as null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if hasattr(
        value, "tolist"
    ):  # numpy arrays and numbers, without importing numpy, which most commands do not load at the start
        return plain(value.tolist())
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(v) for v in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Path):
        return str(value)
    return value


def parse_json(text: str, what: str, *, remedy: str = "check the file", finite: bool = True) -> Any:
    """Return the value of JSON ``text``; ``what`` names it in messages.

    The parser is stricter than `json.loads`, so that invalid values are found here and not later. NaN, infinity,
    numbers beyond 64 bits, duplicate entries, nesting beyond `MAX_NESTING` levels, and invalid Unicode are refused.
    With ``finite`` false, NaN and infinity are accepted.

    Raises
    ------
    FileFormatError
        If the text is not valid.
    """

    def refuse(got: str) -> FileFormatError:
        return FileFormatError.expected(what, "JSON text", got, remedy)

    def real(token: str) -> float:
        value = float(token)
        if finite and not math.isfinite(value):
            raise refuse(f"the number {token}")
        return value

    def whole(token: str) -> int:
        # an integer of more than 20 characters exceeds 64 bits
        if len(token) > 20 or not -(1 << 63) <= (value := int(token)) < 1 << 63:
            raise refuse(f"the number {token}")
        return value

    def entries(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        value = dict(pairs)
        if len(value) < len(pairs):
            count = Counter(name for name, _ in pairs)
            raise refuse(f"the entry {count.most_common(1)[0][0]!r} more than once")
        return value

    try:
        value = json.loads(text, parse_float=real, parse_int=whole, parse_constant=real, object_pairs_hook=entries)
    except FileFormatError:
        raise
    # deeply nested text raises RecursionError, not ValueError
    except RecursionError:
        raise refuse("lists nested too deeply to be read") from None
    except ValueError as error:
        raise refuse(f"other text ({error})") from None
    if _deeper_than(value, MAX_NESTING):
        raise refuse(f"more than {MAX_NESTING} levels of nested lists")
    # half a surrogate pair cannot be encoded
    if re.search(r"\\u[dD][89a-fA-F]", text) and not _is_unicode(value):
        raise refuse("invalid Unicode characters")
    return value


def stated_format(data: object) -> str:
    """Return the format and version that the content of a JSON file states, in words for a message."""
    if not isinstance(data, Mapping) or "format" not in data:
        return 'a file without the entry "format"'
    version = f", version {data['version']}" if "version" in data else ""
    return f'"format": "{data["format"]}"{version}'


def _deeper_than(value: Any, levels: int) -> bool:
    """Return whether lists and objects are nested too deeply, without recursion."""
    level = [value] if isinstance(value, dict | list) else []
    for _ in range(levels):
        parts = (part for inner in level for part in (inner.values() if isinstance(inner, dict) else inner))
        level = [part for part in parts if isinstance(part, dict | list)]
        if not level:
            return False
    return True


def _is_unicode(value: Any) -> bool:
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        return False
    return True
