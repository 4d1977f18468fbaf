"""What the options of ``lfcal acquire`` say: plan, numbers, NAME=VALUE, and the options of a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.acquire.options import Options
    from lfcal.camera import ScanPlan
    from lfcal.targets import TargetPlan

__all__ = ["numbers", "options_of", "pairs", "read_plan"]


def read_plan(path: Path, origin: str) -> ScanPlan | TargetPlan:
    """Return the plan of a scan or of a target in a file, its stage placed at ``origin`` where one is given."""
    from lfcal.camera import ScanPlan
    from lfcal.cli.acquire_target import target_plan_in
    from lfcal.errors import InputError
    from lfcal.files import read_text
    from lfcal.plain import parse_json

    text = read_text(path)
    target = target_plan_in(parse_json(text, "scan plan"))
    plan = ScanPlan.from_json(text) if target is None else target.scan
    if not origin:
        return target or plan
    place = numbers(origin, "--origin") or ()
    if len(place) != 3:
        raise InputError.expected("--origin", "X,Y,Z in µm", origin, "give three numbers")
    plan = replace(plan, stage=replace(plan.stage, origin_um=(place[0], place[1], place[2])))
    return plan if target is None else replace(target, scan=plan)


def options_of(session: Path | None, given: dict[str, Any], check_origin: bool) -> Options:
    """Return the session's options where it exists, else the defaults, changed by what was given."""
    from lfcal.acquire.options import Options
    from lfcal.acquire.session_file import SessionFile

    base = SessionFile.read(session).options if session is not None else Options()
    options = replace(base, **{k: v for k, v in given.items() if v is not None})
    return options if check_origin else replace(options, origin_tolerance_px=None)


def numbers(text: str | None, what: str) -> tuple[float, ...] | None:
    """Return numbers separated by commas; None where nothing is given."""
    from lfcal.errors import InputError

    if text is None:
        return None
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError.expected(what, "numbers separated by commas", text, "correct it") from None


def pairs(options: list[str]) -> dict[str, str]:
    """Return the options of a backend, written as NAME=VALUE."""
    from lfcal.errors import InputError

    found = {}
    for text in options:
        key, sign, value = text.partition("=")
        if not sign or not key:
            raise InputError.expected("--option", "NAME=VALUE", text, "correct it")
        found[key.strip()] = value.strip()
    return found
