"""Write a fit to files: camera and effects for other commands, numbers, H, report, and the folder with all of them."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from lfcal.base import Work, plain, write_text
from lfcal.camera import Camera, ScanPlan, quantities_of, value_at
from lfcal.fit.hybrid import HybridPlanes, HybridSummary, hybrid_note
from lfcal.fit.measured import Measured
from lfcal.fit.report import iter_fit_report, report_files
from lfcal.fit.result import Fit
from lfcal.psf import OF_FRAMES, Header, PSFMatrix, Stored, iter_write
from lfcal.simulate.effects import Effect, Entry, entries_json
from lfcal.work import RunChoice, discard, parts_folder

__all__ = [
    "CAMERA",
    "EFFECTS",
    "FORMAT",
    "MODEL",
    "NUMBERS",
    "REPORT",
    "VERSION",
    "Written",
    "effects_text",
    "fit_dict",
    "fit_outputs",
    "iter_write_fit",
    "iter_write_hybrid",
    "iter_write_model",
    "json_text",
    "measured_camera",
    "write_found",
]

FORMAT = "lfcal-fit"
VERSION = 1


class CameraResult(Protocol):
    """Protocol for a result with a fitted camera, its effects, and the scan with the camera before the fit."""

    @property
    def camera(self) -> Camera:
        """Fitted camera."""

    @property
    def effects(self) -> tuple[Effect, ...]:
        """Fitted effects."""

    @property
    def planned(self) -> ScanPlan:
        """Scan with the camera before the fit."""


def measured_camera(fit: CameraResult) -> Camera:
    """Return the fitted camera; values that differ from the description are marked as measured."""
    camera, described = fit.camera, fit.planned.camera
    known = {quantity.path for quantity in quantities_of(described)}
    paths = [quantity.path for quantity in quantities_of(camera)]
    other = [path for path in paths if path not in known or value_at(camera, path) != value_at(described, path)]
    return replace(camera, marks=camera.marks.marked(other, "measured"))


def effects_text(fit: CameraResult) -> str:
    """Return the fitted effects as JSON text for ``lfcal simulate --effect``, with all of them switched on."""
    return entries_json(
        Entry(
            effect,
            effect.name,
            {one.name: "measured" for one in fields(effect) if getattr(effect, one.name) is not None},  # type: ignore[arg-type]  # effects are dataclasses
            "on",
        )
        for effect in fit.effects
    )


def fit_dict(fit: Fit) -> dict[str, Any]:
    """Return the results of a fit as plain JSON types, without H and residuals; lengths in µm, ``aside_px`` in px."""
    error = fit.held_out_error
    found: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "version": VERSION,
            "camera": fit.camera.name,
            "middle_um": fit.middle_um,
            "verdict": fit.verdict,
            "complete": fit.complete,
            "chi2": fit.chi_square.to_dict(),
            "left_out_error": {**error.to_dict(), "statistical": error.statistical, "patterns": error.patterns},
            "patterns": len(fit.residuals),
            "positions": [list(at) for at in fit.residuals],
            "parameters": list(fit.parameters.values()),
            "correlations": fit.correlations,
            "groups": fit.groups,
            "unhelpful": fit.unhelpful,
            "held": fit.held,
            "unidentified": fit.unidentified,
            "outliers": fit.outliers,
            "answers": dict(fit.answers),
            "spread": fit.spread,
            "scan": {"period": fit.planned.period, "anchor": fit.planned.anchor, "cutout": fit.planned.cutout},
            "depths_um": fit.planned.depths_um,
            "depth_errors_um": fit.setup.depth_errors_um,
            "stage_scale": fit.setup.stage_scale,
            "aside_px": fit.setup.aside_px,
            "travel_rad": fit.setup.travel_rad,
            "gains": fit.levels.gains,
            "planes_without_patterns": fit.unseen,
            "backgrounds": fit.levels.backgrounds,
        }
    )
    return found


def _header(fit: Fit, provenance: Mapping[str, Any] | None) -> Header:
    """Return the header of an H file of the fitted camera; ``provenance`` is added to that of the fit."""
    return replace(fit.header, camera=measured_camera(fit), provenance={**fit.provenance, **(provenance or {})})


def iter_write_model(
    fit: Fit,
    out: str | os.PathLike[str],
    *,
    provenance: Mapping[str, Any] | None = None,
    compression: str = "gzip",
    workers: int | None = None,
    run: RunChoice | None = None,
    keep: bool = False,
) -> Work[Path]:
    """Write H of the fitted camera to the file ``out``, with one plane in memory at a time, and return the path.

    Progress counts rows. Closing the generator leaves no incomplete file. ``provenance`` is stored in addition to that
    of the fit. ``compression`` is as in `lfcal.psf.PSFWriter`. With ``run``, each plane is computed as a separate unit;
    ``keep`` keeps the files of the units. The fit itself has no units, because each of its steps takes seconds and
    needs the previous step. After a stop, the fit is repeated with the same result, and the computation of H is
    resumed.

    Raises
    ------
    StorageError
        If the file cannot be written.
    """
    source, stored = fit.planes(_header(fit, provenance)), Stored(compression=compression)
    return (yield from iter_write(source, out, stored, run=run, keep=keep, workers=workers))


def iter_write_hybrid(
    fit: Fit,
    source: PSFMatrix | Measured,
    out: str | os.PathLike[str],
    *,
    noise: tuple[float, float] | None = None,
    provenance: Mapping[str, Any] | None = None,
    compression: str = "gzip",
    workers: int | None = None,
) -> Work[HybridSummary]:
    """Write the hybrid H of a fit and recorded patterns to a file, plane by plane, and return its summary.

    Yields progress. Closing the generator leaves no incomplete file. ``source`` contains the recorded patterns.
    ``noise`` is the constant and the slope of the variance of a sample, as in `lfcal.fit.NewFrame`. It replaces the
    noise that an H states, and is required if the H states none. ``provenance`` is stored in addition to that of the
    fit. ``compression`` is as in `lfcal.psf.PSFWriter`.

    Raises
    ------
    InputError
        If the patterns belong to another scan, or the noise of the patterns is unknown.
    StorageError
        If the file cannot be written.
    """
    recorded = source.provenance if isinstance(source, PSFMatrix) else {}
    kept = {name: recorded[name] for name in OF_FRAMES if name in recorded}
    planes = HybridPlanes(_header(fit, {**kept, **(provenance or {})}), fit, source, noise)
    yield from iter_write(planes, out, Stored(compression=compression), workers=workers)
    return planes.summary


def json_text(value: Any) -> str:
    """Return ``value`` as JSON text."""
    return json.dumps(plain(value), indent=2, ensure_ascii=False) + "\n"


CAMERA, EFFECTS, MODEL, NUMBERS, REPORT = "camera.json", "effects.json", "H.h5", "fit.json", "report"


class Written(NamedTuple):
    """Paths of the files of a fit, and the summary of its hybrid H, which is None without a hybrid H."""

    files: list[Path]
    hybrid: HybridSummary | None


def write_found(fit: CameraResult, folder: Path, name: str, numbers: Mapping[str, Any]) -> list[Path]:
    """Write the camera, the effects and then ``numbers`` into ``folder``, and return the paths.

    The current time is added to ``numbers``, which are written as JSON to the file ``name``.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    texts = {
        CAMERA: measured_camera(fit).to_json(),
        EFFECTS: effects_text(fit),
        name: json_text({**numbers, "fitted": datetime.now(UTC).isoformat(timespec="seconds")}),
    }
    for own, text in texts.items():
        write_text(folder / own, text)
    return [folder / own for own in texts]


