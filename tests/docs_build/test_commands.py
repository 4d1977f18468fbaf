"""Every command of the pages exists, with its options."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lfcal.cli._app import command_line

DOCS = Path(__file__).parents[2] / "docs"
BLOCK = re.compile(r"^```(?:sh|text)(?: run[^\n]*)?\n(.*?)^```", re.MULTILINE | re.DOTALL)


def commands_of(page: Path) -> Iterator[list[str]]:
    """Yield the words of every ``lfcal`` command in the blocks of a page."""
    for block in BLOCK.findall(page.read_text(encoding="utf-8")):
        for line in block.replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True) if line.lstrip().startswith(("lfcal ", "uv run lfcal ")) else []
            found: list[list[str]] = [[]]
            for word in words:
                if word in ("&&", "|", ";"):
                    found.append([])
                else:
                    found[-1].append(word)
            yield from (one[one.index("lfcal") :] for one in found if "lfcal" in one)


@pytest.mark.parametrize("page", sorted(DOCS.rglob("*.md")), ids=lambda path: path.relative_to(DOCS).as_posix())
def test_every_command_and_option_exists(page: Path) -> None:
    for words in commands_of(page):
        if "COMMAND" in words or words[1].startswith("-"):
            continue
        entered: Any = command_line()
        rest = words[1:]
        while getattr(entered, "commands", None):
            entered = entered.commands[rest.pop(0)]
        if rest and rest[0] in (getattr(entered, "parts", None) or {}):
            entered = entered.parts[rest.pop(0)]
        if "--help" not in rest:
            entered.make_context("lfcal", rest)
