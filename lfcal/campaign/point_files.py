"""What a fit of a target's points leaves: the camera, its effects, H of regions of the field, the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lfcal.base import Work
from lfcal.camera import RegionPlan, ScanPlan
from lfcal.fit import CAMERA, EFFECTS, MODEL, NUMBERS, FieldFit, fit_dict, iter_write_model, write_found

__all__ = ["iter_write_points", "point_outputs"]


def point_outputs(folder: Path) -> list[Path]:
    """Return all files that a fit of points in ``folder`` consists of."""
    return [folder / name for name in (MODEL, CAMERA, EFFECTS, NUMBERS)]


def iter_write_points(
    fit: FieldFit,
    scan: ScanPlan | RegionPlan,
    folder: Path,
    known: Mapping[str, Any],
    *,
    with_h: bool = True,
    workers: int | None = None,
) -> Work[list[Path]]:
    """Write a fit of points, ``fit.json`` last; H is the model's in the light of the points.

    Parameters
    ----------
    fit
        One camera from the points of the whole field.
    scan
        The region of the field that H is of, or several: H of all of them is one file.
    folder
        Made where it is not there yet.
    known
        What is known of the frames, as plain JSON types.
    with_h
        Whether H is computed and written.
    workers
        Threads; None takes every processor.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    if with_h:
        written.append((yield from _iter_h(fit, scan, folder / MODEL, known, workers)))
    parts = {
        name: {"chi2": one.here.chi_square.lit, "error": one.here.error.value, "points": len(one.residuals)}
        for name, one in fit.fits.items()
        if one.here is not None
    }
    return written + write_found(fit.first, folder, NUMBERS, fit_dict(fit.first) | {**known, "parts": parts})


def _iter_h(
    fit: FieldFit, scan: ScanPlan | RegionPlan, out: Path, known: Mapping[str, Any], workers: int | None
) -> Work[Path]:
    """Write H of a region, or of several."""
    if isinstance(scan, ScanPlan):
        return (yield from iter_write_model(fit.fit_at(scan), out, provenance=known, workers=workers))
    from lfcal.campaign.regions import parts_beside, save_parts  # here: a fit of one region loads no devices

    with parts_beside(out, scan.names) as parts:
        for k, name in enumerate(scan.names):
            here = fit.fit_at(scan.plan(k))
            yield from iter_write_model(here, parts[name], provenance=known, workers=workers)
        return save_parts(parts, out)
