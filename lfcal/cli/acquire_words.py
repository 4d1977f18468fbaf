"""What the options of ``lfcal acquire`` say: plan, numbers, NAME=VALUE, and the options of a session."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.acquire.options import Options
    from lfcal.camera import ScanPlan

__all__ = ["numbers", "options_of", "pairs", "read_plan"]


def read_plan(path: Path, origin: str) -> ScanPlan:
    """Return the plan in a file, its stage placed at ``origin`` where one is given."""
    from lfcal.camera import ScanPlan
    from lfcal.errors import InputError
    from lfcal.files import read_text

    plan = ScanPlan.from_json(read_text(path))
    if not origin:
        return plan
    place = numbers(origin, "--origin") or ()
    if len(place) != 3:
        raise InputError.expected("--origin", "X,Y,Z in µm", origin, "give three numbers")
    return replace(plan, stage=replace(plan.stage, origin_um=(place[0], place[1], place[2])))


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
