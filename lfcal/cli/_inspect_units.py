"""Inspection of H in units of a plane each: many at a time, and kept after a kill until the report is written.

The comparison with the camera that follows is not split into units: each of its steps needs what the one before it
found.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lfcal.base import Clock, Work
from lfcal.cli._inspect_controls import control_frames
from lfcal.judge.quality import PASSES, QualityReport, iter_inspect_plane, judged, straight
from lfcal.psf import PSFMatrix, mat_order_of, open_psf
from lfcal.tasks import files_of
from lfcal.work import RunChoice, Unit, iter_begun, load_record, save_record

__all__ = ["do_plane", "iter_inspect_units"]


def iter_inspect_units(H: PSFMatrix, report: Path, session: Path | None, *, run: RunChoice) -> Work[QualityReport]:
    """Measure every metric of ``H`` as `lfcal.judge.quality.iter_inspect` does, plane by plane.

    Parameters
    ----------
    H
        As `lfcal.psf.open_psf` gave it, straight; workers open its file by its path.
    report
        Folder that the report will be in; what the planes told stays beside it until it is discarded.
    session
        The session whose control frames belong to it; or None.
    run
        By whom, and what becomes of an earlier run.

    Raises
    ------
    InputError, FileFormatError, StorageError
        As `lfcal.work.iter_made`.
    """
    start = time.perf_counter()
    source = os.path.abspath(H.path)
    beside = None if session is None else os.path.abspath(session)
    inputs = (source, *sorted(os.path.abspath(path) for path in files_of(beside)))
    units = [
        Unit(
            f"plane {z:04d}",
            f"{__name__}:{do_plane.__name__}",
            {"source": source, "region": H.region, "mat_order": mat_order_of(H), "session": beside, "z": z},
            inputs,
            ".record",
        )
        for z in range(len(H))
    ]
    parts = yield from iter_begun(units, report, run, title=f"inspect {Path(source).name}")
    return judged(H, [load_record(part, {"H": H}) for part in parts], time.perf_counter() - start)


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Inspect one plane and write what it told: the task of a unit."""
    z = int(arguments["z"])
    with open_psf(arguments["source"], region=arguments["region"], mat_order=arguments.get("mat_order", "")) as opened:
        H = straight(opened)
        session = arguments["session"]
        controls = None if session is None else control_frames(Path(session), H)
        clock = Clock(f"inspect plane {z + 1} of {len(H)}", PASSES)
        yield clock.at(0)
        found = yield from iter_inspect_plane(H, z, clock, controls=controls, workers=workers)
        save_record(out, found, {"H": H})
