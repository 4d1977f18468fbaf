"""Registries: parts found by name, from lfcal and from other packages.

Each kind of part (image format, effect, metric, solver, page …) has a package, and an entry point group for other
packages. Each module of the package defines parts in one module attribute. To add a part, add one module.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterator
from importlib import metadata
from typing import Any, Generic, Protocol, TypeVar

from lfcal.base.errors import InputError, any_of, choose

__all__ = ["Named", "Registry"]


class Named(Protocol):
    """Protocol for an object with a name that is unique within a registry."""

    @property
    def name(self) -> str:
        """Name used in commands, files and display."""
        ...


T = TypeVar("T", bound=Named)


class Registry(Generic[T]):
    """Registry of the parts of one kind by name, discovered on first use.

    A part of another package is ignored if a part of lfcal has the same name.

    Parameters
    ----------
    what
        Name of the kind in messages, such as ``"solver"``.
    package
        Package whose public modules are searched, except its ``__init__``.
    attribute
        Module attribute that contains a part or a tuple of parts.
    group
        Entry point group of other packages; each point loads a part or a tuple of parts.
    order
        Sort key of the parts. None: by name.
    check
        Function called with every part of another package; it raises an error if the part cannot be used.
    make
        Function that turns the loaded object of an entry point into the part. None: the object is the part.
    """

    def __init__(
        self,
        what: str,
        package: str,
        attribute: str,
        group: str,
        *,
        order: Callable[[T], Any] | None = None,
        check: Callable[[T], object] | None = None,
        make: Callable[[Any], T] | None = None,
    ) -> None:
        self.what, self.package, self.attribute, self.group = what, package, attribute, group
        self._order, self._check, self._make = order, check, make
        self._parts: dict[str, T] | None = None
        self._failures: dict[str, str] = {}

    def _found(self) -> dict[str, T]:
        if self._parts is None:
            parts: dict[str, T] = {}
            for part in self._builtin():
                if part.name in parts:
                    raise ValueError(f"two {self.what}s are called {part.name!r}")
                parts[part.name] = part
            for part in self._plugins():
                parts.setdefault(part.name, part)  # other packages cannot replace parts of lfcal
            key = self._order or (lambda part: part.name)
            self._parts = {part.name: part for part in sorted(parts.values(), key=key)}
        return self._parts

    def _builtin(self) -> Iterator[T]:
        path = importlib.import_module(self.package).__path__
        for module in pkgutil.iter_modules(path):
            if not module.name.startswith("_"):
                loaded = importlib.import_module(f"{self.package}.{module.name}")
                yield from _several(getattr(loaded, self.attribute, ()))

    def _plugins(self) -> Iterator[T]:
        for point in metadata.entry_points(group=self.group):
            try:
                parts = _several(point.load())
                if self._make is not None:
                    parts = tuple(map(self._make, parts))
                for part in parts:
                    if not isinstance(getattr(part, "name", None), str):
                        raise TypeError("expected a part with a name (str), got one without")
                    if self._check is not None:
                        self._check(part)
            except Exception as error:  # a third-party package can raise any error
                self._failures[point.name] = f"{self.what} {point.name}: {type(error).__name__}: {error}"
            else:
                yield from parts

    def names(self) -> tuple[str, ...]:
        """Return the names, in order."""
        return tuple(self._found())

    def get(self, name: str) -> T:
        """Return the part named ``name``; raise `InputError` with the known names if there is none."""
        found = self._found()
        if name not in found:
            raise InputError.expected(self.what, any_of(found), repr(name), choose(name, found))
        return found[name]

    def failures(self) -> dict[str, str]:
        """Return the reasons why parts of other packages could not be loaded or used, by name of entry point."""
        self._found()
        return dict(self._failures)

    def __iter__(self) -> Iterator[T]:
        """Iterate over the parts, in order."""
        return iter(self._found().values())

    def __contains__(self, name: object) -> bool:
        """Return whether there is a part with this name."""
        return name in self._found()

    def __len__(self) -> int:
        """Return the number of parts."""
        return len(self._found())


def _several(found: Any) -> tuple[Any, ...]:
    return found if isinstance(found, tuple) else (found,)
