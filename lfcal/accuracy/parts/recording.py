"""Recording: error of H by the number of frames, for a scan with averaging and for a few patterns with a fit."""

from __future__ import annotations

import math
from dataclasses import replace

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import format_share
from lfcal.camera import Forecast, ScanPlan
from lfcal.fit import Expected, iter_next_positions
from lfcal.simulate import ExpectedLight, iter_expected_light

__all__ = ["EXPECTED", "FRAMES", "PART", "PATTERNS"]

FRAMES = (1, 2, 4, 8, 16, 32, 64)
"""Numbers of frames averaged at each position of the whole scan."""

PATTERNS, FEWEST = 24, 6
"""Number of patterns for which positions are designed, and the smallest number of them that is shown."""

EXPECTED = Expected(stage_px=0.05)
"""Expected conditions: brightest pixel at 80 % of the full well, source position error of a careful scan."""

CANDIDATES = 48
"""Number of candidate positions; with 300, the predicted error is about 2 % smaller, and large cameras take minutes."""


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the predicted error of H, first for whole scans with averaging, then for a fit to a few patterns."""
    plan = subject.planned
    light = yield from iter_expected_light(plan, subject.workers)
    yield Truth(
        "the light without noise, predicted by the noise forecast of the scan and by the Fisher information of the fit",
        (
            f"{plan.n_positions} positions; brightest pixel at {100 * EXPECTED.full:g} % of "
            f"{plan.camera.sensor.full_well_e:g} e-, source position error {EXPECTED.stage_px:g} px rms in the fit",
            "the rms error is relative to the root-mean-square of the light; do not compare it with the L1 error of "
            '"Recording: averaging and exposure", in which faint pixels weigh more',
            "the fit is correct only if its unknowns describe the camera; check it with the patterns held out",
        ),
    )
    for count in sorted({*FRAMES, plan.frames_averaged}):
        yield AccuracyStep(f"whole scan, {count} frames", 0.0)
        yield _scanned(plan, light, count)
    if plan.n_positions < PATTERNS:
        return
    yield AccuracyStep(f"{PATTERNS} patterns and a fit")
    design = yield from iter_next_positions(
        plan, PATTERNS, expected=EXPECTED, candidates=CANDIDATES, workers=subject.workers
    )
    for point in design.curve:
        if point.positions >= FEWEST:
            yield _fitted(plan, point.positions, point.error, point.hours)


def _scanned(plan: ScanPlan, light: ExpectedLight, count: int) -> CostPoint:
    """Return the point for the whole scan with ``count`` frames averaged."""
    scan = replace(plan, frames_averaged=count)
    noise = light.noise(scan, EXPECTED.full)
    error, cost = math.sqrt(sum(one**2 for one in noise) / len(noise)), Forecast.of(scan)
    label = f"whole scan, {count} frame{'s' * (count > 1)} each"
    settings = {"frames_averaged": count, "exposure_s": list(plan.exposures)}
    others = {"recording (s)": 3600 * cost.hours}
    return CostPoint(label, settings, error, float(cost.frames), "frames", others, in_use=scan == plan)


def _fitted(plan: ScanPlan, count: int, error: float, hours: float) -> CostPoint:
    """Return the point for ``count`` patterns, of which a fifth is held out, and a fit of the optics."""
    settings = {"fitted_patterns": count, "frames_averaged": plan.frames_averaged}
    share = format_share(count / plan.n_positions)
    frames = float(count * plan.frames_averaged)
    others = {"recording (s)": 3600 * hours}
    return CostPoint(f"{count} patterns and a fit", settings, error, frames, "frames", others, f"{share} of the scan")


PART = AccuracyPart(
    "recording",
    "Recording: whole scan, or a fit",
    "predicted relative rms error of H, due to noise",
    "frames to record",
    "frames",
    measure,
    rank=54,
)
