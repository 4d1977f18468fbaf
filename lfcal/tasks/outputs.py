"""Rules for output files, the same for every command, checked before its work begins.

An input is never replaced. An existing file is replaced only with ``--force``. This is decided once, at the start. A
file that appears later, while the command works, is replaced as well, unless another program is still writing it
(`lfcal.base.files.replace_whole`).
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from lfcal.base import InputError, check_writable

__all__ = ["check_output", "check_outputs"]


def check_output(out: Path | None, *inputs: Path | str | None, force: bool) -> None:
    """Raise an error unless ``out`` can be written, is not one of ``inputs``, and does not exist (or ``force`` is set).

    ``inputs`` are files, folders of frames, sessions, or names of presets. If ``out`` is None, there is no output, and
    nothing is checked.

    Raises
    ------
    InputError
        If ``out`` is an input, or exists and ``force`` is not set.
    StorageError
        If ``out`` cannot be written.
    """
    check_outputs([out], *inputs, force=force)


def check_outputs(outs: Iterable[Path | None], *inputs: Path | str | None, force: bool) -> None:
    """Check several outputs like `check_output`, and raise `InputError` if two of them have the same path."""
    files = [out for out in outs if out is not None]
    if len({out.absolute() for out in files}) < len(files):
        raise InputError.expected("outputs", "a different name for each", str(files[-1]), "choose other names")
    taken: set[tuple[int, int]] = set()
    # only an existing file can be an input.
    if any(out.exists() for out in files):
        from lfcal.frames import files_of

        taken = {found for source in inputs for path in files_of(source) if (found := _identity(path))}
    for out in files:
        if _identity(out) in taken:
            raise InputError.expected("output", "a file other than the input", str(out), "choose another name")
        check_writable(out)
        if out.exists() and not force:
            raise InputError(f"{out}: exists; add --force to replace it, or choose another name")


def _identity(path: Path) -> tuple[int, int] | None:
    """Return a key that two names of the same file share, following links; None if there is no file."""
    with suppress(OSError):
        found = os.stat(path)
        return found.st_dev, found.st_ino
    return None
