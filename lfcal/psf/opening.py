"""H from a file: that of lfcal, of other codes, or a plain array."""

from __future__ import annotations

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.axes import check_psf_shape
from lfcal.camera import Camera
from lfcal.errors import FileFormatError, InputError, StorageError
from lfcal.files import check_dataset, check_regular, open_h5, open_h5_file
from lfcal.psf.chunk_codec import parallel_read
from lfcal.psf.facts import Facts
from lfcal.psf.layout import plane_checksum
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import FORMAT, REGIONS, VERSION

__all__ = ["open_psf", "regions_of"]


VERSIONS = (1, VERSION)
"""Versions of the format that are read; what version 1 does not hold is unknown."""


def open_psf(path: str | os.PathLike[str], *, region: str = "", check: bool = False) -> PSFMatrix:
    """Open an H file, a MATLAB v7.3 file of another code, or an ``.npy`` file as a lazy `PSFMatrix`.

    Parameters
    ----------
    path
        The file.
    region
        Region of the field, in a file of several; empty: the one the file opens with.
    check
        Read every plane and compare it with its checksum (files of lfcal, version 2).

    Raises
    ------
    StorageError
        If there is no such file or it may not be read.
    FileFormatError, UnsafeFileError
        If it is damaged, of another format, or asks for something unsafe.
    InputError
        If it has no such region.
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
        matrix, sums = _matrix_of(file, region)
        if check:
            _check_planes(file, matrix, sums)
        return matrix
    except BaseException:
        file.close()
        raise


def regions_of(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the names of the regions of the field in an H file, the one it opens with first (``""`` if unnamed)."""
    with open_h5(path) as file:
        _check_format(file)
        return (str(file.attrs.get("region", "")), *_further(file))


def _further(file: Any) -> tuple[str, ...]:
    return tuple(file[REGIONS]) if REGIONS in file else ()


def _check_format(file: Any) -> None:
    found = file.attrs.get("format")
    if found != FORMAT:
        what = f"format {found!r}" if found is not None else "an HDF5 file of another kind"
        raise FileFormatError.expected(file.filename, "an H file of lfcal", what, "import it as frames instead")
    version = file.attrs.get("version")
    if version not in VERSIONS:
        raise FileFormatError.expected(file.filename, f"version {VERSION} or older", version, "update lfcal")


def _matrix_of(file: Any, region: str) -> tuple[PSFMatrix, NDArray[np.uint32] | None]:
    """Return the matrix of a region and the checksums of its planes, None where the file has none."""
    _check_format(file)
    prefix = ""
    if region and region != file.attrs.get("region", ""):
        names = (str(file.attrs.get("region", "")), *_further(file))
        if region not in names:
            raise InputError.expected(f"{file.filename}, region", " or ".join(names), repr(region), "choose one")
        prefix = f"{REGIONS}/{region}/"
    data = check_dataset(file, f"{prefix}H")
    shape = check_psf_shape(tuple(data.shape))
    attributes = data.parent.attrs
    small = {entry.name: _small(file, prefix + entry.name) for entry in fields(Facts) if prefix + entry.name in file}
    camera = attributes.get("camera")
    try:
        provenance = json.loads(attributes.get("provenance", "{}"))
    except ValueError:
        provenance = {}
    provenance = provenance if isinstance(provenance, dict) else {}
    if file.attrs.get("version") == 1 and "saturated" in small and not provenance.get("corrections"):
        # assembly without corrections did not count then, and wrote zeros
        small["saturated"] = np.where(small["saturated"] == 0, -1, small["saturated"].astype(np.int32))
    anchor = np.asarray(attributes.get("anchor", (0.0, 0.0)), np.float64).ravel()
    matrix = PSFMatrix(
        data,
        depths=_small(file, f"{prefix}depths"),
        camera=Camera.from_json(camera) if camera is not None else None,
        anchor=(float(anchor[0]), float(anchor[1])),
        scale=data.attrs.get("scale", 1.0),
        offset=data.attrs.get("offset", 0.0),
        facts=Facts.of(shape[:3], shape[3:], **small),
        depth_sums=_small(file, f"{prefix}depth_sum") if f"{prefix}depth_sum" in file else None,
        region=str(attributes.get("region", "")),
        transposed=attributes.get("matrix") == "HT",
        provenance=provenance,
    )
    sums = _small(file, f"{prefix}checksum") if f"{prefix}checksum" in file else None
    return matrix, sums


def _check_planes(file: Any, matrix: PSFMatrix, sums: NDArray[np.uint32] | None) -> None:
    if sums is None:
        raise FileFormatError.expected(file.filename, "checksums", "version 1 without them", "save it again")
    prefix = f"{REGIONS}/{matrix.region}/" if matrix.region in _further(file) else ""
    data = check_dataset(file, f"{prefix}H")
    for z in range(len(matrix)):
        found = plane_checksum(parallel_read(data, z))
        if found != int(sums[z]):
            raise FileFormatError.expected(
                f"{file.filename}, plane {z}", f"checksum {int(sums[z]):08x}", f"{found:08x}", "copy the file again"
            )


def _small(file: Any, name: str) -> NDArray[Any]:
    values: NDArray[Any] = check_dataset(file, name, max_bytes=1 << 32)[()]
    return values


def _map_npy(path: Path) -> NDArray[Any]:
    if not path.exists():
        raise StorageError(f"{path}: no such file; check the path")
    check_regular(path)
    try:
        mapped: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        reason = "pickled objects" if "pickle" in str(error).lower() else "a damaged or other file"
        raise FileFormatError.expected(
            str(path), "an .npy file of plain numbers", reason, "save the array itself again"
        ) from error
    return mapped
