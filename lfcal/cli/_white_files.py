"""What ``lfcal white`` writes: the lattice as JSON, its residuals as numbers and as a picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import replace_whole
from lfcal.tasks import LATTICE_FORMAT, LATTICE_VERSION

if TYPE_CHECKING:
    from lfcal.lattice import LatticeFit

__all__ = ["LATTICE", "RESIDUALS", "RESIDUAL_MAP", "lattice_dict", "save_lattice"]

LATTICE, RESIDUALS, RESIDUAL_MAP = "lattice.json", "residuals.csv", "residuals.png"
NAMES = (
    "kind",
    "shape",
    "pitch_px",
    "row_pitch_px",
    "rotation_rad",
    "shear_rad",
    "origin_px",
    "pitch_error_px",
    "residual_rms_px",
    "form",
    "reason",
    "notes",
)


def lattice_dict(fit: LatticeFit) -> dict[str, Any]:
    """Return the lattice's numbers, their errors and the distortion as plain values."""
    bend, errors = fit.distortion, fit.errors
    return {
        **{name: getattr(fit, name) for name in NAMES},
        "distortion": None
        if bend is None
        else {"model": bend.model, "centre_px": bend.centre, "scale_px": bend.scale, "terms_px": bend.terms},
        "errors": None
        if errors is None
        else {
            "pitch_px": errors.pitch_px,
            "row_pitch_px": errors.row_pitch_px,
            "rotation_rad": errors.rotation_rad,
            "shear_rad": errors.shear_rad,
            "origin_px": errors.origin_px,
            "distortion_centre_px": errors.centre,
            "distortion_terms_px": errors.terms,
        },
        "lenslets": len(fit.index),
        "dead": fit.dead_lenslets,
    }


def save_lattice(fit: LatticeFit, out: Path) -> list[Path]:
    """Write lattice, residuals of every lenslet and a map of them into ``out``; return the files."""
    written = [out / name for name in (LATTICE, RESIDUALS, RESIDUAL_MAP)]
    text = json.dumps(
        {"format": LATTICE_FORMAT, "version": LATTICE_VERSION, **lattice_dict(fit)}, indent=2, allow_nan=False
    )
    with replace_whole(written[0]) as part:
        part.write_text(text, encoding="utf-8")
    with replace_whole(written[1]) as part:
        part.write_text(_table(fit), encoding="utf-8")
    _draw(fit, written[2])
    return written


def _table(fit: LatticeFit) -> str:
    """Return a line for each lenslet: indices, its best place, and its own residual (empty for dead ones)."""
    lattice = fit.centres_px(fit.index[:, 0], fit.index[:, 1])
    places = lattice if fit.places_px is None else fit.places_px
    residual = fit.measured_px - lattice
    lines = ["q,r,row_px,column_px,residual_row_px,residual_column_px,light,dead"]
    for k, (q, r) in enumerate(fit.index):
        left = ("", "") if fit.dead[k] else tuple(f"{v:.5f}" for v in residual[k])
        at = ",".join(f"{v:.5f}" for v in places[k])
        lines.append(f"{q},{r},{at},{left[0]},{left[1]},{fit.light[k]:.6g},{int(fit.dead[k])}")
    return "\n".join(lines) + "\n"


def _draw(fit: LatticeFit, path: Path) -> None:
    import numpy as np

    from lfcal.base import figure, save_figure

    left = fit.residual_map()
    limit = max(float(np.nanpercentile(np.abs(left), 99)), 1e-3)
    rows, columns = fit.shape
    with figure(9.0, 3.6) as fig:
        panels = fig.subplots(1, 2)
        for panel, values, name in zip(panels, left, ("down", "to the right"), strict=True):
            shown = panel.imshow(values, cmap="RdBu_r", vmin=-limit, vmax=limit, extent=(0, columns, rows, 0))
            panel.set_title(f"residual {name} (px)")
            panel.set_xlabel("column (px)")
            panel.set_ylabel("row (px)")
            fig.colorbar(shown, ax=panel, shrink=0.8)
        save_figure(fig, path)
