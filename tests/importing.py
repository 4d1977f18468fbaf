"""Import test modules in advance: one of two workers starts at the end, so that each compiles half of all files.

In a new checkout, compiling the tests and the modules that they import takes longer than importing compiled files. Two
workers that import in the same order compile every file twice.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterable
from pathlib import Path

import pytest

__all__ = ["begin_at_the_end", "modules_below"]


def modules_below(folders: Iterable[Path], ignored: Iterable[Path], root: Path) -> list[str]:
    """Return the names of the test modules in folders, in the order in which pytest imports them."""
    left_out = tuple(ignored)
    files = (path for folder in folders if folder.is_dir() for path in sorted(folder.rglob("test_*.py")))
    return [
        ".".join(path.relative_to(root).with_suffix("").parts)
        for path in files
        if not any(path.is_relative_to(one) for one in left_out)
    ]


def begin_at_the_end(config: pytest.Config) -> None:
    """Import all test modules, starting with the last, in every second worker; pytest reports errors later."""
    worker = getattr(config, "workerinput", {}).get("workerid", "gw0")
    if int(worker.removeprefix("gw")) % 2 == 0:
        return
    here = config.invocation_params.dir
    asked = [here / str(name).partition("::")[0] for name in config.args]
    ignored = [here / str(name) for name in config.getoption("ignore") or ()]
    for name in reversed(modules_below(asked, ignored, config.rootpath)):
        try:
            importlib.import_module(name)
        except (Exception, pytest.skip.Exception):
            continue
