"""Settings of a watched series, the task, and what the table shows. No Qt."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from lfcal.recalibrate import DRIFT_NAMES, DriftWatch
from lfcal.records import from_flat
from lfcal.tasks import Watch
from lfcal_gui.models import PageSettings, ProjectState, fields_of, needed_file, options_in

HELD = frozenset({"psf", "frames", "out", "recalibrate"})
"""Fields of the task that have their own widgets."""

FIELDS = fields_of(Watch, without=HELD, more=False)
MORE = fields_of(Watch, without=HELD, more=True)

HEADER = ("Frame", "Shift x (px)", "Shift y (px)", "Gap (%)", "Goodness of fit", "T²", "Result")


@dataclass(frozen=True)
class WatchSettings(PageSettings):
    """Settings of the page.

    Attributes
    ----------
    frames
        Files or folders of frames.
    options
        Pairs of name and value of the fields of `lfcal.tasks.Watch` that are not at their defaults.
    """

    page: ClassVar[str] = "watch"

    frames: tuple[str, ...] = ()
    options: tuple[tuple[str, Any], ...] = ()

    @property
    def option_values(self) -> dict[str, Any]:
        """Values of ``options`` by name, with the types of the fields of the task."""
        return options_in(Watch, dict(self.options))

    def usable(self) -> None:
        """Raise `InputError` if values do not match."""
        from_flat(Watch, {"psf": Path("H.h5"), "frames": (Path("frames"),), **self.option_values})

    def changed(self, key: str, value: Any) -> WatchSettings:
        """Return the settings with one value changed."""
        if key == "frames":
            return replace(self, frames=tuple(value))
        chosen = options_in(Watch, {**self.option_values, key: value})
        found = replace(self, options=tuple(sorted((name, _plain(one)) for name, one in chosen.items())))
        found.usable()
        return found


def _plain(value: Any) -> Any:
    """Return a value without paths, because a project is written as JSON."""
    if isinstance(value, tuple):
        return tuple(map(_plain, value))
    return str(value) if isinstance(value, Path) else value


def task_of(settings: WatchSettings, project: ProjectState, out: str = "") -> Watch:
    """Return the task that checks the frames; with a folder ``out``, it also recalibrates H after a drift.

    Raises
    ------
    InputError
        If H or frames are missing, or values do not match.
    """
    psf = needed_file(project.psf, "H", "H")
    needed_file(settings.frames[0] if settings.frames else "", "frames", "Watch H")
    own: dict[str, Any] = {"psf": Path(psf), "frames": tuple(map(Path, settings.frames))}
    more = {"out": Path(out), "recalibrate": True} if out else {}
    return from_flat(Watch, own | more | settings.option_values)


Row = tuple[tuple[str, ...], tuple[float, ...]]


def rows_of(found: DriftWatch) -> list[Row]:
    """Return the texts and the numbers of a row for each frame."""
    tests = {name: one for one in found.means for name in one.frames}
    rows: list[Row] = []
    for one in found.frames:
        test, ratio = tests.get(one.name), math.nan if one.goodness is None else one.goodness.ratio
        square = math.nan if test is None else test.t_squared
        values = [
            f"{v:+.3f} ± {s:.3f}" if math.isfinite(v) else "" for v, s in zip(one.values, one.sigmas, strict=True)
        ]
        result = one.problem or ("alarm" if test is not None and test.alarm else "valid")
        fit, t = (f"{v:.{n}f}" if math.isfinite(v) else "" for v, n in ((ratio, 3), (square, 1)))
        rows.append(((one.name, *values, fit, t, result), (math.nan, *one.values, ratio, square, math.nan)))
    return rows


def trend_words(found: DriftWatch) -> str:
    """Return the trends and the basis of the threshold as text."""
    slopes = [
        f"{title} {own.slope:+.2g} ± {own.sigma:.1g} per {own.per}"
        for own, title in zip(found.trends, DRIFT_NAMES.values(), strict=False)
    ]
    return "\n".join(
        (
            *((f"Trend: {', '.join(slopes)}",) if slopes else ()),
            f"T² above {found.threshold:.1f} is an alarm; {found.basis}",
        )
    )
