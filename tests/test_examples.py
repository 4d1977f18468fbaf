"""All examples in docstrings give the stated output, and every public name has an example."""

from __future__ import annotations

import doctest
import importlib
import inspect
import os
import re
import shutil
import sys
import types
from enum import Enum
from pathlib import Path
from typing import Any

import pytest

from docs_build.reference import packages
from lfcal.camera import ScanPlan
from lfcal.frames import CorrectionRecipe, corrected_view, open_frames
from lfcal.psf import assemble_plan

ROOT = Path(__file__).parents[1]
SAMPLES = ROOT / "sample_data"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
WRITTEN = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    for path in (ROOT / "lfcal").rglob("*.py")
    if ">>> " in path.read_text(encoding="utf-8")
)


def examples_of(module: types.ModuleType) -> list[doctest.DocTest]:
    """Return the examples in the docstrings of a module, its functions, classes and methods."""
    return [test for test in doctest.DocTestFinder().find(module) if test.examples]


def said_of(tests: list[doctest.DocTest]) -> str:
    """Run the examples of a module in their order; return the failures."""
    said: list[str] = []
    runner = doctest.DocTestRunner(verbose=False, optionflags=FLAGS)
    for test in sorted(tests, key=lambda test: test.lineno or 0):
        # nothing but what the example imports itself: it can be copied as it stands
        test.globs = {"__name__": "__main__"}
        runner.run(test, out=said.append)
    return "".join(said)


@pytest.fixture(scope="module")
def begun(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with copies of the sample data and the H of the session, as the reference describes it."""
    folder = tmp_path_factory.mktemp("begun")
    for name in ("session", "recorded"):
        shutil.copytree(SAMPLES / name, folder / name)
    session = folder / "session"
    plan = ScanPlan.from_json((session / "plan.json").read_text(encoding="utf-8"))
    with open_frames(session / "frames", plan=plan) as source:
        view = corrected_view(source, CorrectionRecipe(dark=session / "dark", white=session / "white"), plan)
        assemble_plan(view, plan, folder / "H.h5").matrix.close()
    return folder


DEAR = (
    "lfcal.accuracy.curves",
    "lfcal.fit.fit",
    "lfcal.judge.inspection",
    "lfcal.judge.search",
    "lfcal.lattice.lattice_file",
    "lfcal.psf.assembly",
    "lfcal.psf.denoising",
    "lfcal.judge.report.write",
    "lfcal.simulate.accuracy._ladder",
    "lfcal.judge.checking",
    "lfcal.reconstruct.resolution",
    "lfcal.tasks.assembly",
    "lfcal.tasks.plan_target",
    "lfcal.tasks.reconstruct",
)
"""Those that take seconds."""


@pytest.mark.parametrize("name", [pytest.param(x, marks=pytest.mark.long) if x in DEAR else x for x in WRITTEN])
def test_examples_do_what_they_say(name: str, begun: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(begun, tmp_path, copy_function=os.link, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    # one of them sets the words of a command
    monkeypatch.setattr(sys, "argv", ["lfcal"])
    tests = examples_of(importlib.import_module(name))
    assert tests, "'>>> ' stands where no docstring is"
    said = said_of(tests)
    assert not said, said


def test_an_example_that_says_something_else_is_told() -> None:
    module = types.ModuleType("wrong", ">>> 1 + 1\n3\n")
    assert "Expected:\n    3\nGot:\n    2" in said_of(examples_of(module))
    assert "NameError" in said_of(examples_of(types.ModuleType("bare", ">>> np.pi\n3.14\n")))


def given() -> dict[str, Any]:
    """Return the public functions and classes of a package by full name, without errors, protocols and enumerations."""
    found: dict[str, Any] = {}
    for package in packages(ROOT):
        there = importlib.import_module(package.name)
        for name in package.exported:
            value = getattr(there, name)
            made = inspect.isclass(value) and not (
                issubclass(value, (BaseException, Enum)) or getattr(value, "_is_protocol", False)
            )
            if made or inspect.isfunction(value):
                found[f"{value.__module__}.{name}"] = value
    return found


def shown() -> set[str]:
    """Return all words of the examples and of their output."""
    words: set[str] = set()
    for name in WRITTEN:
        for test in examples_of(importlib.import_module(name)):
            for example in test.examples:
                words.update(re.findall(r"\w+", example.source + example.want))
    return words


def imported_on_pages() -> set[str]:
    """Return the names that the Python blocks of the pages import from packages."""
    pages = (path.read_text(encoding="utf-8") for path in (ROOT / "docs").rglob("*.md"))
    lines = (
        line for page in pages for line in re.findall(r"^ *from lfcal[\w.]* import ([\w, ]+)$", page, re.MULTILINE)
    )
    return {name for line in lines for name in re.findall(r"\w+", line)}


def test_what_packages_give_is_shown() -> None:
    """A function has an example in its docstring or on a page; a class occurs in some example."""
    words, pages = shown(), imported_on_pages()
    missing = [
        name
        for name, value in given().items()
        if value.__name__ not in pages
        and (">>> " not in (value.__doc__ or "") if inspect.isfunction(value) else value.__name__ not in words)
    ]
    assert not missing, f"{len(missing)} of {len(given())}: {missing}"
