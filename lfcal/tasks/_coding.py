"""Whether frames of a target are better shown several at once, and the plan that shows them so."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError, storage_errors

if TYPE_CHECKING:
    from lfcal.multiplex import CodingVerdict
    from lfcal.targets import Display, TargetPlan

__all__ = [
    "PEAK",
    "coding_facts",
    "coding_verdict",
    "coding_words",
    "display_words",
    "patterns_in",
    "planned_for_display",
    "write_patterns",
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


def coding_facts(verdict: CodingVerdict | None) -> dict[str, Any] | None:
    """Return the verdict as plain numbers, for scripts."""
    if verdict is None:
        return None
    import math

    gain = verdict.gain
    return {
        "pays": verdict.pays,
        "together": gain.points,
        "signal_e": gain.signal_e,
        "gain_db": gain.time.rms_db,
        "dark_db": gain.time.dark_db,
        "up_to_e": None if math.isinf(verdict.break_even_e) else verdict.break_even_e,
    }


def coding_words(verdict: CodingVerdict) -> str:
    """Return in a line whether showing several frames at once would pay, up to how much light, and why."""
    import math

    gain = verdict.gain
    told = f"showing {gain.points} frames at once, coded: {'pays' if verdict.pays else 'does not pay'} at"
    told = f"{told} {_count(gain.signal_e)} electrons in a point's brightest pixel ({gain.time.rms_db:+.2f} dB), "
    if math.isinf(verdict.break_even_e):
        return (
            told + "nor at any other: the sensor's own noise is more than the photons'"
            if not verdict.pays
            else (told + "as up to a full pixel: the sensor's own noise rules")
        )
    if verdict.break_even_e == 0:
        return told + "and at no light: photon noise of bright cores would be spread over dark entries"
    limit = f"{_count(verdict.break_even_e)} electrons"
    if verdict.pays:
        return told + f"and up to {limit}: the sensor's own noise rules, and is shared by the frames"
    return told + f"but up to {limit}: beyond, photon noise of bright cores is spread over dark entries"


def _count(electrons: float) -> str:
    return f"{float(f'{electrons:.3g}'):g}"


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


def patterns_in(folder: Path) -> list[Path]:
    """Return the pictures of an earlier plan in a folder."""
    return sorted(folder.glob("frame_[0-9][0-9][0-9][0-9].png"))


def write_patterns(plan: TargetPlan, display: Display, folder: Path) -> list[Path]:
    """Write what the display shows in each frame, in the order of the plan, as PNG; return the files.

    Pictures of an earlier plan go: a program that shows all files would show those as well.
    """
    from lfcal.base import write_png
    from lfcal.targets import display_image

    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        for earlier in patterns_in(folder):
            earlier.unlink()
    files = []
    for number, (z, k) in enumerate(plan.frames):
        path = folder / f"frame_{number:04d}.png"
        write_png(path, display_image(plan, display, z, k))
        files.append(path)
    return files
