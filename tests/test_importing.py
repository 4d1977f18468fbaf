"""Workers import the same modules, one of them in reverse order."""

from __future__ import annotations

import importlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.importing import begin_at_the_end, modules_below


def asked(root: Path, worker: str, **more: Any) -> Any:
    config = {"args": ["tests/a"], "rootpath": root, "invocation_params": SimpleNamespace(dir=root), **more}
    return SimpleNamespace(workerinput={"workerid": worker}, getoption=lambda _: ["tests/a/sub"], **config)


@pytest.fixture
def imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    for name in ("a/test_1.py", "a/test_2.py", "a/common.py", "a/sub/test_3.py", "b/test_4.py"):
        path = tmp_path / "tests" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    found: list[str] = []

    def load(name: str) -> None:
        found.append(name)
        if name.endswith("1"):
            pytest.skip("a module that is not for here", allow_module_level=True)
        raise ImportError(name)  # is told when it is collected

    monkeypatch.setattr(importlib, "import_module", load)
    return found


def test_every_second_worker_begins_at_the_end(tmp_path: Path, imported: list[str]) -> None:
    begin_at_the_end(asked(tmp_path, "gw0"))
    assert imported == []
    begin_at_the_end(asked(tmp_path, "gw1"))
    assert imported == ["tests.a.test_2", "tests.a.test_1"]


def test_a_single_file_needs_no_hurry(tmp_path: Path, imported: list[str]) -> None:
    begin_at_the_end(asked(tmp_path, "gw1", args=["tests/a/test_1.py::test_x"]))
    assert imported == []


def test_names_are_those_that_pytest_gives() -> None:
    root = Path(__file__).parents[1]
    assert __name__ in modules_below([root / "tests"], [], root)
