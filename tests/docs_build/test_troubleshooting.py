"""Every message that the page on troubleshooting quotes exists in the sources."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import typer

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "troubleshooting.md"
SEPARATORS = r"…|: expected |, got |; "
"""Between the parts of a message: `InputError.expected` puts them together."""


@cache
def texts() -> str:
    """Return every text of lfcal and its window, and of the library that reads the command line."""
    files = [*(ROOT / "lfcal").rglob("*.py"), *(ROOT / "gui").rglob("*.py"), *Path(typer.__file__).parent.glob("*.py")]
    found = []
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return "\n".join(found)


def quoted() -> list[str]:
    return re.findall(r"^### `(.+)`$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


def test_many_messages_are_explained() -> None:
    assert len(quoted()) == len(set(quoted())) >= 25


def test_every_quoted_message_exists() -> None:
    missing = [
        (message, part)
        for message in quoted()
        for part in re.split(SEPARATORS, message)
        if len(part.strip()) > 3 and part.strip() not in texts()
    ]
    assert not missing
