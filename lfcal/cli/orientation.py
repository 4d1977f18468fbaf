"""``--orientation``: frames held against the plan's path, and turned upright, before anything is made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.frames import CorrectionRecipe, FrameSource
    from lfcal.psf.orientation import FoundOrientation

__all__ = ["check_choice", "check_colours", "upright"]

CHECK, AUTO = "check", "auto"


def check_choice(choice: str) -> None:
    """Raise `InputError` unless ``choice`` is check, auto or the name of an orientation."""
    from lfcal.errors import InputError
    from lfcal.frames import ORIENTATIONS

    names = [CHECK, AUTO, *(one.option for one in ORIENTATIONS.values())]
    if choice not in (*names, *ORIENTATIONS):
        raise InputError.expected("--orientation", ", ".join(names), repr(choice), "choose one of these")


def upright(
    view: FrameSource, plan: ScanPlan, choice: str, *, quiet: bool = False
) -> tuple[FrameSource, dict[str, Any]]:
    """Return the corrected frames as ``choice`` turns them, and what H's provenance keeps of it.

    Raises
    ------
    InputError
        With ``check``, if the frames certainly do not lie as the plan says; with ``auto``, if it cannot be told how
        they lie, or the scan and not the frames is turned.
    """
    from lfcal.cli.console import run_work
    from lfcal.frames import AS_IS, ORIENTATIONS, named_orientation, oriented
    from lfcal.psf.orientation import iter_find_orientation

    if choice not in (CHECK, AUTO):
        turn = named_orientation(choice)
        record: dict[str, Any] = {"applied": turn.name, "found": None}
    else:
        found = run_work(iter_find_orientation(view, plan), quiet=quiet)
        _refuse(found, choice)
        turn = ORIENTATIONS[found.name or AS_IS]
        record = {"applied": turn.name, "found": found.name or None, "cause": found.cause, "margin": found.margin}
        if not found.name or found.cause == "either":
            record["note"] = found.words
    return oriented(view, turn, plan.camera.sensor.shape), {"orientation": record}


def check_colours(frames: FrameSource, plan: ScanPlan, recipe: CorrectionRecipe, applied: str) -> None:
    """Raise `InputError` where frames were turned whose colour pattern is known from the upright sensor only."""
    from lfcal.errors import InputError
    from lfcal.frames import AS_IS

    used = recipe.channel or recipe.defects or recipe.white
    if applied == AS_IS or not used or frames.metadata.get("cfa") or not plan.camera.sensor.cfa:
        return
    raise InputError.expected(
        "colour pattern of frames that are turned",
        "one that the frames state as they are delivered",
        f"that of the plan's upright sensor, {plan.camera.sensor.cfa}",
        "state it in the manifest, or turn the files themselves",
    )


def _refuse(found: FoundOrientation, choice: str) -> None:
    """Raise where nothing may be assembled by what was found."""
    from lfcal.errors import InputError
    from lfcal.frames import ORIENTATIONS

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
