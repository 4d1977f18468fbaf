"""``lfcal acquire`` of a plan of regions: what differs from a session of one."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import InputError
from lfcal.cli._acquire_words import reported_holds
from lfcal.cli._console import run_work

if TYPE_CHECKING:
    from lfcal.acquire import Control, LiveQuality, Options, Outcome, SessionForecast
    from lfcal.camera import RegionPlan
    from lfcal.devices import Rig

__all__ = ["check_region_options", "finish_regions", "forecast_regions", "record_regions"]


def check_region_options(given: dict[str, bool]) -> None:
    """Raise for the first of the options ``given`` that is of one region."""
    named = [name for name, there in given.items() if there]
    if named:
        raise InputError(f"{named[0]}: is of one region; leave it out with the plan of several")


def record_regions(
    plan: RegionPlan, out: Path, rig: Rig, options: Options, control: Control, *, resume: bool, quiet: bool
) -> tuple[Outcome, dict[str, Any]]:
    """Record all regions; return how it ended, and the alarms of each region by name."""
    from lfcal.acquire import LiveQuality, window_shape
    from lfcal.campaign import iter_record_regions

    seen: dict[int, LiveQuality] = {}

    def watching(k: int) -> tuple[LiveQuality]:
        seen[k] = LiveQuality(plan.plan(k), window_shape(plan.plan(k), options))
        return (seen[k],)

    work = iter_record_regions(out, plan, rig, options, resume=resume, control=control, observers=watching)
    outcome = run_work(reported_holds(work, control), quiet=quiet)
    alarms = [
        replace(alarm, remedy=f"{alarm.remedy} (region {plan.names[k]})")
        for k, quality in seen.items()
        for alarm in quality.state().alarms
    ]
    return outcome, {"alarms": alarms, "regions": plan.names}


def forecast_regions(
    plan: RegionPlan, rig: Rig, options: Options, out: Path, frames_per_s: float | None = None
) -> SessionForecast:
    """Return what all regions cost together; each is checked."""
    from lfcal.acquire import forecast

    found = [
        forecast(plan.plan(k), rig, options, out / name, frames_per_s=frames_per_s) for k, name in enumerate(plan.names)
    ]
    sums = {
        name: sum(getattr(one, name) for one in found)
        for name in ("positions", "other_frames", "seconds", "recording_bytes")
    }
    if frames_per_s is not None:
        sums["readout_seconds"] = sum(one.readout_seconds or 0.0 for one in found)
    return replace(found[0], **sums)


def finish_regions(out: Path, assemble: Path | None, pack: bool, quiet: bool) -> dict[str, Any]:
    """Assemble H of every region into one file, and pack the recordings, as asked for; return what came of it."""
    from lfcal.acquire import iter_assemble_session, iter_finish
    from lfcal.campaign import read_regions, region_sessions, save_parts, temporary_parts
    from lfcal.psf import AssemblySettings, open_psf

    result: dict[str, Any] = {}
    if assemble is not None:
        settings = AssemblySettings(strict=True)
        with temporary_parts(assemble, read_regions(out).names) as parts:
            for name, folder in region_sessions(out):
                run_work(iter_assemble_session(folder, parts[name], settings=settings), quiet=quiet).matrix.close()
            save_parts(parts, assemble, dtype="rounded")
        with open_psf(assemble) as matrix:
            result |= {"H": assemble, "shape": matrix.shape}
    if pack:
        result["bytes_gained"] = sum(
            run_work(iter_finish(folder), quiet=quiet).bytes_gained for _, folder in region_sessions(out)
        )
    return result
