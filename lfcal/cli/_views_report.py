"""What ``lfcal views`` says of the views it cut, as a table and as JSON."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.cli._views_input import ViewedFrame

if TYPE_CHECKING:
    from lfcal.lattice import Views

__all__ = ["as_json", "rows"]


def rows(scene: ViewedFrame, found: dict[str, list[Views]]) -> list[list[str]]:
    """Return the rows of the table of a frame's views, ``found`` by lens type and colour."""
    views = next(iter(found.values()))[0]
    lattice, count = scene.cutting.lattice, len(views.offsets)
    turned = f"turned by {math.degrees(lattice.rotation_rad):+.3f}°"
    table = [
        ["lattice", f"{lattice.kind}, {lattice.pitch_px:.3f} px, {turned}, {scene.cutting.source}"],
        ["views", f"{count} x {count}, a pixel of the micro-images apart"],
        *([f"samples of a view{_spoken(label)}", of[0].grid.described()] for label, of in found.items()),
        ["distance of samples", f"{views.step_px[0]:.3f} px down, {views.step_px[1]:.3f} px right"],
        ["rows run along", "the frame" if views.rotation_rad == 0 else f"the lattice ({turned})"],
    ]
    masked = int((~views.mask).sum())
    if masked:
        table.append(["seen by no lenslet", f"{masked} of {views.mask.size} samples (NaN in views.tif)"])
    if "" not in scene.planes:
        table.append(["colours", ", ".join(scene.planes)])
    return table


def _spoken(label: str) -> str:
    return label.replace("_type", ", type ")


def as_json(scene: ViewedFrame, found: dict[str, list[Views]], written: list[Path]) -> dict[str, Any]:
    """Return the same as plain values."""
    lattice, views = scene.cutting.lattice, next(iter(found.values()))[0]
    return {
        "lattice": {
            "kind": lattice.kind,
            "pitch_px": lattice.pitch_px,
            "row_pitch_px": lattice.row_pitch_px,
            "rotation_rad": lattice.rotation_rad,
            "source": scene.cutting.source,
        },
        "views": len(views.offsets),
        "fields": {label.lstrip("_") or "all": _field_as_json(of[0]) for label, of in found.items()},
        "step_px": views.step_px,
        "rotation_rad": views.rotation_rad,
        "radius_px": views.radius_px,
        "colours": [name for name in scene.planes if name],
        "written": written,
    }


def _field_as_json(views: Views) -> dict[str, Any]:
    """Return where the samples of a set of views lie, and what of the field they are."""
    grid = views.grid
    masked = int((~views.mask).sum())
    return {
        "shape": views.shape,
        "whole": grid.field_shape,
        "kept": grid.kept,
        "masked": masked,
        "corner_px": grid.corner_px,
    }
