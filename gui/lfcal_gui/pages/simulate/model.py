"""Record > Compute: settings, their files, and previews of single positions. No Qt."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self, TypeVar

from lfcal.base import InputError, any_of, format_seconds, format_share
from lfcal.camera import ScanPlan
from lfcal.records import from_flat, rows
from lfcal.tasks import SimulateFrames, SimulateH, SimulatePasses
from lfcal_gui.models import PLAN_FILE, Field, PageSettings, Shot, fields_of, plane_words, text_in_form

if TYPE_CHECKING:
    from lfcal.accuracy import CostPoint, Curve
    from lfcal.simulate import EffectSelection
    from lfcal.simulate.effects import Effect, Entry

T = TypeVar("T")

KINDS = (SimulateH, SimulatePasses, SimulateFrames)
"""Tasks of the page."""

HELD = frozenset({"camera", "depths", "virtual_depths", "cutout", "effects", "out", "frames"})
"""Fields of the tasks that the form does not show: plan, effects and output."""

ROWS = {row.name: row for kind in KINDS for row in rows(kind) if row.name not in HELD}


OF_FRAMES = ("seed", "peak")


def _fields() -> tuple[tuple[Field, ...], ...]:
    found = {
        one.key: one for kind in KINDS for more in (False, True) for one in fields_of(kind, without=HELD, more=more)
    }
    frames = tuple(found.pop(key) for key in OF_FRAMES)
    return (found.pop("tolerance"),), tuple(found.values()), frames


FIELDS = _fields()
"""Fields of the three forms: always visible, folded for H, folded for frames."""

WORTH = 0.85
"""Largest time of a proposed setting, relative to the setting in use; times are not measured more accurately."""

CHOICES = ("auto", "on", "off")

GIVEN = ("stated", "measured")
"""Sources of a magnitude given by the user, as in `lfcal.simulate.effects.magnitudes`."""

_lock = threading.Lock()


def refusal(name: str, value: Any) -> str:
    """Return why a value of a field is refused; empty if it is accepted."""
    try:
        if name != "progressive":  # it chooses the task
            ROWS[name].value(value, ROWS[name].label)
    except InputError as error:
        return str(error)
    return ""


def shown(name: str, settings: SimulateSettings) -> Any:
    """Return the value of a field shown in the form."""
    value = getattr(settings, name)
    return text_in_form(ROWS[name], value) if ROWS[name].opt.read is not None else value


@dataclass(frozen=True)
class SimulateSettings(PageSettings):
    """Settings of the simulation.

    Attributes
    ----------
    tolerance, level, store_tolerance, seed, peak
        As in the tasks; see `KINDS`.
    overrides
        Pairs of effect and ``"on"`` or ``"off"``; the planner decides on the others.
    magnitudes
        Magnitudes given by the user, as (effect, field, value, source: ``"stated"`` or ``"measured"``). Those of
        effects that are not installed are kept.
    progressive
        Whether H is simulated in passes.
    """

    page: ClassVar[str] = "simulate"

    tolerance: float = SimulateH.tolerance
    level: str = SimulateH.level
    overrides: tuple[tuple[str, str], ...] = ()
    magnitudes: tuple[tuple[str, str, Any, str], ...] = ()
    progressive: bool = False
    store_tolerance: float | None = None
    seed: int = SimulateFrames.seed
    peak: float = SimulateFrames.peak

    def __post_init__(self) -> None:
        """Check every value."""
        for name, row in ROWS.items():
            if name != "progressive":  # it chooses the task
                object.__setattr__(self, name, row.value(getattr(self, name), name))
        for effect, choice in self.overrides:
            if choice not in CHOICES:
                raise InputError.expected(f"choice for {effect}", any_of(CHOICES), choice, "choose one of these")
        for effect, field, _, mark in self.magnitudes:
            if not isinstance(effect, str) or not isinstance(field, str) or mark not in GIVEN:
                raise InputError.expected(f"{field} of {effect}", any_of(GIVEN), mark, "choose one of these")

    @classmethod
    def read(cls, data: object) -> tuple[Self, tuple[str, ...]]:
        """Return the settings in ``data``, and the reasons for refused values, as `PageSettings.read` does.

        Earlier projects contain ``passes`` instead of ``progressive``.
        """
        if isinstance(data, Mapping) and "passes" in data:
            data = {"progressive": data["passes"], **data}
        return super().read(data)

    def usable(self) -> None:
        """Raise `InputError` if the effects cannot have these magnitudes."""
        self.effects()

    def with_override(self, effect: str, choice: str) -> SimulateSettings:
        """Return the settings with one effect's choice changed."""
        rest = {k: v for k, v in self.overrides if k != effect}
        if choice != "auto":
            rest[effect] = choice
        return replace(self, overrides=tuple(sorted(rest.items())))

    def given(self, effect: str) -> dict[str, tuple[Any, str]]:
        """Return the magnitudes given for an effect, as a mapping from field to value and source."""
        return {field: (value, mark) for name, field, value, mark in self.magnitudes if name == effect}

    def with_magnitude(self, effect: str, field: str, value: Any, mark: str = "stated") -> SimulateSettings:
        """Return the settings with a magnitude given; None as the value removes it.

        Raises
        ------
        InputError
            If the effect cannot have this value.
        """
        rest = [entry for entry in self.magnitudes if entry[:2] != (effect, field)]
        if value is not None:
            rest.append((effect, field, value, mark))
        changed = replace(self, magnitudes=tuple(sorted(rest, key=lambda entry: entry[:2])))
        changed.usable()
        return changed

    def effects(self) -> tuple[Effect, ...]:
        """Return the installed effects with given magnitudes."""
        from lfcal.simulate.effects import CATALOGUE, effect_from

        names = dict.fromkeys(entry[0] for entry in self.magnitudes if entry[0] in CATALOGUE)
        return tuple(effect_from(n, {field: value for field, (value, _) in self.given(n).items()}) for n in names)

    def choices(self) -> dict[str, str]:
        """Return the choices (on, off) for installed effects."""
        from lfcal.simulate.effects import CATALOGUE

        return {name: choice for name, choice in self.overrides if name in CATALOGUE}

    def entries(self) -> tuple[Entry, ...]:
        """Return the given magnitudes and choices of installed effects."""
        from lfcal.simulate.effects import Entry

        effects, choices = {effect.name: effect for effect in self.effects()}, self.choices()
        marks = {name: {field: mark for field, (_, mark) in self.given(name).items()} for name in effects}
        return tuple(
            Entry(effects.get(name), name, marks.get(name, {}), choices.get(name, "auto"))
            for name in sorted({*effects, *choices})
        )

    def missing(self) -> tuple[str, ...]:
        """Return the names of effects in the settings that are not installed."""
        from lfcal.simulate.effects import CATALOGUE

        named = [*dict(self.overrides), *(entry[0] for entry in self.magnitudes)]
        return tuple(name for name in dict.fromkeys(named) if name not in CATALOGUE)


