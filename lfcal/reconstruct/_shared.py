"""Names of `lfcal.reconstruct` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.reconstruct.margin import cropped, usual_margin
from lfcal.reconstruct.memory import room_for_projections, run_memory
from lfcal.reconstruct.phantoms import PHANTOMS, nrmse, phantom, points
from lfcal.reconstruct.resample import MOST_DRIFT, drift_note, drift_words, lattice_anchor_of
from lfcal.reconstruct.series import check_any, check_warm, iter_frame
from lfcal.reconstruct.volumes import (
    DATASET,
    SUFFIXES,
    VOLUME_FORMAT,
    VolumeFacts,
    check_suffix,
    check_zarr,
    open_ome_zarr,
    write_volumes,
    zarr_contents,
)

__all__ = [
    "DATASET",
    "MOST_DRIFT",
    "PHANTOMS",
    "SUFFIXES",
    "VOLUME_FORMAT",
    "VolumeFacts",
    "check_any",
    "check_suffix",
    "check_warm",
    "check_zarr",
    "cropped",
    "drift_note",
    "drift_words",
    "iter_frame",
    "lattice_anchor_of",
    "nrmse",
    "open_ome_zarr",
    "phantom",
    "points",
    "room_for_projections",
    "run_memory",
    "usual_margin",
    "write_volumes",
    "zarr_contents",
]
