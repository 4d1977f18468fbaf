"""Fit beads and lines on a frame, from files to files."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, Work, write_text
from lfcal.frames.lists import read_table
from lfcal.reconstruct._feature_shapes import BEYOND
from lfcal.reconstruct._uncertain_h import UncertainH
from lfcal.reconstruct.bar_run import bar_outputs, write_maps
from lfcal.reconstruct.features import Feature, FeatureFit, FittedFeature, depth_at, iter_fit_features
from lfcal.reconstruct.frame_files import cleaner, related, targets_of
from lfcal.reconstruct.frame_run import FrameRun
from lfcal.records import BootstrapSettings

__all__ = ["feature_outputs", "iter_features", "read_features"]

GIVEN = ("row", "column", "depth_um", "brightness", "width", "end_row", "end_column")
"""Columns of a table of initial values; the first two are required."""


ROUNDED = 1e-5
"""Largest relative rounding error of a depth in a table; `lfcal` writes six digits."""


def feature_outputs(out: Path) -> tuple[Path, ...]:
    """Return the paths of the volume ``out`` of the rest, of the maps of its uncertainty, and of the table."""
    return *bar_outputs(out, regions=False), related(out, "_features", ".csv")


def read_features(path: Path, depths: NDArray[np.float64]) -> tuple[Feature, ...]:
    """Return the features in the table ``path``; columns other than `GIVEN` are ignored.

    Cells may be empty, except those of ``row`` and ``column``. ``depths`` ``(nz,)`` are those of the planes of H (µm).

    Raises
    ------
    FileFormatError
        If a column is missing, a cell does not contain a number, or a position has only a row or only a column.
    InputError
        If a depth is more than half a plane beyond the planes.
    """
    table = read_table(path)
    missing = [name for name in GIVEN[:2] if name not in table.columns]
    if missing:
        raise FileFormatError.expected(
            str(path), "columns row and column", ", ".join(table.columns), "name the columns in the first line"
        )
    found = []
    for line, given in zip(table.lines, table.rows, strict=True):
        cells = dict(zip(table.columns, given, strict=True))
        values = {name: _number(path, line, name, cells.get(name, "")) for name in GIVEN}
        row, column = values["row"], values["column"]
        end_row, end_column = values["end_row"], values["end_column"]
        if row is None or column is None or (end_row is None) != (end_column is None):
            what = "a row and a column of each position"
            raise FileFormatError.expected(f"{path}, line {line}", what, "an empty cell", "complete the line")
        depth = values["depth_um"]
        plane = None if depth is None else plane_of(depth, depths)
        end = None if end_row is None or end_column is None else (end_row, end_column)
        found.append(Feature(row, column, plane, values["brightness"], values["width"], end))
    return tuple(found)


def _number(path: Path, line: int, name: str, cell: str) -> float | None:
    if not cell.strip():
        return None
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise FileFormatError.expected(f"{name} in {path}, line {line}", "a number", repr(cell), "correct the cell")
    return value


def plane_of(depth: float, depths: NDArray[np.float64]) -> float:
    """Return the fractional index of the plane at a ``depth`` (µm) among ``depths`` ``(nz,)``.

    Raises
    ------
    InputError
        If the depth is more than half a plane beyond the planes.
    """
    at = np.array([-BEYOND, *range(len(depths)), len(depths) - 1 + BEYOND])
    known = np.array([depth_at(plane, depths)[0] for plane in at])
    low, high = float(known.min()), float(known.max())
    # a written depth is rounded
    if not low - ROUNDED * abs(low) <= depth <= high + ROUNDED * abs(high):
        raise InputError.expected(
            "depth of a feature (µm)", f"a depth from {low:g} to {high:g}", f"{depth:g}", "correct it, or leave it out"
        )
    if len(depths) == 1:
        return 0.0
    order = np.argsort(known)
    return float(np.interp(depth, known[order], at[order]))


def iter_features(
    run: FrameRun,
    out: Path,
    features: Sequence[Feature] | None,
    settings: BootstrapSettings,
    details: Mapping[str, Any],
    *,
    changes: Path | None = None,
) -> Work[FeatureFit]:
    """Fit ``features`` to the frame of ``run``, write the files of `feature_outputs`, and return the fit.

    Parameters
    ----------
    run
        Reconstruction of one frame.
    out
        File for the volume of the rest, which is all light that does not belong to the features.
    features
        Initial values. None: the beads that are visible in the volume.
    settings
        Contrast of the rest, seed, and number of replicates, as in `iter_fit_features`.
    details
        Additional metadata to store in the files of the volume and of the maps.
    changes
        File of the changes of H along the axes of its uncertainty, as in `UncertainH.of`. None: H has no errors apart
        from its stated noise.

    Raises
    ------
    InputError
        If there are several frames, the number of iterations is not fixed, or the features do not fit the frame.
    """
    targets_of(run.frames, out, None)  # checks the type of the file before anything is computed
    if len(run.frames) > 1:
        raise InputError.expected(
            "frames for a fit of features", "one frame", f"{len(run.frames)} frames", "fit them one by one"
        )
    image = run.frames[0].read()
    weights = None if run.view is None else run.view.inside(image.shape)
    frame = cleaner(run.optics.light_field, run.view)(image)
    if not run.choice.solver.in_parts:
        yield from run.projector.iter_prepare()
    P = run.projector
    how: dict[str, Any] = {"contrast": settings.contrast, "weights": weights, "seed": settings.seed}
    how["replicates"] = settings.replicates
    with ExitStack() as stack:
        imaging = None if changes is None else UncertainH.of(P, run.matrices[0], changes, stack)
        fit = yield from iter_fit_features(P, frame, features, run.choice, imaging=imaging, **how)
    assert fit.bars is not None  # there are replicates
    write_text(feature_outputs(out)[-1], _table(fit.features))
    known = {**run.details, **details, "method": P.method, "bootstrap": asdict(settings)}
    write_maps(fit.bars, run, out, known, "rest")
    return fit


COLUMNS = ("row", "column", "depth_um", "brightness", "width", "end_row", "end_column")
"""Fitted values of the written table; each is followed by its standard uncertainty."""


def _table(features: Sequence[FittedFeature]) -> str:
    """Return a line for each feature as comma-separated values; cells without a valid value are empty."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["number", *(f"{pre}{name}" for name in COLUMNS for pre in ("", "sigma_")), "chi2", "limit"])
    for number, one in enumerate(features, 1):
        values = {**asdict(one.feature), "depth_um": one.depth_um}
        values["end_row"], values["end_column"] = one.feature.end or (math.nan, math.nan)
        pairs = [value for name in COLUMNS for value in (values[name], one.sigmas.get(name, math.nan))]
        cells = ("" if math.isnan(value) else f"{value:.6g}" for value in (*pairs, one.chi2, one.limit))
        writer.writerow([number, *cells])
    return text.getvalue()
