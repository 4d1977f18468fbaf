"""No function is written twice, as work that reports its progress and as a plain function."""

from __future__ import annotations

import ast
import importlib
import inspect
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from tests.architecture.sources import ROOT, tree_of
from tests.architecture.test_house import statements

FILES = sorted(p for package in ("lfcal", "gui") for p in (ROOT / package).rglob("*.py"))


def scopes(tree: ast.Module) -> Iterator[ast.Module | ast.ClassDef]:
    """Yield a module and its classes."""
    yield tree
    yield from (node for node in statements(tree) if isinstance(node, ast.ClassDef))


def called(node: ast.AST) -> set[str]:
    """Return the names of the functions and methods that are called in a function."""
    functions = (inner.func for inner in ast.walk(node) if isinstance(inner, ast.Call))
    return {getattr(function, "id", getattr(function, "attr", "")) for function in functions}


def twins(tree: ast.Module) -> list[str]:
    """Return the functions that only run work of the same module or class to its end, but are not derived from it."""
    found = []
    for scope in scopes(tree):
        functions = [node for node in scope.body if isinstance(node, ast.FunctionDef)]
        work = {node.name for node in functions if node.name.startswith("iter_")}
        for node in functions if work else ():
            calls = called(node)
            # a docstring, the work, and its result; one that does more has a name of its own
            drains = "drain" in calls and calls & work and len(node.body) <= 3
            if node.name not in work and (f"iter_{node.name}" in calls & work or drains):
                found.append(node.name)
    return found


def test_no_twin_is_written_by_hand() -> None:
    found = {str(path.relative_to(ROOT)): names for path in FILES if (names := twins(tree_of(path)))}
    assert not found, "write it as x = drained(iter_x)"


@pytest.mark.parametrize(
    "body",
    [
        "def add(a):\n    return drain(iter_add(a))",
        "def add(a):\n    work = iter_add(a)\n    return drain(work, print)",
        "def add(a):\n    for step in iter_add(a):\n        pass",
        "def sum_of(a):\n    return drain(iter_add(a))",
        "class Sums:\n    def iter_all(self): ...\n    def all(self):\n        drain(self.iter_all())",
    ],
)
def test_twins_are_found(body: str) -> None:
    assert len(twins(ast.parse(f"def iter_add(a): ...\n{body}"))) == 1


def test_other_functions_are_no_twins() -> None:
    assert not twins(
        ast.parse("def iter_add(a): ...\nadd = drained(iter_add)\ndef shown(a):\n    return drain(other(a))")
    )


@cache
def derived() -> list[tuple[str, str, str]]:
    """Return module, class (or nothing) and name of every function that `drained` makes."""
    found = []
    for path in FILES:
        for scope in scopes(tree_of(path)):
            for node in scope.body:
                value = node.value if isinstance(node, ast.Assign) else None
                if isinstance(value, ast.Call) and getattr(value.func, "id", "") == "drained":
                    assert isinstance(node, ast.Assign)
                    (target,) = node.targets
                    found.append((module_of(path), getattr(scope, "name", ""), ast.unparse(target)))
    return found


def module_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts)


@pytest.mark.parametrize(("module", "owner", "name"), derived())
def test_derived_functions_agree_with_their_work(module: str, owner: str, name: str) -> None:
    home: Any = importlib.import_module(module)
    place = getattr(home, owner) if owner else home
    plain, work = getattr(place, name), getattr(place, f"iter_{name}")
    own, other = inspect.signature(plain), inspect.signature(work)
    parameters = dict(own.parameters)
    assert parameters.pop("on_progress").default is None and parameters == dict(other.parameters)
    result = own.return_annotation if isinstance(own.return_annotation, str) else own.return_annotation.__name__
    assert "Work" not in result and result in result_of(work)
    assert (plain.__name__, plain.__module__) == (name, module)
    summary = plain.__doc__.splitlines()[0]
    assert summary in work.__doc__ and not {"Yields", f"see `iter_{name}`"} & set(plain.__doc__.splitlines())


def result_of(work: Any) -> str:
    """Return what work is annotated to return, an alias written out."""
    annotation = work.__annotations__["return"]
    return str(getattr(inspect.getmodule(work), annotation, annotation))


def test_no_subclass_changes_the_work_behind_a_derived_method() -> None:
    """It would change one of the two: a method that the work calls can be overridden instead."""
    methods = {(owner, each) for _, owner, name in derived() if owner for each in (name, f"iter_{name}")}
    assert methods
    for path in FILES:
        for scope in scopes(tree_of(path)):
            bases = {ast.unparse(base) for base in getattr(scope, "bases", ())}
            own = {node.name for node in scope.body if isinstance(node, ast.FunctionDef)}
            assert not {(base, name) for base in bases for name in own} & methods, path