def matrix_task(settings: SimulateSettings, out: str) -> SimulateH | SimulatePasses:
    """Return the task that simulates H of the plan in `PLAN_FILE`; lossy storage does not apply to passes."""
    if settings.progressive:
        return _task_of(SimulatePasses, settings, out=Path(out))
    return _task_of(SimulateH, settings, out=Path(out))


def frames_task(settings: SimulateSettings, folder: str) -> SimulateFrames:
    """Return the task that simulates the frames of the plan in `PLAN_FILE`."""
    return _task_of(SimulateFrames, settings, frames=Path(folder))


def _task_of(kind: type[T], settings: SimulateSettings, **more: Path) -> T:
    from lfcal.simulate.effects import effect_words

    own = {row.name: getattr(settings, row.name) for row in rows(kind) if row.name in ROWS}
    return from_flat(kind, own | {"camera": PLAN_FILE, "effects": effect_words(settings.entries())} | more)


def kept_pass(path: str) -> str:
    """Return the accuracy of the H left by a stopped run in passes, as text; empty if there is none."""
    from lfcal.psf import open_psf
    from lfcal.work import PASS, parts_folder, read_events

    if PASS not in read_events(parts_folder(path)) or not Path(path).exists():
        return ""
    with open_psf(path) as matrix:
        return f"all planes within {100 * max(float(error) for error in matrix.facts.known()['error']):.2g} %"


