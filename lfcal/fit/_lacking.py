"""Groups of unknowns that a camera has nothing of: what they would need."""

from __future__ import annotations

from collections.abc import Sequence

from lfcal.base import InputError
from lfcal.camera import ScanPlan
from lfcal.fit.parameters import GROUPS, ScanScales
from lfcal.fit.setup import Setup

__all__ = ["check_groups", "lacking"]


def lacking(setup: Setup, plan: ScanPlan, frame: ScanScales | None = None) -> dict[str, str]:
    """Return the groups without an unknown, by name, and what camera or scan would need for them, for people.

    ``frame`` is that of several regions; None is that of the plan's own.
    """
    frame = frame or ScanScales.of(plan)
    return {group.name: group.needs for group in GROUPS if not group.unknowns(setup, frame)}


def check_groups(setup: Setup, plan: ScanPlan, names: Sequence[str], frame: ScanScales | None = None) -> None:
    """Raise `InputError` where a group that was asked for by name has no unknowns: it would be left out silently."""
    if not names:
        return
    without = lacking(setup, plan, frame)
    wrong = [name for name in names if name in without]
    if wrong:
        there = ", ".join(name for name in GROUPS.names() if name not in without)
        raise InputError.expected(
            "unknowns",
            f"groups that {plan.camera.name} has",
            f"{wrong[0]}, which needs {without[wrong[0]]}",
            f"choose of {there}",
        )
