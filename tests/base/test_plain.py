"""JSON text of unknown origin: its value, or one line."""

from __future__ import annotations

import json

import pytest

from lfcal.base._plain import MAX_NESTING, parse_json
from lfcal.base.errors import FileFormatError

GOOD = [None, True, 1, -2.5, "ä 😀", [1, [2.0, "x"]], {"a": {"b": [1, 2]}}, 2**63 - 1, -(2**63), [], {}]


@pytest.mark.parametrize("value", GOOD)
def test_values_are_read(value: object) -> None:
    assert parse_json(json.dumps(value), "a.json") == value
    assert parse_json(json.dumps(value, ensure_ascii=False), "a.json") == value


BAD = {
    "nothing": ("", "Expecting value"),
    "an open list": ("[1, 2", "Expecting"),
    "more after the end": ("{} x", "Extra data"),
    "NaN": ('{"a": NaN}', "the number NaN"),
    "infinity": ("-Infinity", "the number -Infinity"),
    "a number beyond floats": ("[1e999]", "the number 1e999"),
    "a number beyond 64 bits": ("[9223372036854775808]", "the number 9223372036854775808"),
    "a number of 5000 digits": ("9" * 5000, "the number 999"),
    "an entry twice": ('{"a": 1, "b": 2, "a": 3}', "'a' more than once"),
    "nesting that ends the parser": ("[" * 100_000 + "]" * 100_000, "lists nested too deeply"),
    "nesting that ends what comes after": ("[" * 600 + "]" * 600, f"more than {MAX_NESTING} levels of nested lists"),
    "objects in objects": ('{"a":' * 200 + "1" + "}" * 200, f"more than {MAX_NESTING} levels of nested lists"),
    "half a character": (r'{"name": "\ud800"}', "invalid Unicode"),
    "a control character": ('"a\x01"', "Invalid control character"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_relied_on_is_one_line(case: str) -> None:
    text, words = BAD[case]
    with pytest.raises(FileFormatError, match=words) as caught:
        parse_json(text, "a.json", remedy="take another")
    message = str(caught.value)
    assert message.startswith("a.json: expected JSON text, got ") and message.endswith("; take another")
    assert len(message) < 300


def test_the_deepest_that_is_read() -> None:
    text = "[" * MAX_NESTING + "]" * MAX_NESTING
    assert parse_json(text, "a.json") == json.loads(text)
    with pytest.raises(FileFormatError):
        parse_json(f"[{text}]", "a.json")
