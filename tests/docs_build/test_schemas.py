"""The published JSON Schemas of camera, plan and session agree with the records and with files of lfcal."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from functools import cache
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
READ = {"camera": Camera.from_dict, "plan": ScanPlan.from_dict}


@cache
def checked(kind: str) -> Any:
    """Return what checks files of a kind."""
    made = {path.name.split("-")[1]: schema for path, schema in schemas().items()}
    return jsonschema.Draft202012Validator(made[kind])


def written(value: Any) -> Any:
    return json.loads(json.dumps(value))


def test_the_published_schemas_are_those_of_the_records() -> None:
    """If not: ``python -m docs_build.schemas``."""
    for path, made in schemas().items():
        assert path.read_text(encoding="utf-8") == text_of(made), path
        jsonschema.Draft202012Validator.check_schema(made)


def test_files_of_lfcal_are_valid_and_sessions_are_read(tmp_path: Path) -> None:
    for name in PRESETS:
        assert checked("camera").is_valid(written(preset(name).to_dict())), name
    assert checked("plan").is_valid(written(small_plan().to_dict()))
    sessions = sorted((ROOT / "sample_data").rglob("session.json"))
    assert sessions
    for path in sessions:
        value = json.loads(path.read_text())
        (tmp_path / "session.json").write_text(json.dumps(value))
        SessionFile.read(tmp_path)
        assert checked("session").is_valid(value), path
        for odd in ({"more": 1}, {"devices": {}}):
            assert not checked("session").is_valid({**value, **odd})


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    for key, one in value.items() if isinstance(value, dict) else ():
        yield (*at, key)
        yield from places(one, (*at, key))


@pytest.mark.parametrize("kind", ["camera", "plan"])
def test_lfcal_refuses_what_the_schema_refuses(kind: str) -> None:
    """Each entry is left out, misspelt, and given a value of another type; the schema finds all three."""
    presets = [preset(name).to_dict() for name in list(PRESETS)[:3]]
    for value in map(written, presets if kind == "camera" else [small_plan().to_dict()]):
        for *before, last in places(value):
            for change in ("another type",) if before[-1:] == ["marks"] else ("missing", "misspelt", "another type"):
                other = copy.deepcopy(value)
                entries = other
                for key in before:
                    entries = entries[key]
                old = entries.pop(last)
                if change != "missing":
                    entries[last if change == "another type" else f"{last}_"] = {"odd": old}
                assert not checked(kind).is_valid(other), (*before, last, change)
                with pytest.raises(LfcalError):
                    READ[kind](other)


def test_the_description_of_an_h_is_valid(tmp_path: Path) -> None:
    for version in ((), (2,)):
        jsonschema.Draft202012Validator.check_schema(schema(*version))
    save(PSFMatrix(np.ones((1, 3, 3, 5, 5), np.float32)), tmp_path / "H.h5")
    with H5File(tmp_path / "H.h5") as file:
        description = written(describe(file, []))
    valid = jsonschema.Draft202012Validator(schema()).is_valid
    assert valid(description)
    del description["datasets"]["H"]
    assert not valid(description)
