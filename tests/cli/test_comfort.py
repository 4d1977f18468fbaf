"""What every command has: JSON where a script reads it, an example that would run, and an answer to a typo."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from lfcal.cli._app import command_line
from lfcal.cli._console import print_json
from tests.cli.conftest import Run
from tests.cli.test_every_option import walk

EVERY = {" ".join(path): command for path, command in walk(command_line())}
GROUPS = {name: command for name, command in EVERY.items() if hasattr(command, "commands")}
COMMANDS = {name: command for name, command in EVERY.items() if name not in GROUPS}
NO_JSON: dict[str, str] = {}
"""Commands that print nothing a script would read, with the reason."""


def long_options(command: Any) -> list[str]:
    return [name for one in command.params for name in one.opts if name.startswith("--")]


def examples(command: Any) -> list[str]:
    """Return the command lines that the last paragraph of a command's help shows."""
    said = str(command.epilog or str(command.help).rstrip().rpartition("\n\n")[2])
    return re.findall(r"`(lfcal [^`]+)`", said) if said.startswith("Example: ") else []


def parsed(words: list[str]) -> tuple[str, dict[str, Any]]:
    """Return the command that words call, and its parameters; raises what its parser says of them."""
    command, name = command_line(), ""
    context = command.make_context("lfcal", list(words))
    while name not in COMMANDS:
        word, command, rest = command.resolve_command(context, [*context._protected_args, *context.args])
        name = f"{name} {word}".strip()
        context = command.make_context(word, rest, parent=context)
    # a command with others behind its name has made the context of the one that was named
    return context.command_path.partition(" ")[2], context.params


def test_there_are_commands_and_groups() -> None:
    assert {"fit", "camera show", "bench", "multiplex coding"} <= set(COMMANDS)
    assert set(GROUPS) == {"", "camera", "multiplex"}


def test_every_command_prints_json_or_says_why_not() -> None:
    without = {name for name, command in COMMANDS.items() if "--json" not in long_options(command)}
    assert without == set(NO_JSON), "add json: JsonOption, or a reason"
    assert all(NO_JSON.values())


def test_json_is_strict(capsys: pytest.CaptureFixture[str]) -> None:
    print_json({"none": float("nan"), "endless": [float("inf"), 1.0], "path": Path("H.h5")})
    assert (
        capsys.readouterr().out == '{\n  "none": null,\n  "endless": [\n    null,\n    1.0\n  ],\n  "path": "H.h5"\n}\n'
    )
    with pytest.raises(ValueError, match="not strict JSON: NaN"):
        _ = Run(0, '{"error": NaN}', "").json


@pytest.mark.parametrize("name", COMMANDS)
def test_the_example_of_a_command_is_one_that_it_understands(name: str) -> None:
    lines = examples(COMMANDS[name])
    assert lines, "the help ends with Example: `lfcal …`"
    for line in lines:
        called, parameters = parsed(shlex.split(line)[1:])
        assert called == name and parameters


@pytest.mark.parametrize("name", [name for name in GROUPS if name])
def test_the_example_of_a_group_is_one_of_its_commands(name: str) -> None:
    for line in (found := examples(GROUPS[name])):
        called, _ = parsed(shlex.split(line)[1:])
        assert called.startswith(f"{name} ") and line in examples(COMMANDS[called])
    assert found


def misspelt(word: str) -> str:
    """Return a word with the letter in its middle doubled."""
    middle = len(word) // 2
    return word[: middle + 1] + word[middle:]


@pytest.mark.parametrize("name", COMMANDS)
def test_an_option_misspelt_is_answered_with_the_one_that_was_meant(lfcal: Callable[..., Run], name: str) -> None:
    option = max(long_options(COMMANDS[name]), key=len)
    run = lfcal(*name.split(), misspelt(option))
    assert run.code == 2 and f"Did you mean {option}? See lfcal {name} --help" in run.err and not run.out


@pytest.mark.parametrize("name", GROUPS)
def test_a_command_misspelt_is_answered_with_the_one_that_was_meant(lfcal: Callable[..., Run], name: str) -> None:
    for word in GROUPS[name].commands:
        run = lfcal(*name.split(), misspelt(word))
        assert run.code == 2 and f"Did you mean '{word}'" in run.err and len(run.err.splitlines()) == 1, run.err