def pattern_of(
    plan: ScanPlan,
    place: tuple[int, int, int],
    effects: EffectSelection | tuple[Effect, ...],
    level: str,
    tolerance: float,
) -> Shot:
    """Return the pattern of H at position ``place`` (z, y, x); the title states how it was computed.

    Only one pattern is computed at a time.
    """
    from lfcal.simulate import PlaneResponse, budgeted
    from lfcal.simulate.accuracy import rung_label

    z, y, x = place
    chosen, share = budgeted(effects, plan, tolerance).at(plan.depths_um[z])
    with _lock:
        response = PlaneResponse(plan, z, chosen, level=level, tolerance=share)
        values = response.rows([y], [x], workers=1)[0, 0]
    how = rung_label(response.level, None if response.level == "geometric" else response.settled)
    words, pixel = f"{plane_words(z, plan.shape[0])}, y {y}, x {x}: {how}", plan.camera.sensor.pixel_um
    return Shot(values, words, name="pattern", pixel_um=pixel)


def used_point(curve: Curve | None, settings: SimulateSettings) -> CostPoint | None:
    """Return the measured setting in use: the coarsest whose tolerance is at most that of the settings.

    Curves are measured at level auto with the planner's effects; for other choices there is none.
    """
    if curve is None or settings.level != "auto" or settings.overrides or settings.magnitudes:
        return None
    good = [point for point in curve.points if point.settings["tolerance"] <= settings.tolerance * (1 + 1e-9)]
    return max(good, key=lambda point: float(point.settings["tolerance"]), default=None)


def numbers_of(point: CostPoint | None, settings: SimulateSettings, seconds: float | None) -> tuple[str, str, str, str]:
    """Return time and error of H, each with its meaning; ``seconds``: duration of computing H on this machine."""
    time = "…" if seconds is None else format_seconds(seconds)
    if point is not None:
        return time, "for all of H", format_share(point.error), "error, measured"
    return time, "for all of H", format_share(settings.tolerance), "error requested"


def better_words(curve: Curve | None, point: CostPoint | None, paced: Callable[[float], float]) -> str:
    """Return a sentence on a measured setting that is faster and no less exact than ``point``; empty if none is.

    Parameters
    ----------
    curve, point
        Measured curve, and the setting in use.
    paced
        Returns the duration on this machine (s) for a processor time (s).
    """
    if curve is None or point is None:
        return ""
    better = min((one for one in curve.front if one.error <= point.error), key=lambda one: one.cost)
    if better.cost > WORTH * point.cost:
        return ""
    asked = f"Tolerance {100 * better.settings['tolerance']:g} %"
    took, error = format_seconds(paced(better.cost)), format_share(better.error)
    return f"{asked} is faster and no less exact: {took}, error {error}."


def settings_text(settings: SimulateSettings) -> str:
    """Return the text of a JSON file with the magnitudes and choices of installed effects."""
    from lfcal.simulate.effects import entries_json

    return entries_json(settings.entries())


def read_settings(path: Path, settings: SimulateSettings) -> tuple[SimulateSettings, str]:
    """Return ``settings`` with the effects of the file replacing those of the settings, and a line of text.

    An effect that the file names without a magnitude is switched on if nothing else would simulate it.

    Raises
    ------
    LfcalError
        If the file contains no effects, or unknown ones.
    """
    from lfcal.simulate.effects import read_entries

    entries = read_entries(path)
    names = {entry.name for entry in entries}
    kept = replace(settings, magnitudes=tuple(one for one in settings.magnitudes if one[0] not in names))
    for entry in entries:
        bare = entry.effect is not None and not entry.given and entry.effect.deviation
        kept = kept.with_override(entry.name, "on" if bare and entry.setting == "auto" else entry.setting)
        for field, mark in entry.given.items():
            kept = kept.with_magnitude(entry.name, field, getattr(entry.effect, field), mark)
    count = len(names)
    return kept, f"{count} effect{('' if count == 1 else 's')} imported from {path.name}"
