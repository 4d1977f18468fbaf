"""What the options of ``lfcal acquire`` say: plan, numbers, NAME=VALUE, options of a session; and holds in words."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from lfcal.acquire import Control, Options
    from lfcal.base import Work
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.devices import Rig
    from lfcal.targets import TargetPlan

__all__ = ["numbers", "options_of", "pairs", "read_plan", "reported_holds", "tell_automatic"]

R = TypeVar("R")


def read_plan(path: Path, origin: str) -> ScanPlan | TargetPlan | RegionPlan:
    """Return the plan of a scan, a target or regions in a file, its stage at ``origin`` if that is given."""
    from lfcal.base import InputError, parse_json, read_text
    from lfcal.camera import RegionPlan, ScanPlan
    from lfcal.cli._acquire_target import target_plan_in

    text = read_text(path)
    data = parse_json(text, "scan plan")
    found: ScanPlan | TargetPlan | RegionPlan | None = target_plan_in(data)
    if found is None:
        found = RegionPlan.from_dict(data) if RegionPlan.is_one(data) else ScanPlan.from_dict(data)
    if not origin:
        return found
    place = numbers(origin, "--origin") or ()
    if len(place) != 3:
        raise InputError.expected("--origin", "X,Y,Z in µm", origin, "give three numbers")
    scan = found.scan
    scan = replace(scan, stage=replace(scan.stage, origin_um=(place[0], place[1], place[2])))
    return scan if isinstance(found, ScanPlan) else replace(found, scan=scan)


def options_of(session: Path | None, given: dict[str, Any], check_origin: bool) -> Options:
    """Return the session's options where it exists, else the defaults, changed by what was given."""
    from lfcal.acquire import Options, SessionFile
    from lfcal.campaign import first_begun, is_regions

    if session is not None and is_regions(session):
        session = first_begun(session)
    base = SessionFile.read(session).options if session is not None else Options()
    options = replace(base, **{k: v for k, v in given.items() if v is not None})
    return options if check_origin else replace(options, origin_tolerance_px=None)


def tell_automatic(plan: ScanPlan | TargetPlan | RegionPlan, rig: Rig, options: Options, *, goes_on: bool) -> None:
    """Refuse a camera that changes samples automatically before anything moves, or report what is allowed to stay so.

    A session that continues is compared with its own camera settings first, which gives the clearer message.
    """
    from lfcal.acquire import check_devices, check_fixed
    from lfcal.cli._console import report

    devices = check_devices(plan.scan, rig)
    if not goes_on:
        check_fixed(devices, options)
    if devices.automatic and options.allow_automatic:
        report(f"note: {devices.automatic_words}: frames may not be proportional to light, and H with them")


def reported_holds(work: Work[R], control: Control) -> Work[R]:
    """Pass on a recording; what was not checked, and each hold of it and its end, is a line on standard error."""
    from lfcal.acquire.setup import STAGE
    from lfcal.cli._console import report

    held = ""
    try:
        while True:
            record = next(work)
            # of a wait that counts down the words before the figures stay
            if control.held.partition(":")[0] != held.partition(":")[0]:
                report(f"on hold: {control.held}" if control.held else "recording again")
                held = control.held
            if record.stage == STAGE and record.note:
                report(f"note: {record.note}")
            yield record
    except StopIteration as stop:
        found: R = stop.value
        return found
    finally:
        work.close()


def numbers(text: str | None, what: str) -> tuple[float, ...] | None:
    """Return numbers separated by commas; None where nothing is given."""
    from lfcal.base import InputError

    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError.expected(what, "numbers separated by commas", text, "correct it") from None


def pairs(options: list[str]) -> dict[str, str]:
    """Return the options of a backend, written as NAME=VALUE."""
    from lfcal.base import InputError

    found = {}
    for text in options:
        key, sign, value = text.partition("=")
        if not sign or not key:
            raise InputError.expected("--option", "NAME=VALUE", text, "correct it")
        found[key.strip()] = value.strip()
    return found
