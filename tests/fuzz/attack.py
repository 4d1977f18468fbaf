"""One spoilt input against one command, and the verdict on what came of it."""

from __future__ import annotations

import re
import shutil
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from random import Random

from typer.main import get_command

from lfcal.cli._app import build_app
from tests.fuzz.guard import Guard, Outcome
from tests.fuzz.h5_mutators import restructure
from tests.fuzz.mutators import mutate
from tests.fuzz.targets import Target

__all__ = ["Workplace", "spoil"]

LONGEST = 500
STRUCTURED = 0.7
"""Share of the inputs of HDF5 files that still are such files."""
OLD = b"what an earlier run left"
BEFORE = re.compile(r"lfcal: (note|warning): |lfcal: .*memory [\d.]+ [kMG]?B of ")
"""What a command may say before it finds what is wrong: notes, and how it is going to reconstruct."""
SESSION_FILES = re.compile(r"(session\.lock|session\.json|(recording|darks|checks)(-\d+)?\.h5)")
"""What a session that goes on may add to its folder: it can be resumed."""


def spoil(target: Target, number: int, good: Path) -> bytes:
    """Return input ``number`` for ``target``: the same every time."""
    data, rng = (good / target.file).read_bytes(), Random(f"{target.name} {number}")
    if target.family == "h5" and rng.random() < STRUCTURED:
        with suppress(Exception):  # a change that HDF5 does not take
            return restructure(data, rng)
    return mutate(data, target.family, rng)


@dataclass(frozen=True, slots=True)
class Workplace:
    """Good files to spoil one of, and a process to run commands.

    Attributes
    ----------
    good
        Folder of good files, never changed.
    folder
        A copy of it, where the commands run.
    guard
        Runs them.
    """

    good: Path
    folder: Path
    guard: Guard

    def verdict(self, target: Target, data: bytes, *, old: bool = False) -> tuple[str, Outcome]:
        """Run the command of ``target`` on ``data``; return what is wrong ("" if nothing) and how it ended.

        With ``old`` there is an output of an earlier run, which a refusal must leave as it is.
        """
        if target.whole:
            shutil.rmtree(self.folder / target.whole, ignore_errors=True)
            shutil.copytree(self.good / target.whole, self.folder / target.whole)
        spoilt, output = self.folder / target.file, self.folder / target.output
        spoilt.write_bytes(data)
        old = old and bool(target.output and output.suffix)
        if old:
            output.write_bytes(OLD)
        before = _listing(self.folder)
        try:
            force = ["--force"] if old and _takes_force(target.arguments[0]) else []
            outcome = self.guard.run([*target.arguments, *force], self.folder)
            return self._judge(target, outcome, before), outcome
        finally:
            shutil.copyfile(self.good / target.file, spoilt)
            self._tidy(before, output if target.output and not target.whole else None)

    def _judge(self, target: Target, outcome: Outcome, before: dict[str, tuple[int, int]]) -> str:
        if outcome.code is None:
            return outcome.failure
        wrong = _judge_words(outcome)
        after = _listing(self.folder)
        changed = {name for name in before.keys() | after.keys() if before.get(name) != after.get(name)}
        allowed = set()
        if target.whole:
            allowed = {name for name in changed if SESSION_FILES.fullmatch(name.removeprefix(f"{target.whole}/"))}
        elif outcome.code == 0 and target.output:
            allowed = {name for name in after if name.split("/")[0] == target.output}
            if not allowed:
                wrong = wrong or "exit code 0 without an output"
        left = sorted(changed - allowed)
        return wrong or (f"files left or changed: {', '.join(left[:3])}" if left else "")

    def _tidy(self, before: dict[str, tuple[int, int]], output: Path | None) -> None:
        for name in sorted(set(_listing(self.folder)) - set(before), reverse=True):  # a folder after what is in it
            path = self.folder / name
            path.rmdir() if path.is_dir() else path.unlink()
        if output is not None:
            output.unlink(missing_ok=True)


@cache
def _takes_force(command: str) -> bool:
    """Return whether a command asks before it replaces a file."""
    commands = get_command(build_app()).commands
    return command in commands and any("--force" in option.opts for option in commands[command].params)


def _judge_words(outcome: Outcome) -> str:
    """Return what is wrong with exit code and standard error."""
    if outcome.code not in (0, 1, 2):
        return f"exit code {outcome.code}"
    lines = outcome.said.splitlines()
    foreign = [line for line in lines if not line.startswith("lfcal: ")]
    if foreign:
        return f"other than a line of lfcal: {foreign[0][:100]!r}"
    told = [line for line in lines if not BEFORE.match(line)]
    if outcome.code and (len(told) != 1 or told != lines[-1:]):
        return f"{len(told)} lines"
    longest = max(map(len, told), default=0)
    if longest > LONGEST:
        return f"a line of {longest} characters"
    return "a line with control characters" if any(not line.isprintable() for line in lines) else ""


def _listing(folder: Path) -> dict[str, tuple[int, int]]:
    """Return size and time of change of every file, and the folders."""
    found = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        whole = (status.st_size, status.st_mtime_ns)
        found[path.relative_to(folder).as_posix()] = (0, 0) if path.is_dir() else whole
    return found
