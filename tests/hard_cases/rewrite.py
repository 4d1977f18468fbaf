"""Naive code in the place of careful code: a function of the library with some of its text replaced."""

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
    """A naive form of what a hard case is about.

    Attributes
    ----------
    row
        The hard case that must notice it.
    naive
        What is done wrongly.
    plant
        Puts it in the place of the library's code.
    raises
        The exception by which the case notices; None where its figure exceeds the bound.
    long
        Whether the case takes too long for every run.
    """

    row: str
    naive: str
    plant: Callable[[pytest.MonkeyPatch], None]
    raises: type[BaseException] | None = None
    long: bool = False


def rewritten(owner: Any, name: str, *changes: tuple[str, str]) -> Callable[[pytest.MonkeyPatch], None]:
    """Return what plants ``owner.name`` with each (old, new) replaced in its source; every old must be there, once.

    ``owner`` is a module or a class; a compiled kernel takes part only in what calls it from Python.
    """

    def plant(patch: pytest.MonkeyPatch) -> None:
        original = getattr(owner, name)
        function = inspect.unwrap(original)
        source = textwrap.dedent(inspect.getsource(function))
        for old, new in changes:
            assert source.count(old) == 1, f"{name} holds {source.count(old)} times {old!r}"
            source = source.replace(old, new)
        names: dict[str, Any] = {}
        # the annotations are text there, too
        code = compile("from __future__ import annotations\n" + source, f"<naive {name}>", "exec")
        space = sys.modules[function.__module__].__dict__
        exec(code, space, names)
        patch.setattr(owner, name, names[name])

    return plant
