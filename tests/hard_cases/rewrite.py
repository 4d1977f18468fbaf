"""Naive code in place of careful code: functions of the library with parts of their source replaced."""

from __future__ import annotations

import inspect
import sys
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

__all__ = ["Mutant", "rewritten"]


@dataclass(frozen=True)
class Mutant:
    """A naive implementation that a hard case must detect.

    Attributes
    ----------
    row
        The hard case that must detect it.
    naive
        The mistake.
    plant
        Function that replaces the code of the library.
    raises
        The exception that the case raises; None if its value exceeds the bound.
    long
        Whether the case takes too long to be part of every run.
    """

    row: str
    naive: str
    plant: Callable[[pytest.MonkeyPatch], None]
    raises: type[BaseException] | None = None
    long: bool = False


def rewritten(owner: Any, name: str, *changes: tuple[str, str]) -> Callable[[pytest.MonkeyPatch], None]:
    """Return a function that installs ``owner.name`` with each (old, new) replaced; each old text must occur once.

    ``owner`` is a module or a class. A replaced kernel has an effect only if it is called from Python.
    """

    def plant(patch: pytest.MonkeyPatch) -> None:
        original = getattr(owner, name)
        function = inspect.unwrap(original)
        source = textwrap.dedent(inspect.getsource(function))
        for old, new in changes:
            assert source.count(old) == 1, f"{name} holds {source.count(old)} times {old!r}"
            source = source.replace(old, new)
        names: dict[str, Any] = {}
        # annotations are text in the replaced code, too
        code = compile("from __future__ import annotations\n" + source, f"<naive {name}>", "exec")
        space = sys.modules[function.__module__].__dict__
        exec(code, space, names)
        patch.setattr(owner, name, names[name])

    return plant
