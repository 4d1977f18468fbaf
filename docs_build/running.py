"""Run tutorials while the site is built, and add what they print and draw to their pages.

Fenced blocks that begin with ```` ```python run ```` or ```` ```sh run ```` run in the order of the page, in a new
folder. Python names are kept from block to block. The output follows its block. A picture of the page must be a file
of the site, or a block must have drawn it.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

__all__ = ["LONGEST", "Ran", "TutorialError", "run_page", "runs"]

FENCE = re.compile(r"^```(?P<kind>python|sh) run(?P<options>[^\n]*)\n(?P<code>.*?)^```\n", re.DOTALL | re.MULTILINE)
PICTURE = re.compile(r"!\[[^\]]*\]\((?P<name>[^):#]+\.(?:png|svg))\)")

LONGEST = 40
"""Largest number of lines of output that are shown; the middle of longer output is left out."""


class TutorialError(Exception):
    """Exception for a tutorial that fails."""


@dataclass(frozen=True)
class Ran:
    """A page after it was run, and the pictures that it drew, by name."""

    markdown: str
    pictures: dict[str, bytes]


def runs(markdown: str) -> bool:
    """Return whether a page has blocks to run."""
    return FENCE.search(markdown) is not None


def run_page(markdown: str, folder: Path, shown: Callable[[str], bool] = lambda name: False) -> Ran:
    """Run a page in ``folder``.

    Parameters
    ----------
    markdown
        The page.
    folder
        Folder that is empty, or contains the files with which the page starts.
    shown
        Function that returns whether a picture is already a file of the site.

    Raises
    ------
    TutorialError
        If a block ends with another exit code than expected (0, or that of ``sh run fails=2``), with the block and its
        output; or if no block has drawn a picture of the page.
    """
    names: dict[str, Any] = {"__name__": "__main__"}

    def replaced(match: re.Match[str]) -> str:
        kind, code = match["kind"], match["code"]
        with _inside(folder):
            said = _python(code, names) if kind == "python" else _shell(code, _expected_code(match["options"]))
        output = f"\n```text\n{_shortened(said)}\n```\n" if said.strip() else ""
        return f"```{kind}\n{code}```\n{output}"

    text = FENCE.sub(replaced, markdown)
    pictures = {}
    for name in dict.fromkeys(match["name"] for match in PICTURE.finditer(markdown)):
        if shown(name):
            continue
        path = folder / name
        if not path.is_file():
            raise TutorialError(f"{name}: the page shows this picture, but no block of the page has drawn it")
        pictures[name] = path.read_bytes()
    return Ran(text, pictures)


@contextlib.contextmanager
def _inside(folder: Path) -> Iterator[None]:
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _python(code: str, names: dict[str, Any]) -> str:
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(said):
            exec(compile(code, "<tutorial>", "exec"), names)
    except Exception as error:
        raise TutorialError(f"{type(error).__name__}: {error}, in the block\n{code}") from error
    return said.getvalue()


def _expected_code(options: str) -> int:
    found = re.search(r"\bfails=(\d+)", options)
    return int(found[1]) if found else 0


def _shell(code: str, expected: int) -> str:
    """Run the lines of a block one by one; only the last one may be expected to fail."""
    said = []
    lines = [words for line in code.replace("\\\n", " ").splitlines() if (words := shlex.split(line, comments=True))]
    for k, words in enumerate(lines):
        wanted = expected if k == len(lines) - 1 else 0
        command = [sys.executable, "-m", *words] if words[0] == "lfcal" else words
        done = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, encoding="utf-8", env=_environment()
        )
        if done.returncode != wanted:
            raise TutorialError(f"{shlex.join(words)}: exit code {done.returncode}, not {wanted}: {done.stdout}")
        said.append(done.stdout)
    return "".join(said)


def _environment() -> dict[str, str]:
    return {**os.environ, "NO_COLOR": "1", "COLUMNS": "110", "MPLBACKEND": "Agg", "PYTHONIOENCODING": "utf-8"}


def _shortened(said: str) -> str:
    lines = [line.rstrip() for line in said.strip("\n").splitlines()]
    if len(lines) > LONGEST:
        lines = [*lines[: LONGEST // 2], "…", *lines[-LONGEST // 2 :]]
    return "\n".join(lines)
