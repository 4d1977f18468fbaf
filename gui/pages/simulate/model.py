"""What the Simulate page shows: the planner's verdicts as rows, and previews of single positions. No Qt."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gui.models.project import SimulateSettings
from lfcal.camera import ScanPlan
from lfcal.units import format_seconds

if TYPE_CHECKING:
    from lfcal.simulate.accuracy.planner import EffectPlan

__all__ = ["EffectRow", "Verdict", "preview", "tolerance_of", "tolerance_step", "verdict_of"]

STEPS = 60
LOW, HIGH = 0.001, 0.5
_lock = threading.Lock()


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
    """What the planner found, ready to be shown."""

    rows: tuple[EffectRow, ...]
    level: str
    summary: str
    effects: tuple[Any, ...]


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
    return Verdict(rows, found.level, summary_of(found), found.effects)


def summary_of(found: EffectPlan) -> str:
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
