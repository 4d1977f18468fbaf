"""Inspect H plane by plane: several planes at a time, whose results are kept after a stop until the report is written.

The comparison with the camera that follows is not split into units: each of its steps needs the result of the one
before it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import Kind, read_checks
from lfcal.base import Clock, InputError, Work, format_pixels
from lfcal.frames import files_of
from lfcal.judge.quality._inspect import Controls, iter_inspect_plane, judged, straight
from lfcal.judge.quality.measure import PASSES
from lfcal.judge.quality.report import QualityReport
from lfcal.psf import PSFMatrix, mat_order_of, open_psf
from lfcal.work import RunChoice, Unit, iter_begun, load_record, save_record

__all__ = ["control_frames", "do_plane", "iter_inspect_units"]


def control_frames(session: Path, H: PSFMatrix) -> Controls:
    """Return the control frames of a session, cropped like H, and their positions, by depth plane."""
    found: dict[int, tuple[list[NDArray[Any]], list[NDArray[Any]]]] = {}
    for check in read_checks(session):
        if check.kind != Kind.CONTROL or check.position.z >= len(H):
            continue
        # control frames may have a margin around the cutout: use the same pixels as in H
        top, left = ((n - m) // 2 for n, m in zip(check.frame.shape, H.cutout, strict=True))
        # smaller frames cannot have been recorded with this H, and padding them would add wrong values
        if min(top, left) < 0:
            raise InputError.expected(
                "control frames",
                f"at least {format_pixels(H.cutout)}, as in H",
                format_pixels(check.frame.shape),
                "give the session in which H was recorded",
            )
        frames, places = found.setdefault(check.position.z, ([], []))
        frames.append(check.frame[top : top + H.cutout[0], left : left + H.cutout[1]])
        # position of the source in periods from H's own cell, because the tiling is tested far from it
        places.append(np.array(H.anchor) + check.position[1:] + np.array(check.periods) * H.period)
    if not found:
        raise InputError.expected(
            f"{session}",
            "control frames",
            "none",
            "record control positions (lfcal acquire --controls), or leave the session out",
        )
    return {z: (np.stack(frames), np.stack(places)) for z, (frames, places) in found.items()}


def iter_inspect_units(H: PSFMatrix, report: Path, session: Path | None, run: RunChoice) -> Work[QualityReport]:
    """Measure every metric of ``H`` like `lfcal.judge.quality.iter_inspect`, plane by plane in units.

    Parameters
    ----------
    H
        H from `lfcal.psf.open_psf`, not transposed; workers open its file by its path.
    report
        Folder of the report, next to which the results of the planes are stored until they are discarded.
    session
        The session with its control frames, or None.
    run
        Settings for inspecting the planes as separate work units: the executor, and what to do with units left by an
        earlier run.

    Raises
    ------
    InputError, FileFormatError, StorageError
        As in `lfcal.work.iter_made`.
    """
    start = time.perf_counter()
    source = os.path.abspath(H.path)
    beside = None if session is None else os.path.abspath(session)
    inputs = (source, *sorted(os.path.abspath(path) for path in files_of(beside)))
    # not the whole task: planes do not depend on the limits of the comparison, which a resumed run may change
    shared = {"source": source, "region": H.region, "mat_order": mat_order_of(H), "session": beside}
    task = f"{__name__}:{do_plane.__name__}"
    units = [Unit(f"plane {z:04d}", task, shared | {"z": z}, inputs, ".record") for z in range(len(H))]
    parts = yield from iter_begun(units, report, run, title=f"inspect {Path(source).name}")
    return judged(H, [load_record(part, {"H": H}) for part in parts], time.perf_counter() - start)


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Inspect one plane and write the result; this is the task of a unit."""
    z = int(arguments["z"])
    with open_psf(arguments["source"], region=arguments["region"], mat_order=arguments["mat_order"]) as opened:
        H = straight(opened)
        session = arguments["session"]
        controls = None if session is None else control_frames(Path(session), H)
        clock = Clock(f"inspect plane {z + 1} of {len(H)}", PASSES)
        yield clock.at(0)
        found = yield from iter_inspect_plane(H, z, clock, controls=controls, workers=workers)
        save_record(out, found, {"H": H})
