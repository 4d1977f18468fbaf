"""``lfcal fit --validate``: recorded points that were withheld, predicted."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import typer

from lfcal.cli.fit_check import new_frame, single_frames
from lfcal.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lfcal.cli.fit_source import Reading
    from lfcal.fit import Fit, Measured
    from lfcal.fit.compared import Compared
    from lfcal.fit.judge import ModelError
    from lfcal.fit.locate import NewFrame
    from lfcal.fit.validate import PointError, Validation
    from lfcal.progress import Work

__all__ = [
    "VALIDATION",
    "iter_write_validation",
    "object_dict",
    "object_error",
    "read_object",
    "show_validation",
    "validation_dict",
    "withheld_points",
]

Noise: TypeAlias = tuple[float, float] | None

VALIDATION = ("validation.json", "report/validation.png")
"""What is written beside a fit's own files."""

CAPTION = "Error of each point that was not fitted: over the sensor, and from the middle of the field to its edge."

LISTED = 8
"""Points with the largest errors that are listed; validation.json has all."""


def withheld_points(source: Path, other: Path | None, how: Reading, fitted: Measured, *, quiet: bool) -> Measured:
    """Return the patterns of positions that were not fitted, or those of another source."""
    from lfcal.cli.fit_source import read_patterns

    if other is not None:
        return read_patterns(other, replace(how, plan=None), quiet=quiet)[0]
    done = frozenset((int(z), int(y), int(x)) for z, y, x in fitted.index)
    return read_patterns(source, replace(how, without=done), quiet=quiet)[0]


def iter_write_validation(
    fit: Fit, withheld: Measured, out: Path, source: Path, other: Path | None
) -> Work[Validation]:
    """Predict withheld points, and write numbers and picture into a fit's folder."""
    from lfcal.fit.files import json_text, write_text
    from lfcal.fit.report import add_picture
    from lfcal.fit.validate import draw_validation, iter_validate

    found = yield from iter_validate(fit, withheld, another=other is not None)
    numbers, picture = (out / name for name in VALIDATION)
    picture.parent.mkdir(parents=True, exist_ok=True)
    draw_validation(found, picture)
    add_picture(picture.parent, "Points that were not fitted", found.verdict, picture, CAPTION)
    write_text(numbers, json_text(validation_dict(found) | {"source": (other or source).name}))
    return found


def read_object(frame: Path, scene: Path, how: Reading, fitted: Measured) -> tuple[NewFrame, NDArray[np.float32]]:
    """Return the frame of a known object, corrected, and the object; before anything is fitted."""
    from lfcal.frames import corrected_view
    from lfcal.reconstruct.volumes import load_volume

    with ExitStack() as stack:
        view = corrected_view(single_frames(frame, stack), how.recipe, fitted.plan)
        if len(view) != 1:
            raise InputError.expected(f"{frame}, frames", "one", len(view), "name the frame of the object")
        shot = new_frame(view, 0, None, None, frame.name)
    volume = load_volume(scene)
    planes, shape = len(fitted.plan.depths_um), shot.values.shape
    if volume.shape != (planes, *shape):
        wanted = f"{(planes, *shape)}: the planes of H, the pixels of the frame"
        raise InputError.expected(f"{scene}, volume", wanted, volume.shape, "resample it")
    if not np.isfinite(volume).all() or not volume.any():
        raise InputError.expected(f"{scene}, volume", "finite values, some above 0", "others", "correct it")
    return shot, volume


def object_error(H: Path, shot: NewFrame, volume: NDArray[np.float32], given: Noise, workers: int | None) -> Compared:
    """Return a known object's frame beside what H makes of the object."""
    from lfcal.fit.validate import predicted_frame
    from lfcal.psf import open_psf
    from lfcal.reconstruct.projectors.projector import Projector

    noise = given or shot.noise
    if noise is None:
        raise InputError.expected(f"{shot.label}, noise", "a variance of its samples", "none", "state it with --noise")
    rows, columns = shot.values.shape
    with open_psf(H) as matrix:
        light = Projector(matrix, (rows, columns), workers=workers).forward(volume)
        return predicted_frame(np.asarray(light, np.float64), shot, noise, matrix.cutout)


def object_dict(found: Compared) -> dict[str, Any]:
    """Return how well a known object's frame was predicted, as plain types."""
    return {"frame": found.label, "error": _error(found.error), "chi2": found.chi_square.lit, "light": found.gain}


def validation_dict(found: Validation) -> dict[str, Any]:
    """Return what was found as plain types; the fitted camera's errors, and those of H taken as periodic."""
    parts = {"all": found.points, "middle": found.middle, "edges": found.edges}
    errors = {
        how: {name: _error(found.error(part, periodic=how == "periodic")) for name, part in parts.items()}
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


def _error(error: ModelError) -> dict[str, Any]:
    return {"known": error.known, "value": error.value, "sigma": error.sigma, "limit": error.limit}


def _point(one: PointError) -> dict[str, Any]:
    return {
        "position": [one.z, one.y, one.x],
        "pixel": one.place_px,
        "field": one.field,
        "error": _error(one.model.error),
        "chi2": one.model.chi_square.lit,
        "displacement_px": one.model.displacement_px,
        "light": one.model.gain,
        "periodic": None if one.periodic is None else _error(one.periodic.error),
    }


def show_validation(found: Validation) -> None:
    """Print the points with the largest errors, and what all of them say."""
    from lfcal.cli.console import print_table

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
