"""Reconstructed volumes as files: TIFF stacks and HDF5, whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.errors import InputError
from lfcal.files import replace_whole, require_space, storage_errors
from lfcal.h5.file import H5File
from lfcal.h5.writing import new_h5
from lfcal.npy import map_npy

__all__ = ["SUFFIXES", "check_suffix", "load_volume", "save_volume"]

SUFFIXES = (".tif", ".tiff", ".h5", ".hdf5", ".npy")
"""File types of volumes."""

DATASET = "volume"


def check_suffix(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` or raise `InputError` if no volume can have such a name."""
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise InputError.expected("volume file", " or ".join(SUFFIXES), target.name, "give it one of these endings")
    return target


def save_volume(
    path: str | os.PathLike[str],
    volume: ArrayLike,
    *,
    depths_um: ArrayLike | None = None,
    voxel_um: float | None = None,
    details: Mapping[str, Any] | None = None,
) -> None:
    """Write a volume ``(nz, Y, X)`` as float32; the ending of ``path`` decides how.

    Parameters
    ----------
    path
        ``.tif`` (a stack ImageJ opens, z spacing and voxel size in µm), ``.h5`` (dataset ``volume``, axes z, y, x,
        with ``depths``), or ``.npy``.
    volume
        ``(nz, Y, X)``.
    depths_um
        Depth of each plane (µm).
    voxel_um
        Voxel size in y and x in object space (µm).
    details
        What else to keep, plain JSON types.

    Raises
    ------
    InputError, StorageError
        If the ending is unknown, or the disk does not take it; nothing half-written stays.
    """
    target = check_suffix(path)
    data = np.ascontiguousarray(volume, np.float32)
    if data.ndim != 3:
        raise InputError.expected("volume", "three axes (z, y, x)", data.shape, "add the missing axis")
    depths = None if depths_um is None else np.asarray(depths_um, np.float64)
    require_space(target.parent, data.nbytes + (1 << 16), what="the volume")
    if target.suffix.lower() in (".h5", ".hdf5"):
        _save_h5(target, data, depths, voxel_um, details)
        return
    with replace_whole(target) as part, storage_errors(target):
        if target.suffix.lower() == ".npy":
            with part.open("wb") as file:
                np.save(file, data, allow_pickle=False)
        else:
            _save_tiff(part, data, depths, voxel_um, details)


def _save_tiff(
    part: Path,
    data: NDArray[np.float32],
    depths: NDArray[np.float64] | None,
    voxel_um: float | None,
    details: Mapping[str, Any] | None,
) -> None:
    import tifffile

    metadata: dict[str, Any] = {"axes": "ZYX", "unit": "um", "lfcal": json.dumps(dict(details or {}))}
    if depths is not None and len(depths) > 1:
        # ImageJ takes one spacing for the whole stack: the mean where planes are uneven
        metadata["spacing"] = float(np.abs(np.diff(depths)).mean())
    resolution = None if voxel_um is None else (1 / voxel_um, 1 / voxel_um)
    big = data.nbytes > 3 << 30  # the ImageJ form holds 4 GB at most
    tifffile.imwrite(
        part, data, imagej=not big, bigtiff=big, metadata=metadata, resolution=resolution, photometric="minisblack"
    )


def _save_h5(
    target: Path,
    data: NDArray[np.float32],
    depths: NDArray[np.float64] | None,
    voxel_um: float | None,
    details: Mapping[str, Any] | None,
) -> None:
    with new_h5(target) as file:
        stored = file.create_dataset(
            DATASET,
            data=data,
            # one plane per chunk, as volumes are looked at
            chunks=(1, *data.shape[1:]),
            compression="gzip",
            compression_opts=1,
            shuffle=True,
            fletcher32=True,
        )
        stored.attrs["axes"] = "z, y, x"
        file.attrs["format"] = "lfcal-volume"
        file.attrs["version"] = 1
        file.attrs["details"] = json.dumps(dict(details or {}))
        if depths is not None:
            file.create_dataset("depths", data=depths).attrs["unit"] = "um"
        if voxel_um is not None:
            file.attrs["voxel_um"] = voxel_um


def load_volume(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Return the volume ``(nz, Y, X)`` of a file that `save_volume` wrote, or of any stack of that form.

    Raises
    ------
    FileFormatError, StorageError
        If it is not such a file.
    """
    source = check_suffix(path)
    if source.suffix.lower() in (".h5", ".hdf5"):
        with H5File(source) as file:
            data = file.dataset(DATASET).read()
    elif source.suffix.lower() == ".npy":
        data = map_npy(source)
    else:
        import tifffile

        with storage_errors(source):
            data = tifffile.imread(source)
    volume = np.asarray(data, np.float32)
    if volume.ndim == 2:
        volume = volume[None]
    if volume.ndim != 3:
        raise InputError.expected(str(source), "a volume (z, y, x)", volume.shape, "choose another file")
    return volume
