"""Scan plans as tasks read and write them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfcal.base import InputError, replace_whole
from lfcal.tasks.cameras import is_camera_file
from lfcal.tasks.planned import ready_plan

if TYPE_CHECKING:
    from lfcal.camera import ScanPlan

__all__ = ["scan_of", "write_plan"]


def scan_of(path: Path) -> ScanPlan:
    """Return the scan plan in a file, which must hold one.

    Raises
    ------
    InputError
        If it is a camera, or another file.
    """
    named = not is_camera_file(str(path))
    found = None if named else ready_plan(str(path))
    if found is None:
        got = f"the camera {path}" if named else str(path)
        raise InputError.expected("PLAN", "a scan plan (.json)", got, "make one with lfcal plan CAMERA -o plan.json")
    return found


def write_plan(text: str, out: Path | None) -> None:
    """Write a plan where a file is named."""
    if out is not None:
        with replace_whole(out) as part:
            part.write_text(text, encoding="utf-8")
