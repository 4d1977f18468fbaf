"""The published JSON Schemas of camera, plan and session agree with the records and with files of lfcal."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from docs_build.schemas import schemas, text_of
from lfcal.acquire.session_file import SessionFile
from lfcal.base.errors import LfcalError
from lfcal.base.h5.reading import H5File
from lfcal.camera import PRESETS, Camera, ScanPlan, preset
from lfcal.psf import PSFMatrix, save
from lfcal.psf._specification import describe, schema
from tests.acquire.rigs import small_plan
from tests.architecture.sources import ROOT

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")

MADE = {path.name.split("-")[1]: schema for path, schema in schemas().items()}
CHECKED = {kind: jsonschema.Draft202012Validator(schema) for kind, schema in MADE.items()}


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
    for path, made in schemas().items():
        assert path.read_text(encoding="utf-8") == text_of(made), path


def test_files_of_lfcal_have_no_deviation() -> None:
    assert {kind for kind, _ in FILES} == {"camera", "plan", "session"}
    for kind, value in FILES:
        assert CHECKED[kind].is_valid(value), kind


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
                assert not CHECKED[kind].is_valid(other), (*before, last, change)
                with pytest.raises(LfcalError):
                    READ[kind](other)


def test_a_session_of_the_schema_is_read(tmp_path: Path) -> None:
    for kind, value in FILES:
        if kind == "session":
            (tmp_path / "session.json").write_text(json.dumps(value))
            SessionFile.read(tmp_path)
            assert not CHECKED[kind].is_valid({**value, "more": 1})
            assert not CHECKED[kind].is_valid({**value, "devices": {}})


def test_the_schemas_are_json_schemas(tmp_path: Path) -> None:
    for found in (*MADE.values(), schema(), schema(2)):
        jsonschema.Draft202012Validator.check_schema(found)
    save(PSFMatrix(np.ones((1, 3, 3, 5, 5), np.float32)), tmp_path / "H.h5")
    with H5File(tmp_path / "H.h5") as file:
        said = json.loads(json.dumps(describe(file, [])))
    checked = jsonschema.Draft202012Validator(schema())
    assert checked.is_valid(said)
    del said["datasets"]["H"]
    assert not checked.is_valid(said)
