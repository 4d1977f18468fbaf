"""H of a fitted camera in units of a plane each: many at a time, and whole after a kill.

The fit itself is no matter of units: each of its steps takes seconds and needs the one before it, and so do the columns
of its derivatives, which are made anew at each. After a kill it is made again, to the same values, and H goes on.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from lfcal.base import Work, plain
from lfcal.camera import Camera, ScanPlan
from lfcal.fit.model import Fineness, iter_model_plane
from lfcal.fit.result import Fit
from lfcal.fit.setup import Setup
from lfcal.psf import PSFWriter, iter_join
from lfcal.simulate import effects_told, told_effects
from lfcal.work import RunChoice, Unit, iter_made

__all__ = ["do_plane", "iter_model_units"]


def iter_model_units(
    fit: Fit, writer: PSFWriter, compression: str, *, run: RunChoice, keep: bool = False
) -> Work[None]:
    """Write H of the fitted camera by its ``writer``, not yet entered, plane by plane.

    Parameters
    ----------
    fit
        What was found.
    writer, compression
        Writes H, with that compression.
    run
        By whom, and what becomes of an earlier run.
    keep
        As in `lfcal.work.iter_made`.

    Raises
    ------
    InputError
        If an effect of the fit is not found again by its name, and as `lfcal.work.iter_made`.
    """
    setup = fit.ideal_places
    shared = {
        "camera": setup.camera.to_dict(),
        "effects": told_effects(setup.effects),
        "depth_errors_um": setup.depth_errors_um,
        "aside_px": setup.aside_px,
        "plan": fit.planned.to_dict(),
        "compression": compression,
    }
    units = [
        Unit(
            f"plane {z:04d}",
            f"{__name__}:{do_plane.__name__}",
            plain(shared | {"z": z, "gain": float(fit.levels.gains[z])}),
        )
        for z in range(fit.planned.shape[0])
    ]
    title = f"H of the fitted camera, {writer.path.name}"
    yield from iter_made(units, writer.path, run, partial(iter_join, writer=writer), title=title, keep=keep)


def do_plane(arguments: Mapping[str, Any], out: Path, workers: int) -> Work[None]:
    """Compute one plane and write it to an H file of its own: the task of a unit."""
    rows, columns = arguments["aside_px"]
    setup = Setup(
        Camera.from_dict(arguments["camera"]),
        effects_told(arguments["effects"]),
        tuple(arguments["depth_errors_um"]),
        aside_px=(rows, columns),
    )
    planned, z = ScanPlan.from_dict(arguments["plan"]), int(arguments["z"])
    plane = yield from iter_model_plane(setup, planned, z, arguments["gain"], workers, Fineness.finest)
    with PSFWriter(
        out,
        (1, *plane.shape),
        depths=[planned.depths_um[z]],
        compression=arguments["compression"],
        workers=workers,
    ) as writer:
        writer.write_plane(0, plane)
