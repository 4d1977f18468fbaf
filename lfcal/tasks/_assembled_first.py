"""What must be done before frames can be fitted: the command to type."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from lfcal.base import InputError, LfcalError
from lfcal.tasks._scan_frames import find_plan

__all__ = ["assembled_first", "of_one_channel", "without_positions"]

LISTED = ("--order", "--manifest", "--pattern")
"""Options of ``lfcal assemble`` that state positions; ``lfcal fit`` has none of them."""


def assembled_first(source: Path, plan: Path | None, *options: str) -> str:
    """Return the remedy: assemble H of ``source`` with options, and fit that H."""
    words = ["lfcal", "assemble", str(source), *(["--plan", str(plan)] if plan else []), *options, "-o", "H.h5"]
    return f"type {shlex.join(words)}, then lfcal fit H.h5"


def of_one_channel(source: Path, plan: Path | None, colours: Sequence[str]) -> str:
    """Return the remedy where frames are of several ``colours``: green, which has the most light, or the first."""
    green = [name for name in ("G", "G1") if name in colours]
    return assembled_first(source, plan, "--channel", [*green, *colours][0])


def without_positions(error: InputError, source: Path, plan: Path | None, dark: str) -> InputError:
    """Return ``error`` with the command to type, where it is about positions that ``source`` does not tell.

    ``plan`` and ``dark`` are those that were given; frames that lie in one folder below are named.
    """
    said, _, remedy = str(error).partition("; ")
    if not any(option in remedy for option in LISTED):
        return error
    below = _below(source, plan)
    if below is not None:
        words = ["lfcal", "fit", str(below), *(["--plan", str(plan)] if plan else [])]
        given = dark or (str(source / "dark") if (source / "dark").is_dir() else "")
        return InputError(f"{said}; type {shlex.join([*words, *(['--dark', given] if given else [])])}")
    named = re.search(r"say it: --pattern '([^']+)'", remedy)
    if named:
        return InputError(f"{said}; {assembled_first(source, plan, '--pattern', named.group(1))}")
    if "raster" in remedy:
        told = assembled_first(source, plan, "--order", "serpentine")
        return InputError(f"{said}; {told} (or --order raster, or --manifest LIST)")
    return InputError(f"{said}; {assembled_first(source, plan, '--manifest', 'LIST.csv')}")


def _below(source: Path, plan: Path | None) -> Path | None:
    """Return the only folder in ``source`` whose frames tell their positions, or None."""
    from lfcal.frames import open_frames

    if not source.is_dir():
        return None
    found = []
    for folder in sorted(path for path in source.iterdir() if path.is_dir() and not path.name.startswith(".")):
        try:
            with open_frames(folder, plan=find_plan(folder, plan)) as frames:
                found += [folder] if len(frames) else []
        except LfcalError:
            continue
    return found[0] if len(found) == 1 else None
