"""Effects as table rows: decision of the planner, error of the image, and magnitudes. No Qt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError, format_seconds, format_share
from lfcal.camera import ScanPlan
from lfcal_gui.pages.simulate.model import SimulateSettings, frames_task

if TYPE_CHECKING:
    from lfcal.simulate import EffectMeasurement, EffectSelection, PlannedEffect, UndescribedEffects
    from lfcal.simulate.effects import Effect, Magnitude

LEAST = 1e-5
"""Error of the image at the left end of a bar; the right end is 1."""

FRAMES_ONLY = "affects sensor frames, not H"


@dataclass(frozen=True, eq=False)
class EffectRow:
    """One effect as a row of the table.

    Attributes
    ----------
    effect, name, title
        Effect with its magnitudes; its name in files; its displayed name.
    group
        One of `GROUPS`.
    enters_h
        Whether the effect affects H; else it affects only frames, and the decision is that for frames.
    on, setting, reason
        Decision of the planner, choice of the user, and reason.
    share, upper_bound, size, formula
        Estimated error of the image without the effect, whether this is an upper bound, size with unit, and how error
        and size were found.
    seconds_with, seconds_without
        Forecast of the processor time of H with and without the effect (s).
    magnitudes
        Magnitudes of the effect.
    """

    effect: Effect
    name: str
    title: str
    group: str
    enters_h: bool
    on: bool
    setting: str
    reason: str
    share: float
    upper_bound: bool
    size: str
    formula: str
    seconds_with: float
    seconds_without: float
    magnitudes: tuple[Magnitude, ...]

    @property
    def given(self) -> bool:
        """Whether the user gave a magnitude of the effect."""
        return any(one.source == "given" for one in self.magnitudes)

    def share_text(self) -> str:
        """Return the error of the image as text."""
        if 0 < self.share < LEAST:
            return f"< {100 * LEAST:g} %"
        return f"{'≤ ' if self.upper_bound else ''}{format_share(self.share)}"

    def seconds_text(self) -> str:
        """Return the processor time of H with and without the effect as text."""
        before, after = self.seconds_without, self.seconds_with
        return "free" if after == before else f"{format_seconds(after)} with it, {format_seconds(before)} without it"

    def verdict_text(self) -> str:
        """Return the decision and its reason as text."""
        where = "" if self.enters_h else " in frames"
        return f"{'on' if self.on else 'off'}{where}: {self.reason}"


@dataclass(frozen=True, eq=False)
class EffectsVerdict:
    """Decisions of the planner for a plan and settings, ready to be shown.

    Attributes
    ----------
    unknown
        Effects that the camera does not describe, largest first, and effects that are not installed, as text; empty if
        there are none.
    missing
        Effects that the camera does not describe, with the measurements that determine them.
    found, frames
        Decisions for H, and for the frames of a session.
    """

    plan: ScanPlan
    settings: SimulateSettings
    rows: tuple[EffectRow, ...]
    unknown: str
    missing: UndescribedEffects
    found: EffectSelection
    frames: EffectSelection

    def fits(self, plan: ScanPlan | None, settings: SimulateSettings) -> bool:
        """Return whether the decisions are for this plan and these settings."""
        return self.plan == plan and self.settings == settings

    def row(self, name: str) -> EffectRow | None:
        """Return the row of an effect; None if there is none."""
        return next((row for row in self.rows if row.name == name), None)


def verdict_of(plan: ScanPlan, settings: SimulateSettings) -> EffectsVerdict:
    """Return the decisions of the planner for H and for frames, as table rows."""
    from lfcal.simulate import undescribed_effects

    task = frames_task(settings, "frames")
    found = task.selection(plan)
    frames = task.selection(plan, frames=True, peak=task.peak)
    rows = tuple(
        _row(row if row.effect.acts_on.enters_h else frames.row(row.name), plan, settings) for row in found.rows
    )
    missing = undescribed_effects(found, plan.camera)
    return EffectsVerdict(plan, settings, rows, unknown_words(missing, settings), missing, found, frames)


def _row(planned: PlannedEffect, plan: ScanPlan, settings: SimulateSettings) -> EffectRow:
    from lfcal.simulate.effects import magnitudes_of

    effect, estimate = planned.effect, planned.estimate
    marks = {field: mark for field, (_, mark) in settings.given(effect.name).items()}
    magnitudes = magnitudes_of(effect, plan.camera, marks)
    reason = planned.reason
    if planned.setting == "on" and any(one.kind == "terms" and not one.counts for one in magnitudes):
        reason = "switched on, but it has no terms; add at least one row"
    return EffectRow(
        effect,
        effect.name,
        effect.title,
        _group(planned),
        effect.acts_on.enters_h,
        planned.on,
        planned.setting,
        reason,
        estimate.error,
        estimate.upper_bound,
        f"{estimate.size:.3g} {estimate.unit}".strip(),
        estimate.formula,
        planned.seconds_with,
        planned.seconds_without,
        magnitudes,
    )


def _group(planned: PlannedEffect) -> str:
    if not planned.effect.acts_on.enters_h:
        return "frames"
    if planned.on:
        return "on"
    if planned.setting == "off":
        return "switched"
    return "unknown" if planned.effect.deviation else "small"


def unknown_words(missing: UndescribedEffects, settings: SimulateSettings) -> str:
    """Return the effects that the camera does not describe, and those that are not installed, as text."""
    words = missing.sentence[:1].upper() + missing.sentence[1:]
    names = settings.missing()
    absent = f"Not installed, so omitted: {', '.join(names)}" if names else ""
    return ". ".join(filter(None, (words, absent)))


def measurement_words(missing: UndescribedEffects) -> str:
    """Return the measurements that determine undescribed effects, with their commands, as text; empty if none."""
    lines = missing.lines("camera.json")
    return "\n".join(("Measurements that determine them, the cheapest first:", *lines)) if lines else ""


def determined_words(measurement: EffectMeasurement) -> str:
    """Return the effects that a measurement determines, largest first, as text."""
    return "; ".join(f"{row.effect.title}, {format_share(row.estimate.error)}" for row in measurement.rows)


GROUPS = {
    "on": "On",
    "switched": "Switched off",
    "small": "Off, below {tolerance}",
    "unknown": "Off, not described",
    "frames": "In frames, not in H",
}
"""Groups of effects, in the order of the table."""


def group_title(group: str, rows: Sequence[EffectRow], tolerance: float) -> str:
    """Return the title of a group with the number of its effects."""
    title = GROUPS[group].format(tolerance=format_share(tolerance))
    count = f"{sum(row.on for row in rows)} of {len(rows)} on" if group == "frames" else f"{len(rows)}"
    return f"{title}: {count}"


def refused(effect: str, magnitude: Magnitude, text: str) -> tuple[Any, str]:
    """Return the value of a typed text, and why the effect cannot have it (empty if it can)."""
    from lfcal.simulate.effects import effect_from

    try:
        value = magnitude.read(text)
        effect_from(effect, {magnitude.field: value})
    except InputError as error:
        return None, str(error)
    return value, ""


def bar_share(share: float) -> float:
    """Return the length of the bar of an error, from 0 to 1; it is logarithmic from `LEAST` to 1."""
    if share <= LEAST:
        return 0.0
    return min(1.0, 1.0 - math.log10(share) / math.log10(LEAST))


def read_terms(effect: str, magnitude: Magnitude, rows: Sequence[Sequence[str]]) -> tuple[tuple[int, int, float], ...]:
    """Return the triples for rows of typed text, such as Zernike terms; empty rows are ignored.

    Raises
    ------
    InputError
        If the effect cannot have a value; the message names the row.
    """
    from lfcal.simulate.effects import effect_from, number_in

    terms = []
    for k, row in enumerate(rows):
        if not any(word.strip() for word in row):
            continue
        if not all(word.strip() for word in row):
            raise InputError(f"row {k + 1}: a cell is empty; fill in {', '.join(magnitude.columns)}")
        try:
            first, second, third = (
                number_in(name, word, {}) for name, word in zip(magnitude.columns, row, strict=True)
            )
            # each row alone, so that the error names the right one
            effect_from(effect, {magnitude.field: [(first, second, third)]})
        except InputError as error:
            raise InputError(f"row {k + 1}: {error}") from None
        terms.append((int(first), int(second), third))
    return tuple(terms)
