"""Packages that load each of their names on first use.

The module ``_face`` of a package imports its public names, and ``_shared`` imports names for use within lfcal. The
imports of both are recorded, and none of them is carried out: a name is imported from its module on first use. An
eager ``__init__`` would load the whole package for one name. It would also run while the import system holds the lock
of the requested submodule. Two threads that begin with different submodules of a package would then wait for each
other, and one of them would fail.
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
    """Give ``package``, while it is imported, the names that its modules ``_face`` and ``_shared`` import."""
    if package not in ("lfcal.base", "lfcal.cli", "lfcal.records", "lfcal.tasks"):  # which are used without numpy, too
        # Load numpy completely first: importing `numpy.typing` fails in a thread while another one is loading numpy.
        import numpy.typing  # noqa: F401
    sys.modules[package].__class__ = _Package


class _Package(ModuleType):
    """A package that loads its names from the modules named in ``_face`` and ``_shared``."""

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
        # the import system binds every submodule to its package; it must not hide a public name with the same spelling.
        if not (isinstance(value, ModuleType) and value.__name__ == f"{self.__name__}.{name}"):
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *public_names(self.__name__)})


class _Noted:
    """Placeholder for a module while the code of a face is run; it records the module that each name comes from."""

    def __init__(self, module: str) -> None:
        self._module = module

    def __getattr__(self, name: str) -> tuple[str, str]:
        return self._module, name


def names_of(package: str) -> dict[str, tuple[str, str]]:
    """Return, for each exported name, its module and its name there."""
    return _noted(f"{package}._face") | _noted(f"{package}._shared")


def public_names(package: str) -> dict[str, tuple[str, str]]:
    """Return, for each public name, its module and its name there."""
    return _noted(f"{package}._face")


@cache
def _noted(face: str) -> dict[str, tuple[str, str]]:
    """Return the imports of a face; empty if there is no such module.

    The code of the face is run with a placeholder for each imported module, so that no module is loaded.
    """
    spec = find_spec(face)
    if spec is None or spec.loader is None:
        return {}
    space: dict[str, Any] = {"__builtins__": {**vars(builtins), "__import__": lambda module, *_: _Noted(module)}}
    exec(spec.loader.get_code(face), space)  # type: ignore[attr-defined]
    return {name: found for name, found in space.items() if isinstance(found, tuple) and found[0] != "__future__"}
