"""Whether frames of a target are better shown several at once, and the plan that shows them so."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lfcal.base import InputError

if TYPE_CHECKING:
    from lfcal.multiplex import CodingVerdict
    from lfcal.targets import Display, TargetPlan

__all__ = [
    "PEAK",
    "coding_verdict",
    "coding_words",
    "display_words",
    "planned_for_display",
]

PEAK = 0.8
"""Of the full well, in the brightest pixel of a point, where nothing else is said: the exposure of a session."""


def coding_verdict(plan: TargetPlan, z: int | None = None, signal_e: float | None = None) -> CodingVerdict | None:
    """Return whether showing several frames of a plane at once pays; None where there are too few, or one hole.

    Parameters
    ----------
    plan
        The target's, whose frames would be shown as the sums that an S-matrix says.
    z
        Plane; None: the middle one.
    signal_e
        Electrons of a point's brightest pixel in a frame; None: `PEAK` of the full well.

    Raises
    ------
    InputError
        If there are more electrons than the sensor holds.
    """
    from lfcal.multiplex import coding_pays, sensor_noise
    from lfcal.targets import group_order, subset_patterns

    at = len(plan.scan.depths_um) // 2 if z is None else z
    order = group_order(len(plan.offsets_px[at]))
    if not order or len(plan.target.holes) < 2:
        return None
    noise = sensor_noise(plan.scan.camera.sensor, exposure_s=plan.scan.exposures[at])
    if signal_e is not None and not 0 < signal_e <= noise.full_e:
        wanted = f"above 0, up to the full well of {noise.full_e:.4g}"
        raise InputError.expected("--signal (electrons)", wanted, f"{signal_e:g}", "state the planned exposure's")
    light = subset_patterns(plan, at, order)
    return coding_pays(light, noise, signal_e=PEAK * noise.full_e if signal_e is None else signal_e)


def coding_words(verdict: CodingVerdict) -> str:
    """Return in a line whether showing several frames at once would pay, up to how much light, and why."""
    gain, does = verdict.gain, "pays" if verdict.pays else "does not pay"
    return (
        f"showing {gain.points} frames at once, coded: {does} at {float(f'{gain.signal_e:.3g}'):g} electrons in a "
        f"point's brightest pixel ({gain.time.rms_db:+.2f} dB); it {verdict.range_words}"
    )


def planned_for_display(plan: TargetPlan, display: Display, verdict: CodingVerdict | None) -> TargetPlan:
    """Return the plan that a display shows: several offsets at once where that pays, else one after the other.

    Exposures stay: where sums of several would saturate they are not shown.
    """
    if verdict is None or not verdict.pays or verdict.gain.time.exposure < 1:
        return plan
    from lfcal.multiplex import s_matrix
    from lfcal.targets import coded_plan

    return coded_plan(plan, s_matrix(verdict.gain.points), display.pixel_um)


def display_words(plan: TargetPlan, display: Display) -> str:
    """Return what a display shows by a plan, and whether its pixels are small enough."""
    from lfcal.multiplex import display_fit

    depth = plan.scan.depths_um[len(plan.scan.depths_um) // 2]
    fit = display_fit(plan.scan.camera.step_um(depth), display.pixel_um)
    if plan.lit is None:
        return f"display: {fit.words}; frames show one subset of points after the other"
    most = max(len(one) for plane in plan.lit for one in plane)
    return f"display: {fit.words}; frames show {most} subsets of points at once, by an S-matrix"
