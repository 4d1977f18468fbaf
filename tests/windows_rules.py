"""A file system with the rules of Windows: open files cannot be renamed, replaced or removed.

Linux allows all three, so without these rules a file that is still open when it is replaced causes an error only on
the Windows machines of users.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

__all__ = ["OpenFileError", "held_files", "keep_open_files"]

Identity = tuple[int, int]


class OpenFileError(PermissionError):
    """Error of Windows for a file that is open."""


def held_files() -> set[Identity]:
    """Return device and number of every file that this process has open or mapped (Linux)."""
    found = set()
    for name in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            state = os.stat(f"/proc/self/fd/{name}")
            found.add((state.st_dev, state.st_ino))
    for line in Path("/proc/self/maps").read_text(encoding="utf-8").splitlines():
        words = line.split(maxsplit=5)
        if len(words) == 6 and words[5].startswith("/"):
            with suppress(OSError):
                state = os.stat(words[5])
                found.add((state.st_dev, state.st_ino))
    return found


def keep_open_files(monkeypatch: pytest.MonkeyPatch, below: Path) -> None:
    """Refuse to rename, replace or remove files below a folder while this process has them open."""
    root = os.path.realpath(below)
    for name in ("replace", "rename"):
        monkeypatch.setattr(os, name, _refusing(getattr(os, name), root, both=True))
    for name in ("unlink", "remove"):
        monkeypatch.setattr(os, name, _refusing(getattr(os, name), root, both=False))


def _refusing(call: Callable[..., None], root: str, *, both: bool) -> Callable[..., None]:
    def checked(*paths: Any, **options: Any) -> None:
        for path in paths[: 2 if both else 1]:
            place = os.path.join(_folder(options.get("dir_fd")), os.fspath(path))
            if os.path.realpath(os.path.dirname(place)).startswith(root):
                _check(place)
        call(*paths, **options)

    return checked


def _folder(descriptor: int | None) -> str:
    return "" if descriptor is None else os.readlink(f"/proc/self/fd/{descriptor}")


def _check(place: str) -> None:
    if not os.path.lexists(place) or os.path.islink(place):
        return
    held = held_files()
    inside = [os.path.join(folder, name) for folder, _, names in os.walk(place) for name in names]
    for path in inside if os.path.isdir(place) else [place]:
        state = os.lstat(path)
        if (state.st_dev, state.st_ino) in held:
            raise OpenFileError(errno.EACCES, "The process cannot access the file because it is open", path)
