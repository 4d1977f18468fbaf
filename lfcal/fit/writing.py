"""Everything that a fit makes, in a folder: camera, effects, H, numbers and report."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from lfcal.base import Work
from lfcal.fit.files import (
    effects_text,
    fit_dict,
    iter_write_hybrid,
    iter_write_model,
    json_text,
    measured_camera,
    write_text,
)
from lfcal.fit.hybrid import HybridSummary, hybrid_note
from lfcal.fit.measured import Measured
from lfcal.fit.report import iter_fit_report, report_files
from lfcal.fit.result import Fit
from lfcal.psf import PSFMatrix
from lfcal.work import RunChoice, discard, parts_folder

__all__ = ["CAMERA", "EFFECTS", "MODEL", "NUMBERS", "REPORT", "Written", "fit_outputs", "iter_write_fit", "write_found"]

CAMERA, EFFECTS, MODEL, NUMBERS, REPORT = "camera.json", "effects.json", "H.h5", "fit.json", "report"


class Written(NamedTuple):
    """Files of a fit, and what a hybrid H has beyond the model."""

    files: list[Path]
    hybrid: HybridSummary | None


def write_found(fit: Fit, folder: Path, name: str, numbers: Mapping[str, Any]) -> list[Path]:
    """Write camera, effects, and last the numbers with the time, to ``name``; return the files.

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
    """Return all files that a fit in ``folder`` consists of."""
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
    """Write everything that a fit makes; ``fit.json`` comes last: where it is, all of it is.

    Parameters
    ----------
    fit, measured
        What was found, and in which patterns.
    folder
        Made where it is not there yet.
    known
        What is known of the source of the patterns, as plain JSON types; ``"source"`` is its name.
    patterns, noise
        Those of which H is the hybrid, and their noise where they do not state it; None: H is the model.
    with_h
        Whether H of the fitted camera is computed and written.
    workers
        Threads; None takes every processor.
    run
        By whom the planes of a model H are made in units of long work; None: one after the other. A hybrid H is not:
        its summary is of all planes.

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
        # killed until here, it goes on from the planes that are made
        discard(parts_folder(folder / MODEL))
    return Written(written, summary)
