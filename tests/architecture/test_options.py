"""No option, and no parameter by name, is taken and then ignored: found in the sources."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.architecture.sources import ROOT, tree_of
from tests.architecture.test_house import statements

Function = ast.FunctionDef | ast.AsyncFunctionDef


def functions(folder: str) -> Iterator[tuple[Path, Function]]:
    """Yield every function of a package with its file."""
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in statements(tree_of(path)):
            if isinstance(node, Function):
                yield path, node


def used(function: Function) -> set[str]:
    """Return the names that a function's body reads."""
    return {node.id for part in function.body for node in ast.walk(part) if isinstance(node, ast.Name)}


def options(function: Function) -> Iterator[tuple[str, str]]:
    """Yield name and annotation of each option or argument of a command."""
    arguments = [*function.args.args, *function.args.kwonlyargs]
    defaults = [*function.args.defaults, *(one for one in function.args.kw_defaults if one is not None)]
    typed = any("typer.Option" in ast.unparse(one) or "typer.Argument" in ast.unparse(one) for one in defaults)
    named = any(ast.unparse(one.annotation).endswith(("Option", "Argument")) for one in arguments if one.annotation)
    if typed or named:
        yield from ((one.arg, ast.unparse(one.annotation) if one.annotation else "") for one in arguments)


def unread(function: Function) -> list[str]:
    """Return the options of a command that its body never reads, but for those that a callback reads."""
    given = {
        one.arg: ast.unparse(default)
        for one, default in zip(function.args.kwonlyargs, function.args.kw_defaults, strict=True)
        if default is not None
    }
    positional = function.args.args[len(function.args.args) - len(function.args.defaults) :]
    given |= {one.arg: ast.unparse(default) for one, default in zip(positional, function.args.defaults, strict=True)}
    called = {name for name, default in given.items() if "callback=" in default}
    # --workers bounds all threads by the callback of its type
    return [
        name
        for name, kind in options(function)
        if name not in used(function) and name not in called and kind != "WorkersOption"
    ]


def dropped(function: Function) -> bool:
    """Return whether a function takes ``**names`` that its body never reads; a signature alone has no body."""
    more = function.args.kwarg
    if ast.unparse(function.body[-1]) == "...":
        return False
    return more is not None and not more.arg.startswith("_") and more.arg not in used(function)


def test_every_option_of_every_command_is_read() -> None:
    found = [(path, node) for path, node in functions("lfcal/cli") if list(options(node))]
    assert len(found) > 30, "the commands were found"
    assert [f"{path.name}: {node.name}: {name}" for path, node in found for name in unread(node)] == []


@pytest.mark.parametrize("folder", ["lfcal", "gui/lfcal_gui"])
def test_names_that_a_function_takes_are_used(folder: str) -> None:
    found = [(path, node) for path, node in functions(folder) if node.args.kwarg is not None]
    assert found, "there are such functions"
    assert [f"{path.name}: {node.name}" for path, node in found if dropped(node)] == []


def test_an_ignored_option_would_be_found() -> None:
    (command,) = ast.parse("def command(a: X = typer.Option(1), b: JsonOption = False):\n    return a").body
    assert isinstance(command, ast.FunctionDef) and unread(command) == ["b"]
    (taking,) = ast.parse("def f(a, **more):\n    return a").body
    assert isinstance(taking, ast.FunctionDef) and dropped(taking)
