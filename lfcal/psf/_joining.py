"""Join planes that were written to separate files into one H file; the stored bytes are copied unchanged."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from lfcal.base import FileFormatError
from lfcal.base.h5 import H5File
from lfcal.psf.layout import StoredPlane
from lfcal.psf.opening import depth_sums_of, facts_in, provenance_of, scaling_of
from lfcal.psf.provenance import simulated_planes
from lfcal.psf.store import VERSION, PSFWriter

__all__ = ["adopt", "stored_plane"]


def adopt(writer: PSFWriter, z: int, path: Path) -> None:
    """Copy plane ``z`` from an H file of this single plane, which has the writer's stored type and compression.

    Raises
    ------
    FileFormatError, StorageError
        If the file is damaged or missing.
    InputError
        If the plane does not have the writer's shape, stored type or compression.
    """
    with H5File(path) as file:
        writer.adopt_plane(z, stored_plane(file))


def stored_plane(file: H5File) -> StoredPlane:
    """Return the plane of an H file with a single plane, in its stored form."""
    data = file.dataset("H")
    if data.ndim != 5 or data.shape[0] != 1:
        raise FileFormatError.expected(
            data.where, "the file of one plane", f"shape {data.shape}", "remove this file and run the command again"
        )
    shape = data.shape
    version = file.attributes().integer("version")
    if version != VERSION or scaling_of(file, data)[0].tolist() != [1]:
        raise FileFormatError.expected(
            str(file.path),
            f"an unscaled plane of version {VERSION}",
            f"version {version}",
            "remove this file and run the command again",
        )
    facts = facts_in(file, "", (1, shape[1], shape[2], shape[3], shape[4]), {})
    step = file.values("step", shape[:3], kinds="f", finite=True)[0].astype(np.float32) if "step" in file else None
    return StoredPlane(
        data,
        depth_sums_of(file, "depth_sum", shape)[0],
        file.values("used_window", (1, 4), kinds="i")[0].astype(np.int32),
        int(file.values("checksum", (1,), kinds="u")[0]),
        float(file.values("error", (1,), kinds="f")[0]),
        replace(facts, error=None).plane(0),
        file.dataset("uncertainty") if "uncertainty" in file else None,
        step,
        simulated_planes(provenance_of(file), 1)[0],
    )
