"""Settings of one page, stored in the project under the page's key. No Qt."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar, Self

from lfcal.base import InputError, LfcalError, check_number
from lfcal_gui.models.project import ProjectState


@dataclass(frozen=True)
class PageSettings:
    """Base of a page's settings: a frozen record whose fields all have defaults and are plain values or tuples.

    A subclass names its page in the class variable ``page``. The project stores the result of `to_dict`, so that it
    can be saved without knowing any page, and so that the settings of a page that is not installed are kept.
    """

    page: ClassVar[str]

    def usable(self) -> None:
        """Raise `InputError` if values that are valid separately do not match."""

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types."""
        return {f.name: _plain(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_dict(cls, data: object) -> Self:
        """Return the settings in ``data``; missing and refused values take their defaults."""
        return cls.read(data)[0]

    @classmethod
    def read(cls, data: object) -> tuple[Self, tuple[str, ...]]:
        """Return the settings in ``data``, and one line for each refused value, which takes its default."""
        if not isinstance(data, Mapping):
            wrong = f"settings of {cls.page}: expected an object, got {data!r:.40}"
            return cls(), () if data is None else (wrong,)
        given = {f.name: _tupled(data[f.name]) for f in fields(cls) if f.name in data}
        defaults = {f.name: f.default for f in fields(cls)}

        def reason(names: Iterable[str]) -> str:
            """Return why these values together are refused; empty if they are accepted."""
            try:
                for name in names:
                    _check_type(name, defaults[name], given[name])
                cls(**{name: given[name] for name in names}).usable()
            except (LfcalError, TypeError, ValueError) as error:
                return str(error)
            return ""

        taken = list(given)
        if reason(taken):
            taken = []
            # twice, since a value may depend on a later one
            for name in (*given, *given):
                if name not in taken and not reason([*taken, name]):
                    taken.append(name)
        refused = [name for name in given if name not in taken]
        lines = tuple(f"settings of {cls.page}: {name}: {reason([*taken, name])}" for name in refused)
        return cls(**{name: given[name] for name in taken}), lines

    @classmethod
    def of(cls, project: ProjectState) -> Self:
        """Return the settings in a project."""
        return cls.from_dict(project.settings.get(cls.page))

    def changed(self, key: str, value: Any) -> Self:
        """Return the settings with one field changed; raise `LfcalError` if the value is refused."""
        return replace(self, **{key: value})

    def why_not(self, key: str, value: Any) -> str:
        """Return why a field cannot have a value; empty if it can."""
        try:
            self.changed(key, value)
        except LfcalError as error:
            return str(error)
        return ""

    def into(self, project: ProjectState) -> dict[str, Any]:
        """Return the settings of all pages of a project, updated with these."""
        return {**project.settings, self.page: self.to_dict()}


def _plain(value: Any) -> Any:
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def _tupled(value: Any) -> Any:
    return tuple(_tupled(v) for v in value) if isinstance(value, list) else value


def _check_type(name: str, default: Any, value: Any) -> None:
    """Raise if ``value`` is of another type than the default, unless the default is None."""
    kind = type(default)
    # bool is an int in Python, and JSON may write 1.0 as 1
    allowed = {float: (float, int), int: (int,)}.get(kind, (kind,))
    wrong = not isinstance(value, allowed) or (isinstance(value, bool) and kind is not bool)
    if default is not None and wrong:
        raise InputError.expected(name, kind.__name__, repr(value), "correct this entry")


@dataclass(frozen=True, kw_only=True)
class ScanRates(PageSettings):
    """Speed of the stage (µm/s) and frame rate of the camera (frames/s, None: unknown), as typed in Set up."""

    page: ClassVar[str] = "plan"
    speed: float = 1000.0
    frame_rate: float | None = None

    def usable(self) -> None:
        """Raise `InputError` if a forecast would refuse a value."""
        for name, value in (("speed", self.speed), ("frame rate", self.frame_rate)):
            if value is not None:
                check_number(name, value, at_least=1e-6)

    def forecast_keywords(self) -> dict[str, Any]:
        """Return the keywords of the forecasts of plans."""
        return {"stage_um_per_s": self.speed, "frames_per_s": self.frame_rate}


@dataclass(frozen=True)
class OpeningSettings(PageSettings):
    """Properties of files that the files do not state.

    Attributes
    ----------
    mat_orders
        Pairs of a .mat file and the order of the axes of its H, as ``mat_order`` of `lfcal.psf.open_psf`.
    """

    page: ClassVar[str] = "opening"

    mat_orders: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Check every pair."""
        for pair in self.mat_orders:
            if not isinstance(pair, tuple) or len(pair) != 2 or not all(isinstance(part, str) for part in pair):
                raise InputError.expected(
                    "mat_orders", "pairs of file and order", repr(pair), "give the file and the order of its axes"
                )
            from lfcal.psf import check_mat_order

            check_mat_order(pair[1])

    def with_order(self, path: str, order: str) -> OpeningSettings:
        """Return the settings with ``order`` stated for the file ``path``."""
        others = tuple(pair for pair in self.mat_orders if pair[0] != path)
        return OpeningSettings((*others, (path, order)))


def stated_order(project: ProjectState, path: str) -> str:
    """Return the order of the axes of H that the user stated for a .mat file; empty if none."""
    return dict(OpeningSettings.of(project).mat_orders).get(path, "")
