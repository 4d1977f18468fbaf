"""Write a fit of several regions to files: common camera and effects, wavefronts, and a folder for each region."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from lfcal.base import Work, plain
from lfcal.fit.field import FieldFit
from lfcal.fit.field_report import field_report_files, iter_field_report
from lfcal.fit.files import CAMERA, EFFECTS, REPORT, fit_dict, fit_outputs, iter_write_fit, write_found
from lfcal.fit.hybrid import HybridSummary
from lfcal.fit.measured import Measured
from lfcal.fit.parameters import field_of
from lfcal.psf import PSFMatrix
from lfcal.work import RunChoice

__all__ = ["FIELD", "FORMAT", "WrittenField", "field_dict", "field_outputs", "iter_write_field"]

FIELD = "field.json"
FORMAT = "lfcal-fit-field"
VERSION = 1

OF_ALL = (
    *("camera", "verdict", "complete", "chi2", "left_out_error", "parameters", "correlations", "groups"),
    *("unhelpful", "held", "unidentified", "answers", "spread", "depths_um"),
)
"""Names of the results that are common to all regions."""


class WrittenField(NamedTuple):
    """Paths of the files of a fit of several regions, and the summary of the hybrid H of each region, by name."""

    files: list[Path]
    hybrids: dict[str, HybridSummary]


def field_outputs(folder: Path, names: Iterable[str]) -> list[Path]:
    """Return the paths of all files that a fit of the regions ``names`` can write to ``folder``."""
    files = [folder / name for name in (CAMERA, EFFECTS, FIELD)]
    files += field_report_files(folder / REPORT)
    return [*files, *(path for name in names for path in fit_outputs(folder / name))]


def field_dict(fit: FieldFit) -> dict[str, Any]:
    """Return the results of a fit of several regions as plain JSON types; lengths in µm, ``aside_px`` in px."""
    whole = fit_dict(fit.first)
    regions = []
    for name, own in fit.fits.items():
        at = field_of(own.planned)
        regions.append(
            {
                "name": name,
                "field_um": at,
                "anchor": own.planned.anchor,
                "patterns": len(own.residuals),
                "aside_px": own.setup.aside_px,
                "depth_errors_um": own.setup.depth_errors_um,
                "gains": own.levels.gains,
                "wavefront": fit.wavefront_at(at),
                "outliers": own.outliers,
                **({} if own.here is None else {"chi2": own.here.chi_square.lit, "error": own.here.error.to_dict()}),
            }
        )
    found: dict[str, Any] = plain(
        {"format": FORMAT, "version": VERSION, **{key: whole[key] for key in OF_ALL}, "regions": regions}
    )
    return found


def iter_write_field(
    fit: FieldFit,
    patterns: Mapping[str, Measured],
    folder: Path,
    known: Mapping[str, Mapping[str, Any]],
    *,
    hybrids: Mapping[str, PSFMatrix | Measured] | None = None,
    noise: tuple[float, float] | None = None,
    with_h: bool = True,
    workers: int | None = None,
    run: RunChoice | None = None,
) -> Work[WrittenField]:
    """Write all files of a fit of several regions; ``field.json`` is last, so that it exists only if all others do.

    Parameters
    ----------
    fit, patterns
        Result of the fit, and the patterns of each region.
    folder
        Output folder, created if needed, with a subfolder for each region like that of a fit of a single region.
    known
        Facts about the source of the patterns of each region, as plain JSON types, by name of the region.
    hybrids, noise
        Patterns for the hybrid H of each region, by name of the region (None: H is the model). Constant and slope of
        the variance of a sample (None: as stated by the patterns).
    with_h
        Whether to compute and write H of each region.
    workers
        Number of threads. None: all processors.
    run
        As in `iter_write_fit`, for each region.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    summaries: dict[str, HybridSummary] = {}
    for name, own in fit.fits.items():
        # outliers are not part of any fit
        work = iter_write_fit(
            own,
            patterns[name],
            folder / name,
            known[name],
            patterns=None if hybrids is None else hybrids[name],
            noise=noise,
            with_h=with_h,
            workers=workers,
            run=run,
        )
        files, summary = yield from work
        written += files
        if summary is not None:
            summaries[name] = summary
    written.append((yield from iter_field_report(fit, folder / REPORT, summaries)))
    written += write_found(fit.first, folder, FIELD, field_dict(fit))
    return WrittenField(written, summaries)
