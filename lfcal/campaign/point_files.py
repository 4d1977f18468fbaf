"""What a fit of a target's points leaves: the camera, its effects, H of a region of the field, the numbers."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from lfcal.camera import ScanPlan
from lfcal.fit.field import FieldFit
from lfcal.fit.files import effects_text, fit_dict, iter_write_model, json_text, measured_camera, write_text
from lfcal.fit.writing import CAMERA, EFFECTS, MODEL, NUMBERS
from lfcal.progress import Work

__all__ = ["iter_write_points", "point_outputs"]


def point_outputs(folder: Path) -> list[Path]:
    """Return all files that a fit of points in ``folder`` consists of."""
    return [folder / name for name in (MODEL, CAMERA, EFFECTS, NUMBERS)]


def iter_write_points(
    fit: FieldFit,
    scan: ScanPlan,
    folder: Path,
    known: Mapping[str, Any],
    *,
    with_h: bool = True,
    workers: int | None = None,
) -> Work[list[Path]]:
    """Write a fit of points, ``fit.json`` last; H is the model's in the region of ``scan``, in the light of the points.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    if with_h:
        work = iter_write_model(fit.fit_at(scan), folder / MODEL, provenance=known, workers=workers)
        written.append((yield from work))
    parts = {
        name: {"chi2": one.here.chi_square.lit, "error": one.here.error.value, "points": len(one.residuals)}
        for name, one in fit.fits.items()
        if one.here is not None
    }
    numbers = fit_dict(fit.first) | {**known, "parts": parts, "fitted": datetime.now(UTC).isoformat(timespec="seconds")}
    texts = {
        CAMERA: measured_camera(fit.first).to_json(),
        EFFECTS: effects_text(fit.first),
        NUMBERS: json_text(numbers),
    }
    for name, text in texts.items():
        write_text(folder / name, text)
        written.append(folder / name)
    return written
