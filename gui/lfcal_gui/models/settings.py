"""Settings of one page, kept in the project by the page's key. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

from lfcal.base import InputError, LfcalError
from lfcal_gui.models.project import ProjectState

__all__ = ["PageSettings"]


@dataclass(frozen=True)
class PageSettings:
    """Base of a page's settings: a frozen record whose fields all have defaults and are plain values or tuples.

    A subclass names its page in the class variable ``page``. The project holds what `to_dict` returns, so that it
    can be saved without knowing any page, and so that the settings of a page that is not installed are kept.
    """

    page: ClassVar[str]

    def usable(self) -> None:
        """Raise `InputError` where values that are allowed one by one do not go together."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {f.name: _plain(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the settings in ``data``; what is missing takes its default, damaged settings all of them."""
        if not isinstance(data, Mapping):
            return cls()
        given = {f.name: _tupled(data[f.name]) for f in fields(cls) if f.name in data}
        try:
            for f in fields(cls):
                _check_type(f.name, f.default, given.get(f.name, f.default))
            settings = cls(**given)
            settings.usable()
        except (LfcalError, TypeError, ValueError):
            return cls()
        return settings

    @classmethod
    def of(cls, project: ProjectState) -> Self:
        """Return the settings in a project."""
        return cls.from_dict(project.settings.get(cls.page))

    def into(self, project: ProjectState) -> dict[str, Any]:
        """Return the settings of all pages of a project, with these among them."""
        return {**project.settings, self.page: self.to_dict()}


def _plain(value: Any) -> Any:
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def _tupled(value: Any) -> Any:
    return tuple(_tupled(v) for v in value) if isinstance(value, list) else value


def _check_type(name: str, default: Any, value: Any) -> None:
    """Raise where ``value`` is of another type than the default; a default of None says nothing."""
    kind = type(default)
    # bool is an int to Python, and 1 is as good as 1.0 in JSON
    allowed = {float: (float, int), int: (int,)}.get(kind, (kind,))
    wrong = not isinstance(value, allowed) or (isinstance(value, bool) and kind is not bool)
    if default is not None and wrong:
        raise InputError.expected(name, kind.__name__, repr(value), "correct it")
