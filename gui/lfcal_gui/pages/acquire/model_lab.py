"""The next step of a sitting at the devices, for a button that is found in the dark. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from lfcal.camera import ScanPlan

__all__ = ["KEYS", "Standing", "next_step"]

KEYS = (("next", "F9"), ("start", "F6"), ("pause", "F7"), ("stop", "F8"), ("abort", "Shift+F8"))
"""Buttons and their keys, in the order in which they stand."""


@dataclass(frozen=True)
class Standing:
    """How a sitting stands.

    Attributes
    ----------
    connected, busy
        Whether there are devices, and whether something uses or opens them.
    found
        What was measured by moving: ``"stage"`` a fit with its ``axes``, ``"exposure"`` a time for each plane (s).
    begun, complete
        Whether the folder has a recording, and whether that is whole.
    redo
        Positions to be recorded again.
    dark, white
        Whether those frames are there.
    """

    connected: bool = False
    busy: bool = False
    found: Mapping[str, Any] = field(default_factory=dict)
    begun: bool = False
    complete: bool = False
    redo: int = 0
    dark: bool = False
    white: bool = False


def next_step(now: Standing, plan: ScanPlan) -> tuple[str, str]:
    """Return key and words of what comes next; the key is empty where nothing can be begun now."""
    if now.busy:
        return "", "at work"
    if not now.connected:
        return "connect", "Connect"
    if now.complete:
        return _afterwards(now)
    if now.begun:  # what was measured before it began is not asked for again
        return "start", "Go on recording"
    stage, exposure = now.found.get("stage"), now.found.get("exposure")
    if stage is None:
        return "stage", "Measure the stage"
    if stage.axes != plan.stage:
        return "use stage", "Use measured axes"
    if exposure is None:
        return "exposure", "Find exposures"
    if tuple(exposure) != tuple(plan.exposures):
        return "use exposure", "Use exposures"
    return "start", "Record"


def _afterwards(now: Standing) -> tuple[str, str]:
    if now.redo:
        return "redo", f"Record {now.redo} again"
    if not now.dark:
        return "dark", "Dark frames"
    if not now.white:
        return "white", "White image"
    return "assemble", "Assemble H …"