def fit_outputs(folder: Path) -> list[Path]:
    """Return the paths of all files that a fit can write to ``folder``."""
    files = [folder / name for name in (MODEL, CAMERA, EFFECTS, NUMBERS)]
    return [*files, *report_files(folder / REPORT)]


def iter_write_fit(
    fit: Fit,
    measured: Measured,
    folder: Path,
    known: Mapping[str, Any],
    *,
    patterns: PSFMatrix | Measured | None = None,
    noise: tuple[float, float] | None = None,
    with_h: bool = True,
    workers: int | None = None,
    run: RunChoice | None = None,
) -> Work[Written]:
    """Write all files of a fit; ``fit.json`` is last, so that it exists only if all others do.

    Parameters
    ----------
    fit, measured
        Result of the fit, and its patterns.
    folder
        Output folder, created if needed.
    known
        Facts about the source of the patterns, as plain JSON types; ``"source"`` is its name.
    patterns, noise
        Patterns for a hybrid H (None: H is the model); constant and slope of the variance of a sample (None: as stated
        by the patterns).
    with_h
        Whether to compute and write H of the fitted camera.
    workers
        Number of threads. None: all processors.
    run
        Executor that computes the planes of a model H as separate units. None: one after the other. A hybrid H has no
        units, because its summary covers all planes.

    Raises
    ------
    StorageError
        If a file cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written: list[Path] = []
    summary: HybridSummary | None = None
    if patterns is not None:
        work = iter_write_hybrid(fit, patterns, folder / MODEL, noise=noise, provenance=known, workers=workers)
        summary = yield from work
        written.append(folder / MODEL)
    elif with_h:
        work_of_h = iter_write_model(
            fit, folder / MODEL, provenance=known, workers=workers, run=run, keep=run is not None
        )
        written.append((yield from work_of_h))
    notes = () if summary is None else (str(summary),)
    written.append((yield from iter_fit_report(fit, measured, folder / REPORT, str(known.get("source", "")), notes)))
    numbers = fit_dict(fit) | ({} if summary is None else hybrid_note(summary)) | dict(known)
    written += write_found(fit, folder, NUMBERS, numbers)
    if run is not None:
        # after a stop before this point, work continues from the finished planes
        discard(parts_folder(folder / MODEL))
    return Written(written, summary)
