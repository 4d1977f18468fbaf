"""Packages that load each of their names when it is asked for.

What a package gives its users is imported by its module ``_face``, what it gives to other packages of lfcal alone by
``_shared``. The code of both is read and not run: a name is imported from where it stands when it is asked for, and
nothing else is. An eager ``__init__`` would load all of a package for
one of its names, and runs while the import system holds the lock of the submodule that was asked for: two threads that
begin with different submodules of one package would then wait for each other, and one of them would fail.
"""

from __future__ import annotations

import builtins
import importlib
import sys
from functools import cache
from importlib.util import find_spec
from types import ModuleType
from typing import Any

__all__ = ["lazy_face", "names_of", "public_names"]


def lazy_face(package: str) -> None:
    """Give ``package``, which is being imported, the names that its modules ``_face`` and ``_shared`` import."""
    if package not in ("lfcal.base", "lfcal.cli", "lfcal.records", "lfcal.tasks"):  # which are used without numpy, too
        # Loaded whole first: `numpy.typing` fails in a thread that asks for it while another one still loads numpy.
        import numpy.typing  # noqa: F401
    sys.modules[package].__class__ = _Package


class _Package(ModuleType):
    """A package whose names come from where its modules ``_face`` and ``_shared`` import them."""

    def __getattr__(self, name: str) -> object:
        if name == "__all__":
            return sorted(public_names(self.__name__))
        if not name.startswith("_") and name in names_of(self.__name__):
            module, there = names_of(self.__name__)[name]
            self.__dict__[name] = getattr(importlib.import_module(module), there)
            return self.__dict__[name]
        part = sys.modules.get(f"{self.__name__}.{name}")
        if part is not None:
            return part
        raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")

    def __setattr__(self, name: str, value: object) -> None:
        # the import system binds every submodule to its package; it must not hide a public name that is spelt alike.
        if not (isinstance(value, ModuleType) and value.__name__ == f"{self.__name__}.{name}"):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *public_names(self.__name__)})


class _Noted:
    """Stands for a module in a face that is read: says for each name which module it is to come from."""

    def __init__(self, module: str) -> None:
        self._module = module

    def __getattr__(self, name: str) -> tuple[str, str]:
        return self._module, name


def names_of(package: str) -> dict[str, tuple[str, str]]:
    """Return module and name there of each name that a package gives."""
    return _noted(f"{package}._face") | _noted(f"{package}._shared")


def public_names(package: str) -> dict[str, tuple[str, str]]:
    """Return module and name there of each name that a package gives its users."""
    return _noted(f"{package}._face")


@cache
def _noted(face: str) -> dict[str, tuple[str, str]]:
    """Return what a face imports, read from its code; nothing where there is no such module."""
    spec = find_spec(face)
    if spec is None or spec.loader is None:
        return {}
    space: dict[str, Any] = {"__builtins__": {**vars(builtins), "__import__": lambda module, *_: _Noted(module)}}
    exec(spec.loader.get_code(face), space)  # type: ignore[attr-defined]
    return {name: found for name, found in space.items() if isinstance(found, tuple) and found[0] != "__future__"}
