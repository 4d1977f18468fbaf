"""Every effect as a row: what it acts on, what the planner says, and its magnitudes. No Qt."""

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

__all__ = [
    "FRAMES_ONLY",
    "LEAST",
    "EffectRow",
    "EffectsVerdict",
    "bar_share",
    "read_terms",
    "refused",
    "summary_of",
    "verdict_of",
]

LEAST = 1e-5
"""Share of the image at the left end of a bar; the right end is 1."""

FRAMES_ONLY = "acts on sensor frames, not on H"


@dataclass(frozen=True, eq=False)
class EffectRow:
    """One effect as a row of the table.

    Attributes
    ----------
    effect, name, title
        The effect with its magnitudes; what files and people call it.
    group
        What it acts on.
    enters_h
        Whether H shows it; else frames alone do, and the verdict is theirs.
    on, setting, reason, brief
        What the planner decided, what the user chose, and why: in a sentence, and in a word or two.
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
    brief: str
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

    def brief_text(self) -> str:
        """Return the verdict in a few words; the numbers stand in other columns and in `verdict_text`."""
        return f"{'on' if self.on else 'off'}: {self.brief}"

    def verdict_text(self) -> str:
        """Return the verdict and its reason in words."""
        where = "" if self.enters_h else " in frames"
        return f"{'on' if self.on else 'off'}{where}: {self.reason}"


@dataclass(frozen=True, eq=False)
class EffectsVerdict:
    """What the planner found for a plan and settings, ready to be shown.

    Attributes
    ----------
    found, frames
        For H, and for the frames of a session.
    """

    plan: ScanPlan
    settings: SimulateSettings
    rows: tuple[EffectRow, ...]
    summary: str
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
    return EffectsVerdict(plan, settings, rows, summary_of(found, settings), found, frames)


def _row(planned: PlannedEffect, plan: ScanPlan, settings: SimulateSettings) -> EffectRow:
    from lfcal.simulate.effects import magnitudes_of

    effect, estimate = planned.effect, planned.estimate
    marks = {field: mark for field, (_, mark) in settings.given(effect.name).items()}
    magnitudes = magnitudes_of(effect, plan.camera, marks)
    reason, brief = planned.reason, planned.brief
    if planned.setting == "on" and any(one.kind == "terms" and not one.counts for one in magnitudes):
        reason, brief = "asked for, but it needs terms: add at least one", "needs terms"
    return EffectRow(
        effect,
        effect.name,
        effect.title,
        effect.acts_on.value,
        effect.acts_on.enters_h,
        planned.on,
        planned.setting,
        reason,
        brief,
        estimate.error,
        estimate.upper_bound,
        f"{estimate.size:.3g} {estimate.unit}".strip(),
        estimate.formula,
        planned.seconds,
        magnitudes,
    )


def summary_of(found: EffectSelection, settings: SimulateSettings) -> str:
    """Return what the whole simulation will cost, in a line; effects that are not installed are named."""
    known = [row for row in found.rows if row.effect.acts_on.enters_h]
    missing = settings.missing()
    words = (
        f"{sum(row.on for row in known)} of {len(known)} effects on H are on, level {found.level}: about "
        f"{format_seconds(found.seconds)} of processor time for the whole H (ideal camera: "
        f"{format_seconds(found.ideal_seconds)})"
    )
    return words + (f". Not installed, and left out: {', '.join(missing)}" if missing else "")


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
        In one line that names the row, for what the effect cannot have.
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
            # by itself, so that it is this row that is refused
            effect_from(effect, {magnitude.field: [(first, second, third)]})
        except InputError as error:
            raise InputError(f"row {k + 1}: {error}") from None
        terms.append((int(first), int(second), third))
    return tuple(terms)
