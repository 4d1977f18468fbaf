"""The one way to H: the files that a frame passes, what is carried along, and no other way beside it."""

from __future__ import annotations

import inspect
import sys
import tempfile
import threading
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from lfcal.base import drain
from lfcal.camera import ScanPlan, preset
from lfcal.frames import ArraySource
from lfcal.psf import AssemblySettings, iter_assemble_plan, make
from lfcal.psf.assembly import AssembledPlanes
from lfcal.psf.store import MatrixGroup
from tests.architecture.sources import MODULES, ROOT, text_of

__all__ = ["files_entered", "units_of_planes", "values_carried"]


def files_entered() -> list[str]:
    """Return the files of lfcal in which a function is called from asking for a frame's plane until H takes the plane.

    All files count, helpers such as those of progress and threads too. The frame is an array, so that none counts that
    reads a format of files.
    """
    camera = preset("bench")
    plan = ScanPlan(camera, (1, 1), cutout=(9, 9), depths_um=(camera.depth_of(2.0),), anchor=(12, 12))
    frames = ArraySource(np.full((1, 25, 25), 7, np.uint16), [(0, 0, 0)])
    found: dict[str, None] = {}
    start, end = AssembledPlanes.iter_plane.__code__, MatrixGroup.write_plane.__code__
    on = False

    def look(frame: FrameType, event: str, _: Any) -> None:
        nonlocal on
        path = Path(frame.f_code.co_filename)
        if event != "call" or not path.is_relative_to(ROOT / "lfcal"):
            return
        on = on or frame.f_code is start
        if on:
            found[path.relative_to(ROOT).as_posix()] = None
        # what stores the values of a plane is not entered for a frame
        on = on and frame.f_code is not end

    with tempfile.TemporaryDirectory() as folder:
        threading.setprofile(look)
        sys.setprofile(look)
        try:
            drain(iter_assemble_plan(frames, plan, Path(folder) / "H.h5", AssemblySettings(), workers=1))
        finally:
            sys.setprofile(None)
            threading.setprofile(None)
    return list(found)


def values_carried() -> list[str]:
    """Return what is handed on from `iter_assemble_plan` to what writes H."""
    return list(inspect.signature(make.iter_make).parameters)


def units_of_planes() -> list[str]:
    """Return the modules of units that write planes of H themselves: `lfcal.psf.make` does that for all sources."""
    units = {module: path for module, path in MODULES.items() if module.endswith("_units")}
    return [module for module, path in units.items() if "PSFWriter" in text_of(path)]


def test_planes_of_h_are_made_in_units_in_one_place() -> None:
    assert units_of_planes() == []


def test_a_frame_passes_few_files_and_little_is_carried_along() -> None:
    entered = files_entered()
    assert entered[0] == "lfcal/psf/assembly.py" and entered[-1] == "lfcal/psf/store.py"
    assert len(entered) <= 10 and len(values_carried()) <= 5
