"""Packages that load their public names when the first of them is asked for.

The public names of a package are imported by its module ``_face``; its ``__init__`` imports nothing. An eager
``__init__`` runs while the import system holds the lock of the submodule that was asked for: two threads that begin
with different submodules of one package would then wait for each other, and one of them would fail.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType

# numpy is loaded whole first: `numpy.typing` fails in a thread that asks for it while another one still loads numpy.
import numpy
import numpy.typing  # noqa: F401

__all__ = ["lazy_face"]


def lazy_face(package: str) -> None:
    """Give ``package``, which is being imported, the names in ``__all__`` of its module ``_face``."""
    sys.modules[package].__class__ = _Package


class _Package(ModuleType):
    """A package whose public names come from its module ``_face``."""

    def __getattr__(self, name: str) -> object:
        if name == "__all__" or not name.startswith("_"):
            face = importlib.import_module(f"{self.__name__}._face")
            if name == "__all__":
                return face.__all__
            # a module of the package that imports another one finds the face incomplete
            if name in getattr(face, "__all__", ()):
                self.__dict__[name] = getattr(face, name)
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
        return sorted({*super().__dir__(), *importlib.import_module(f"{self.__name__}._face").__all__})
