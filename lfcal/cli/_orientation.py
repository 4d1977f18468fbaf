"""``--orientation``: frames held against the plan's path, and turned upright, before anything is made of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan
    from lfcal.frames import FrameSource

__all__ = ["check_choice", "upright"]


def check_choice(choice: str) -> None:
    """Raise `InputError` unless ``choice`` is check, auto or the name of an orientation."""
    from lfcal.base import InputError
    from lfcal.frames import ORIENTATIONS
    from lfcal.psf import AUTO, CHECK

    names = [CHECK, AUTO, *(one.option for one in ORIENTATIONS.values())]
    if choice not in (*names, *ORIENTATIONS):
        raise InputError.expected("--orientation", ", ".join(names), repr(choice), "choose one of these")


def upright(
    view: FrameSource, plan: ScanPlan, choice: str, *, quiet: bool = False
) -> tuple[FrameSource, dict[str, Any]]:
    """Return the corrected frames as ``choice`` turns them, and what H's provenance keeps of it; with a progress bar.

    Raises as `lfcal.psf.upright.iter_upright`.
    """
    from lfcal.cli._console import run_work
    from lfcal.frames import oriented
    from lfcal.psf import iter_upright

    turn, record = run_work(iter_upright(view, plan, choice), quiet=quiet)
    return oriented(view, turn, plan.camera.sensor.shape), record
