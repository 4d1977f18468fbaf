"""What makes frames upright, held against the plan's path before anything is made of them."""

from __future__ import annotations

from typing import Any

from lfcal.camera import ScanPlan
from lfcal.errors import InputError
from lfcal.frames.orientation import AS_IS, AUTO, CHECK, ORIENTATIONS, Orientation, named_orientation
from lfcal.frames.source import FrameSource
from lfcal.progress import Work
from lfcal.psf.orientation import FoundOrientation, iter_find_orientation

__all__ = ["AUTO", "CHECK", "check_found", "iter_upright"]


def iter_upright(view: FrameSource, plan: ScanPlan, choice: str = CHECK) -> Work[tuple[Orientation, dict[str, Any]]]:
    """Return what is to be done to the frames, for `lfcal.frames.oriented`, and what H's provenance keeps of it.

    Parameters
    ----------
    view
        Corrected frames, as delivered.
    plan
        Where the image should be at each position.
    choice
        Name of what makes them upright; ``"auto"``: find it; ``"check"``: take them as they are, if that is not
        certainly wrong.

    Raises
    ------
    InputError
        With ``"check"``, if the frames certainly do not lie as the plan says; with ``"auto"``, if it cannot be told
        how they lie, or the scan and not the frames is turned.
    """
    if choice not in (CHECK, AUTO):
        turn = named_orientation(choice)
        record: dict[str, Any] = {"applied": turn.name, "found": None}
    else:
        found = yield from iter_find_orientation(view, plan)
        check_found(found, choice)
        turn = ORIENTATIONS[found.name or AS_IS]
        record = {"applied": turn.name, "found": found.name or None, "cause": found.cause, "margin": found.margin}
        if not found.name or found.cause == "either":
            record["note"] = found.words
    return turn, {"orientation": record}


def check_found(found: FoundOrientation, choice: str) -> None:
    """Raise `InputError` where nothing may be assembled by what was found; ``choice`` as in `iter_upright`."""
    if choice not in (CHECK, AUTO):
        return
    keep = "--orientation as-is takes them as they are"
    if not found.name and choice == AUTO:
        raise InputError.expected(
            "frames", "a path of the pattern that tells how they lie", found.reason, "name their --orientation"
        )
    if not found.wrong or (choice == AUTO and found.cause != "scan"):
        return
    scan = "correct the order of the positions, or the plan's stage axes"
    turn = f"turn the frames with --orientation {ORIENTATIONS[found.name].option}"
    remedy = {"scan": scan, "frames": turn, "either": f"{turn}, or {scan}"}[found.cause]
    raise InputError.expected(
        "frames", "an image that moves as the plan says", f"another: {found.words}", f"{remedy}; {keep}"
    )
