"""The Simulate page: settings, the planner's verdicts as rows, previews of single positions, and H. No Qt."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from gui.models.settings import PageSettings
from lfcal.camera import ScanPlan
from lfcal.errors import InputError
from lfcal.progress import Work
from lfcal.units import format_length, format_seconds

if TYPE_CHECKING:
    from lfcal.simulate.accuracy.planner import EffectSelection

__all__ = [
    "LEVELS",
    "Z_STEPS",
    "EffectRow",
    "SimulateSettings",
    "Verdict",
    "depth_of",
    "iter_simulation",
    "preview",
    "preview_words",
    "tolerance_of",
    "tolerance_step",
    "verdict_of",
]

LEVELS = (
    ("auto", "auto: as the effects need"),
    ("geometric", "geometric: rays, instant"),
    ("wave", "wave: per lenslet"),
    ("microscope", "microscope: coherent"),
)
"""Levels of the computation, and what is shown of them."""

Z_STEPS = 200
"""Steps of the preview's depth."""

CHOICES = ("auto", "on", "off")

STEPS = 60
LOW, HIGH = 0.001, 0.5
_lock = threading.Lock()


@dataclass(frozen=True)
class SimulateSettings(PageSettings):
    """What the simulation is asked for.

    Attributes
    ----------
    tolerance
        Relative L1 error allowed for everything that is left out.
    level
        One of `LEVELS`.
    overrides
        Pairs of effect and ``"on"`` or ``"off"``; the planner decides on the others.
    """

    page: ClassVar[str] = "simulate"

    tolerance: float = 0.05
    level: str = "auto"
    overrides: tuple[tuple[str, str], ...] = ()

    def __post_init__(self) -> None:
        """Check every value."""
        if not 0 < self.tolerance < 1:
            raise InputError.expected("tolerance", "above 0 and below 1", self.tolerance, "correct it")
        if self.level not in dict(LEVELS):
            raise InputError.expected("level", " or ".join(dict(LEVELS)), self.level, "choose one of these")
        for effect, choice in self.overrides:
            if choice not in CHOICES:
                raise InputError.expected(f"choice for {effect}", " or ".join(CHOICES), choice, "choose one of these")

    def override(self, effect: str) -> str:
        """Return ``"auto"``, ``"on"`` or ``"off"`` for an effect."""
        return dict(self.overrides).get(effect, "auto")

    def with_override(self, effect: str, choice: str) -> SimulateSettings:
        """Return the settings with one effect's choice changed."""
        rest = {k: v for k, v in self.overrides if k != effect}
        if choice != "auto":
            rest[effect] = choice
        return replace(self, overrides=tuple(sorted(rest.items())))


@dataclass(frozen=True)
class EffectRow:
    """One effect as a row of the table."""

    name: str
    on: bool
    setting: str
    size: str
    error: str
    seconds: str
    reason: str
    formula: str


@dataclass(frozen=True, eq=False)
class Verdict:
    """What the planner found for a plan and settings, ready to be shown."""

    plan: ScanPlan
    settings: SimulateSettings
    rows: tuple[EffectRow, ...]
    level: str
    summary: str
    effects: tuple[Any, ...]

    def fits(self, plan: ScanPlan | None, settings: SimulateSettings) -> bool:
        """Return whether it is the answer for this plan and these settings."""
        return self.plan == plan and self.settings == settings


def tolerance_of(step: int) -> float:
    """Return the tolerance of a slider step: logarithmic from 0.1 % to 50 %."""
    value = LOW * (HIGH / LOW) ** (step / STEPS)
    return float(f"{value:.2g}")


def tolerance_step(tolerance: float) -> int:
    """Return the slider step of a tolerance: inverse of `tolerance_of`."""
    return round(STEPS * float(np.log(tolerance / LOW) / np.log(HIGH / LOW)))


def verdict_of(plan: ScanPlan, settings: SimulateSettings) -> Verdict:
    """Ask the planner and put its answer into words."""
    from lfcal.simulate.accuracy.planner import plan_effects

    found = plan_effects(plan.camera, plan, settings.tolerance, dict(settings.overrides))
    rows = tuple(
        EffectRow(
            row.name,
            row.on,
            row.setting,
            f"{row.estimate.size:.3g} {row.estimate.unit}".strip(),
            f"{'≤ ' if row.estimate.upper_bound else ''}{100 * row.estimate.error:.2g} %",
            format_seconds(row.seconds) if row.seconds > 0 else "free",
            row.reason,
            row.estimate.formula,
        )
        for row in found.rows
    )
    return Verdict(plan, settings, rows, found.level, summary_of(found), found.effects)


def summary_of(found: EffectSelection) -> str:
    """Return what the whole simulation will cost, in a line."""
    on = len(found.effects)
    return (
        f"{on} of {len(found.rows)} effects on, level {found.level}: about {format_seconds(found.seconds)} of "
        f"processor time for the whole H (ideal camera: {format_seconds(found.ideal_seconds)})"
    )


def preview(plan: ScanPlan, z_um: float, effects: tuple[Any, ...], level: str, tolerance: float) -> NDArray[np.float32]:
    """Return the pattern of the middle position at depth ``z_um``, ``(nt, ns)``; one preview is computed at a time."""
    from lfcal.simulate.simulate import simulate_psf

    ny, nx = plan.period
    middle = (plan.anchor[0] + ny // 2, plan.anchor[1] + nx // 2)
    one = replace(plan, depths_um=(z_um,), exposure_s=plan.exposures[0], period=(1, 1), anchor=middle, resample=False)
    with _lock:
        matrix = simulate_psf(plan.camera, one, effects, level, tolerance=tolerance, workers=1)
    pattern: NDArray[np.float32] = matrix[0, 0, 0]
    return pattern


def depth_of(plan: ScanPlan, step: int) -> float:
    """Return the depth (µm) of a step of the preview: from the nearest to the farthest plane, or about the only one."""
    low, high = min(plan.depths_um), max(plan.depths_um)
    if low == high:
        low, high = low - abs(low or 100) / 2, high + abs(high or 100) / 2
    return low + (high - low) * step / Z_STEPS


def preview_words(plan: ScanPlan, z_um: float, level: str) -> str:
    """Return the title of a preview; the level is empty while only rays are shown."""
    words = f"level {level}" if level else "rays …"
    return f"Preview at z = {format_length(z_um)}, v = {plan.camera.virtual_depth(z_um):.2f}: {words}"


def iter_simulation(plan: ScanPlan, settings: SimulateSettings, path: str, verdict: Verdict | None = None) -> Work[Any]:
    """Simulate H of ``plan`` into the file ``path``; asks the planner first unless ``verdict`` is its answer."""
    from lfcal.simulate.simulate import iter_simulate_psf

    if verdict is None or not verdict.fits(plan, settings):
        verdict = verdict_of(plan, settings)
    return (
        yield from iter_simulate_psf(
            plan.camera, plan, verdict.effects, settings.level, tolerance=settings.tolerance, out=path
        )
    )
