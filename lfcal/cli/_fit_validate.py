"""``lfcal fit --validate``: recorded points that were withheld, predicted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from lfcal.base import Work
    from lfcal.cli._fit_source import PatternReading
    from lfcal.fit import Fit, Measured, ModelError, PointError, Validation

__all__ = [
    "VALIDATION",
    "error_dict",
    "iter_write_validation",
    "show_validation",
    "validation_dict",
    "withheld_points",
]

VALIDATION = ("validation.json", "report/validation.png")
"""What is written beside a fit's own files."""

CAPTION = "Error of each point that was not fitted: over the sensor, and from the middle of the field to its edge."

LISTED = 8
"""Points with the largest errors that are listed; validation.json has all."""


def withheld_points(
    source: Path, other: Path | None, how: PatternReading, fitted: Measured, *, quiet: bool
) -> Measured:
    """Return the patterns of positions that were not fitted, or those of another source."""
    from lfcal.cli._fit_source import read_patterns

    if other is not None:
        return read_patterns(other, replace(how, plan=None), quiet=quiet)[0]
    done = frozenset((int(z), int(y), int(x)) for z, y, x in fitted.index)
    return read_patterns(source, replace(how, without=done), quiet=quiet)[0]


def iter_write_validation(
    fit: Fit, withheld: Measured, out: Path, source: Path, other: Path | None
) -> Work[Validation]:
    """Predict withheld points, and write numbers and picture into a fit's folder."""
    from lfcal.fit import add_picture, draw_validation, iter_validate, json_text, write_text

    found = yield from iter_validate(fit, withheld, another=other is not None)
    numbers, picture = (out / name for name in VALIDATION)
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw_validation(found, picture)
    add_picture(picture.parent, "Points that were not fitted", found.verdict, picture, CAPTION)
    write_text(numbers, json_text(validation_dict(found) | {"source": (other or source).name}))
    return found


def validation_dict(found: Validation) -> dict[str, Any]:
    """Return what was found as plain types; the fitted camera's errors, and those of H taken as periodic."""
    parts = {"all": found.points, "middle": found.middle, "edges": found.edges}
    errors = {
        how: {name: error_dict(found.error(part, periodic=how == "periodic")) for name, part in parts.items()}
        for how in ("camera", "periodic")
    }
    return {
        "format": "lfcal-validation",
        "version": 1,
        "verdict": found.verdict,
        "edges_seen": found.wide,
        "camera_worse_at_edges": found.worse(periodic=False),
        "period_lost": found.worse(periodic=True),
        "errors": errors,
        "points": [_point(one) for one in found.points],
    }


def error_dict(error: ModelError) -> dict[str, Any]:
    """Return an error of the model as plain types."""
    return {"known": error.known, "value": error.value, "sigma": error.sigma, "limit": error.limit}


def _point(one: PointError) -> dict[str, Any]:
    return {
        "position": [one.z, one.y, one.x],
        "pixel": one.place_px,
        "field": one.field,
        "error": error_dict(one.model.error),
        "chi2": one.model.chi_square.lit,
        "displacement_px": one.model.displacement_px,
        "light": one.model.gain,
        "periodic": None if one.periodic is None else error_dict(one.periodic.error),
    }


def show_validation(found: Validation) -> None:
    """Print the points with the largest errors, and what all of them say."""
    from lfcal.cli._console import print_table

    worst = sorted(found.points, key=lambda one: -one.model.error.squared)[:LISTED]
    rows = [
        [
            f"{one.z}, {one.y}, {one.x}",
            f"{one.field:.2f}",
            str(one.model.error),
            "" if one.periodic is None else str(one.periodic.error),
            f"{one.model.chi_square.lit:.2f}",
            f"{one.model.displacement_px[0]:+.3f}, {one.model.displacement_px[1]:+.3f}",
        ]
        for one in worst
    ]
    headers = ["withheld z, y, x", "field", "camera", "H as periodic", "chi²", "beside (px)"]
    print_table(headers, rows)
    good = not (found.worse(periodic=False) or found.worse(periodic=True))
    typer.secho(found.verdict, fg=typer.colors.GREEN if good else typer.colors.RED, bold=True)
