"""H from a file: that of lfcal, of other codes, or a plain array."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera
from lfcal.errors import FileFormatError, StorageError
from lfcal.files import check_dataset, open_h5_file
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import FORMAT, VERSION

__all__ = ["open_psf"]


def open_psf(path: str | os.PathLike[str]) -> PSFMatrix:
    """Open an H file, a MATLAB v7.3 file of another code, or an ``.npy`` file as a lazy `PSFMatrix`.

    Raises
    ------
    StorageError
        If there is no such file or it may not be read.
    FileFormatError, UnsafeFileError
        If it is damaged, of another format, or asks for something unsafe.
    """
    source = Path(path)
    suffix = source.suffix.lower()
    if suffix == ".npy":
        return PSFMatrix(_map_npy(source))
    if suffix == ".mat":
        from lfcal.psf.matlab import open_mat

        return open_mat(source)
    file = open_h5_file(source)
    try:
        return _matrix_of(file)
    except BaseException:
        file.close()
        raise


def _matrix_of(file: Any) -> PSFMatrix:
    found = file.attrs.get("format")
    if found != FORMAT:
        what = f"format {found!r}" if found is not None else "an HDF5 file of another kind"
        raise FileFormatError.expected(file.filename, "an H file of lfcal", what, "import it as frames instead")
    version = file.attrs.get("version")
    if version != VERSION:
        raise FileFormatError.expected(file.filename, f"version {VERSION}", version, "update lfcal")
    data = check_dataset(file, "H")
    extra = {name: _small(file, name) for name in ("depth_sum", "recorded", "saturated") if name in file}
    camera = file.attrs.get("camera")
    try:
        provenance = json.loads(file.attrs.get("provenance", "{}"))
    except ValueError:
        provenance = {}
    anchor = np.asarray(file.attrs.get("anchor", (0.0, 0.0)), np.float64).ravel()
    matrix = PSFMatrix(
        data,
        depths=_small(file, "depths"),
        camera=Camera.from_json(camera) if camera is not None else None,
        anchor=(float(anchor[0]), float(anchor[1])),
        scale=data.attrs.get("scale", 1.0),
        offset=data.attrs.get("offset", 0.0),
        recorded=extra.get("recorded"),
        depth_sums=extra.get("depth_sum"),
        saturated=extra.get("saturated"),
        provenance=provenance if isinstance(provenance, dict) else {},
    )
    matrix._is_transposed = file.attrs.get("matrix") == "HT"
    return matrix


def _small(file: Any, name: str) -> NDArray[Any]:
    values: NDArray[Any] = check_dataset(file, name, max_bytes=1 << 32)[()]
    return values


def _map_npy(path: Path) -> NDArray[Any]:
    if not path.exists():
        raise StorageError(f"{path}: no such file; check the path")
    try:
        mapped: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        reason = "pickled objects" if "pickle" in str(error).lower() else "a damaged or other file"
        raise FileFormatError.expected(
            str(path), "an .npy file of plain numbers", reason, "save the array itself again"
        ) from error
    return mapped
