"""Names of `lfcal.reconstruct` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.reconstruct.bar_run import BarForecast, bar_outputs, iter_bars
from lfcal.reconstruct.error_bars import UNKNOWN
from lfcal.reconstruct.feature_run import feature_outputs, iter_features, read_features
from lfcal.reconstruct.frame_files import FrameFile, cleaner, frames_of, is_series, targets_of
from lfcal.reconstruct.frame_run import FrameRun
from lfcal.reconstruct.margin import cropped, usual_margin
from lfcal.reconstruct.memory import room_for_projections, run_memory
from lfcal.reconstruct.optics import SharedOptics, files_of_regions
from lfcal.reconstruct.phantoms import PHANTOMS, nrmse, phantom, points
from lfcal.reconstruct.resample import drift_note, drift_words, lattice_anchor_of
from lfcal.reconstruct.volumes import (
    DATASET,
    SUFFIXES,
    VOLUME_FORMAT,
    VolumeFacts,
    open_ome_zarr,
    volume_facts,
    zarr_contents,
)

__all__ = [
    "DATASET",
    "PHANTOMS",
    "SUFFIXES",
    "UNKNOWN",
    "VOLUME_FORMAT",
    "BarForecast",
    "FrameFile",
    "FrameRun",
    "SharedOptics",
    "VolumeFacts",
    "bar_outputs",
    "cleaner",
    "cropped",
    "drift_note",
    "drift_words",
    "feature_outputs",
    "files_of_regions",
    "frames_of",
    "is_series",
    "iter_bars",
    "iter_features",
    "lattice_anchor_of",
    "nrmse",
    "open_ome_zarr",
    "phantom",
    "points",
    "read_features",
    "room_for_projections",
    "run_memory",
    "targets_of",
    "usual_margin",
    "volume_facts",
    "zarr_contents",
]
