"""Every effect as a row: what the planner says, its share of the image, and its magnitudes. No Qt."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError, format_seconds, format_share
from lfcal.camera import ScanPlan
from lfcal_gui.pages.simulate.model import SimulateSettings, frames_task

if TYPE_CHECKING:
    from lfcal.simulate import EffectSelection, PlannedEffect
    from lfcal.simulate.effects import Effect, Magnitude

LEAST = 1e-5
"""Share of the image at the left end of a bar; the right end is 1."""

NAMED = 3
"""Effects that are named of those that are not described."""

FRAMES_ONLY = "acts on sensor frames, not on H"


@dataclass(frozen=True, eq=False)
class EffectRow:
    """One effect as a row of the table.

    Attributes
    ----------
    effect, name, title
        The effect with its magnitudes; what files and people call it.
    group
        One of `GROUPS`.
    enters_h
        Whether H shows it; else frames alone do, and the verdict is theirs.
    on, setting, reason
        What the planner decided, what the user chose, and why.
    share, upper_bound, size, formula
        Estimated share of the image that is wrong without it, whether that is at most so; size with unit; how both
        were found.
    seconds
        What it costs (CPU-seconds of the whole plan).
    magnitudes
        What can be given of it.
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
    seconds: float
    magnitudes: tuple[Magnitude, ...]

    @property
    def given(self) -> bool:
        """Whether the user gave a magnitude of it."""
        return any(one.source == "given" for one in self.magnitudes)

    def share_text(self) -> str:
        """Return the share in words."""
        if 0 < self.share < LEAST:
            return f"< {100 * LEAST:g} %"
        return f"{'≤ ' if self.upper_bound else ''}{format_share(self.share)}"

    def seconds_text(self) -> str:
        """Return the cost in words."""
        return format_seconds(self.seconds) if self.seconds > 0 else "free"

    def verdict_text(self) -> str:
        """Return the verdict and its reason in words."""
        where = "" if self.enters_h else " in frames"
        return f"{'on' if self.on else 'off'}{where}: {self.reason}"


@dataclass(frozen=True, eq=False)
class EffectsVerdict:
    """What the planner found for a plan and settings, ready to be shown.

    Attributes
    ----------
    unknown
        What the camera's description lacks, the largest first; empty: nothing.
    found, frames
        For H, and for the frames of a session.
    """

    plan: ScanPlan
    settings: SimulateSettings
    rows: tuple[EffectRow, ...]
    unknown: str
    found: EffectSelection
    frames: EffectSelection

    def fits(self, plan: ScanPlan | None, settings: SimulateSettings) -> bool:
        """Return whether it is the answer for this plan and these settings."""
        return self.plan == plan and self.settings == settings

    def row(self, name: str) -> EffectRow | None:
        """Return the row of an effect, None where there is none."""
        return next((row for row in self.rows if row.name == name), None)


def verdict_of(plan: ScanPlan, settings: SimulateSettings) -> EffectsVerdict:
    """Ask the planner, for H and for frames, and put its answer into words."""
    task = frames_task(settings, "frames")
    found = task.selection(plan)
    frames = task.selection(plan, frames=True, peak=task.peak)
    rows = tuple(
        _row(row if row.effect.acts_on.enters_h else frames.row(row.name), plan, settings) for row in found.rows
    )
    return EffectsVerdict(plan, settings, rows, unknown_words(rows, settings), found, frames)


def _row(planned: PlannedEffect, plan: ScanPlan, settings: SimulateSettings) -> EffectRow:
    from lfcal.simulate.effects import magnitudes_of

    effect, estimate = planned.effect, planned.estimate
    marks = {field: mark for field, (_, mark) in settings.given(effect.name).items()}
    magnitudes = magnitudes_of(effect, plan.camera, marks)
    reason = planned.reason
    if planned.setting == "on" and any(one.kind == "terms" and not one.counts for one in magnitudes):
        reason = "switched on, but it needs terms: add at least one"
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
        planned.seconds,
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


def unknown_words(rows: Sequence[EffectRow], settings: SimulateSettings) -> str:
    """Return what the camera's description lacks, and which effects of the settings are not installed."""
    undescribed = sorted(
        (row for row in rows if row.group == "unknown" and row.share >= LEAST), key=lambda row: -row.share
    )
    named = "; ".join(f"{row.title}, up to {format_share(row.share)}" for row in undescribed[:NAMED])
    words = f"Not described: {named} of the image" if named else ""
    missing = settings.missing()
    absent = f"Not installed, and left out: {', '.join(missing)}" if missing else ""
    return ". ".join(filter(None, (words, absent)))


GROUPS = {
    "on": "On",
    "switched": "Switched off",
    "small": "Off, below {tolerance}",
    "unknown": "Off, not described by the camera",
    "frames": "On frames, not on H",
}
"""Groups of effects, in the order of the table."""


def group_title(group: str, rows: Sequence[EffectRow], tolerance: float) -> str:
    """Return the title of a group with the number of its effects."""
    title = GROUPS[group].format(tolerance=format_share(tolerance))
    count = f"{sum(row.on for row in rows)} of {len(rows)} on" if group == "frames" else f"{len(rows)}"
    return f"{title}: {count}"


def refused(effect: str, magnitude: Magnitude, text: str) -> tuple[Any, str]:
    """Return the value that a typed text means, and why the effect cannot have it, or an empty string."""
    from lfcal.simulate.effects import effect_from

    try:
        value = magnitude.read(text)
        effect_from(effect, {magnitude.field: value})
    except InputError as error:
        return None, str(error)
    return value, ""


def bar_share(share: float) -> float:
    """Return how long the bar of a share of the image is, from 0 to 1: logarithmic from `LEAST` to 1."""
    if share <= LEAST:
        return 0.0
    return min(1.0, 1.0 - math.log10(share) / math.log10(LEAST))


def read_terms(effect: str, magnitude: Magnitude, rows: Sequence[Sequence[str]]) -> tuple[tuple[int, int, float], ...]:
    """Return the triples that rows of typed words mean, such as Zernike terms; empty rows mean none.

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
            raise InputError(f"row {k + 1}: {', '.join(magnitude.columns)} are needed")
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
