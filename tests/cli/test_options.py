"""Every option of every command occurs in a test of that command."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer.main

import benchmarks.__main__
from lfcal.cli._app import build_app

TESTS = Path(__file__).parents[1]


def walk(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield every command and sub-command with the words that call it."""
    yield path, command
    for name, sub in (*getattr(command, "commands", {}).items(), *getattr(command, "parts", {}).items()):
        yield from walk(sub, (*path, name))


def long_names(parameter: Any) -> list[str]:
    """Return the long names of an option that do something: of a flag, those that are not its default."""
    on, off = (
        [name for name in names if name.startswith("--")] for names in (parameter.opts, parameter.secondary_opts)
    )
    if parameter.name == "help":
        return []
    return off if off and parameter.default else on


def short_names(parameter: Any) -> tuple[str, ...]:
    """Return the one-letter names of an option."""
    return tuple(name for name in parameter.opts if not name.startswith("--"))


OPTIONS = {
    (path, name): short_names(parameter)
    for path, command in (
        *walk(typer.main.get_command(build_app())),
        *walk(benchmarks.__main__.command_line(), ("benchmarks",)),
    )
    for parameter in command.params
    for name in long_names(parameter)
}
"""Words of the command and long name of the option, to its one-letter names."""


@pytest.fixture(scope="module")
def sources() -> list[str]:
    """Return the test modules, this one left out."""
    return [path.read_text(encoding="utf-8") for path in TESTS.rglob("test_*.py") if path != Path(__file__)]


@cache
def words_of(text: str) -> tuple[frozenset[str], frozenset[str]]:
    """Return the words of a module that may be commands, and its long options."""
    return frozenset(re.findall(r'(?<=["\s])[\w-]+(?=["\s])', text)), frozenset(re.findall(r"--[\w-]+", text))


def calls(text: str, path: tuple[str, ...]) -> bool:
    """Return whether a test module calls the command, by its words or in one text."""
    return all(word in words_of(text)[0] or (word == "benchmarks" and word in text) for word in path)


def names(text: str, path: tuple[str, ...], option: str) -> bool:
    """Return whether a test module calls the command and names the option."""
    written = option in words_of(text)[1] or (option == "--json" and "bench.json(" in text)
    return calls(text, path) and (written or any(f'"{short}"' in text for short in OPTIONS[path, option]))


def test_the_walk_finds_the_sub_commands() -> None:
    assert (("benchmarks", "transpose"), "--sizes") in OPTIONS and (("multiplex", "search"), "--chi2") in OPTIONS
    assert ((), "--version") in OPTIONS and (("acquire",), "--no-pack") in OPTIONS
    assert (("acquire",), "--pack") not in OPTIONS, "it is the default"


def test_an_option_of_another_command_does_not_count() -> None:
    assert names('lfcal("export", "-o", "x.npy")', ("export",), "--out")
    assert not names('lfcal("export", "--transposed-too")', ("export",), "--transposed")
    assert not names('lfcal("plan", "--transposed")', ("export",), "--transposed")


def test_every_option_is_tested(sources: list[str]) -> None:
    callers = {path: [text for text in sources if calls(text, path)] for path, _ in OPTIONS}
    missing = [
        " ".join(("lfcal", *path, option))
        for path, option in OPTIONS
        if not any(names(text, path, option) for text in callers[path])
    ]
    assert not missing, "options that no test names with their command"
