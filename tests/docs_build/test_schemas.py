"""The published JSON Schemas of camera, plan and session agree with the records and with files of lfcal."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from docs_build.schemas import schemas, text_of
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import LfcalError
from lfcal.camera import PRESETS, Camera, ScanPlan, preset
from tests.acquire.rigs import small_plan
from tests.architecture.sources import ROOT

MADE = {path.name.split("-")[1]: schema for path, schema in schemas().items()}
TYPES: dict[str, tuple[type, ...]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "number": (int, float),
    "integer": (int,),
    "boolean": (bool,),
    "null": (type(None),),
}
KEYWORDS = {"type", "properties", "required", "additionalProperties", "items", "minItems", "maxItems", "anyOf", "enum"}
WORDS = {"$schema", "$id", "$defs", "$ref", "title", "description", "const"}


def wrong(value: Any, schema: Any, root: Any) -> bool:
    """Return whether a value deviates from a schema, by the rules of draft 2020-12 for the keywords that occur."""
    assert set(schema) <= KEYWORDS | WORDS
    if "$ref" in schema:
        return wrong(value, root["$defs"][schema["$ref"].rpartition("/")[2]], root)
    if "anyOf" in schema:
        return all(wrong(value, one, root) for one in schema["anyOf"])
    if "const" in schema or "enum" in schema:
        return value not in schema.get("enum", [schema.get("const")])
    is_flag = isinstance(value, bool) and schema["type"] != "boolean"
    if is_flag or not isinstance(value, TYPES[schema["type"]]):
        return True
    if isinstance(value, list):
        few, most = schema.get("minItems", 0), schema.get("maxItems", len(value))
        return not few <= len(value) <= most or any(wrong(one, schema["items"], root) for one in value)
    if not isinstance(value, dict):
        return False
    known, rest = schema.get("properties", {}), schema.get("additionalProperties")
    return (
        not set(schema.get("required", ())) <= set(value)
        or (rest is False and not set(value) <= set(known))
        or any(wrong(one, known.get(name, rest), root) for name, one in value.items())
    )


def files() -> Iterator[tuple[str, Any]]:
    """Yield the kind and the content of files, as lfcal writes them."""
    for name in PRESETS:
        yield "camera", preset(name).to_dict()
    yield "plan", small_plan().to_dict()
    for path in sorted((ROOT / "sample_data").rglob("session.json")):
        yield "session", json.loads(path.read_text())


FILES = [(kind, json.loads(json.dumps(value))) for kind, value in files()]
READ = {"camera": Camera.from_dict, "plan": ScanPlan.from_dict}


def test_the_published_files_are_those_of_the_records() -> None:
    """If not: ``python -m docs_build.schemas``."""
    for path, schema in schemas().items():
        assert path.read_text(encoding="utf-8") == text_of(schema), path


def test_files_of_lfcal_have_no_deviation() -> None:
    assert {kind for kind, _ in FILES} == {"camera", "plan", "session"}
    for kind, value in FILES:
        assert not wrong(value, MADE[kind], MADE[kind]), kind


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    for key, one in value.items() if isinstance(value, dict) else ():
        yield (*at, key)
        yield from places(one, (*at, key))


@pytest.mark.parametrize("kind", ["camera", "plan"])
def test_what_the_schema_refuses_lfcal_refuses(kind: str) -> None:
    """Each entry is left out, misspelt, and given a value of another type; the schema finds all three."""
    for _, value in [pair for pair in FILES if pair[0] == kind][:3]:
        for *before, last in places(value):
            for change in ("missing", "misspelt", "another type"):
                other = copy.deepcopy(value)
                entries = other
                for key in before:
                    entries = entries[key]
                if before[-1:] == ["marks"]:
                    change = "another type"
                old = entries.pop(last)
                if change != "missing":
                    entries[last if change == "another type" else f"{last}_"] = {"odd": old}
                assert wrong(other, MADE[kind], MADE[kind]), (*before, last, change)
                with pytest.raises(LfcalError):
                    READ[kind](other)


def test_a_session_of_the_schema_is_read(tmp_path: Path) -> None:
    for kind, value in FILES:
        if kind == "session":
            (tmp_path / "session.json").write_text(json.dumps(value))
            SessionFile.read(tmp_path)
            assert wrong({**value, "more": 1}, MADE[kind], MADE[kind])
            assert wrong({**value, "devices": {}}, MADE[kind], MADE[kind])


def test_the_official_library_agrees() -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
    for kind, value in FILES:
        jsonschema.Draft202012Validator.check_schema(MADE[kind])
        assert jsonschema.Draft202012Validator(MADE[kind]).is_valid(value)
