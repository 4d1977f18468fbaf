"""Files of a recalibration: camera and effects for other commands, H, and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from lfcal.base import Work, plain
from lfcal.fit import CAMERA, EFFECTS, MODEL, ModelPlanes, measured_camera, write_found
from lfcal.psf import Header, Stored, iter_write
from lfcal.recalibrate.recalibrate import Recalibration

__all__ = ["NUMBERS", "iter_write_recalibration", "recalibration_dict", "recalibration_outputs"]

NUMBERS = "recalibration.json"

FORMAT, VERSION = "lfcal-recalibration", 1


def recalibration_dict(found: Recalibration) -> dict[str, Any]:
    """Return the results of a recalibration, without camera and effects, as plain JSON types.

    Each parameter states its unit; depths are in µm.
    """
    values: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "version": VERSION,
            "camera": found.planned.camera.name,
            "accepted": found.accepted,
            "verdict": found.verdict,
            "goodness": {name: one._asdict() for name, one in found.goodness.items()},
            "parameters": list(found.parameters.values()),
            "remedies": list(found.remedies),
            "undetermined": [list(names) for names in found.undetermined],
            "depth_scale": dict(found.depth_scale),
            "contents": found.contents,
            "depths_um": found.planned.depths_um,
        }
    )
    return values


def recalibration_outputs(folder: Path, *, with_h: bool = True) -> tuple[Path, ...]:
    """Return the paths of the files that `iter_write_recalibration` writes to ``folder``; ``with_h`` includes H."""
    names = (CAMERA, EFFECTS, NUMBERS)
    return tuple(folder / name for name in ((MODEL, *names) if with_h else names))


def iter_write_recalibration(
    found: Recalibration, folder: Path, known: Mapping[str, Any], *, with_h: bool = True, workers: int | None = None
) -> Work[tuple[Path, ...]]:
    """Write the files of a recalibration to ``folder``, and return their paths; write none if it was not accepted.

    Parameters
    ----------
    found
        The recalibration.
    folder
        Output folder, created if needed.
    known
        Entries to add to the file of results and to the provenance of H, as plain JSON types.
    with_h
        Whether to compute and write H of the recalibrated camera.
    workers
        Number of threads. None: all processors.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    if not found.accepted:
        return ()
    folder.mkdir(parents=True, exist_ok=True)
    files: list[Path] = []
    if with_h:
        plan = found.planned
        origin = {
            "verdict": found.verdict,
            "frames": {name: one.ratio for name, one in found.goodness.items()},
            "contents": plain(found.contents),
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        effects = [{"name": one.name, **plain(one)} for one in found.effects]
        provenance = {"recalibration": origin, "effects": effects, "plan": found.setup.plan(plan).to_dict(), **known}
        header = Header(plan.shape, plan.depths_um, measured_camera(found), plan.anchor, provenance)
        planes = ModelPlanes(header, found.setup, plan, (1.0,) * len(plan.depths_um))
        files.append((yield from iter_write(planes, folder / MODEL, Stored(), workers=workers)))
    return (*files, *write_found(found, folder, NUMBERS, recalibration_dict(found) | dict(known)))
