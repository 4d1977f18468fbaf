"""Open H from an lfcal H file, from a file of another code, or from a plain array."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    AXES,
    MAX_SAMPLE,
    FileFormatError,
    InputError,
    any_of,
    check_psf_shape,
    map_npy,
    parse_json,
    read_tiff,
)
from lfcal.base.h5 import Attributes, H5Data, H5File
from lfcal.camera import Camera
from lfcal.psf._chunk_codec import parallel_read
from lfcal.psf._planes import DatasetPlanes, FilePlanes, Planes, ScaledPlanes
from lfcal.psf._rearranged import ONE_PER_PLANE, PlacedPlanes, padding_note
from lfcal.psf._steps import SteppedPlanes
from lfcal.psf.facts import Facts
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.store import (
    CENTRE_RULE,
    CHECKED_VERSION,
    FORMAT,
    PLANE_NUMBER,
    REGIONS,
    STEPPED_VERSION,
    VERSION,
    plane_checksum,
)

__all__ = [
    "FOREIGN",
    "MatrixHead",
    "depth_sums_of",
    "facts_in",
    "head_of",
    "mat_order_of",
    "mat_orders_of",
    "open_psf",
    "opening_notes",
    "provenance_of",
    "regions_of",
    "scaling_of",
    "steps_in",
]


VERSIONS = (1, CHECKED_VERSION, STEPPED_VERSION, VERSION)
"""Versions of the format that can be read; facts that version 1 does not store are unknown."""

FOREIGN = (".npy", ".mat", ".lfc", ".tif", ".tiff")
"""Suffixes of the files of other codes that `open_psf` reads."""


def open_psf(path: str | os.PathLike[str], *, region: str = "", check: bool = False, mat_order: str = "") -> PSFMatrix:
    """Open an H file, an ``.npy`` file, or a file written by other software as a `PSFMatrix`.

    Values are read on demand, except those of TIFF files and of cell arrays in ``.mat`` files. An ``.npy`` file
    contains H with the axes (z, y, x, t, s).

    Supported files of other software are MATLAB v7.3 files (``.mat``) and calibrations of napari-LF (``.lfc``). A stack
    with one pattern for each plane is opened as an H with a period of 1 x 1, as for a Fourier light-field microscope.
    Such a stack may be a TIFF file, an array (z, t, s) in an ``.npy`` file, or an array ``H`` or ``PSF`` with three
    axes in a ``.mat`` file.

    Parameters
    ----------
    path
        Path of the file.
    region
        Name of the region in a file with several regions of the field of view; empty: the default region of the file.
    check
        Whether to read every plane and compare it with its checksum, which H files contain since version 2 of the
        format.
    mat_order
        Order of the axes of H in a ``.mat`` file that does not state it. ``"rows-first"``: ``H(t, s, y, x, z)``.
        ``"columns-first"``: ``H(s, t, x, y, z)``. Empty: the order is inferred from the variables in the file, as
        `opening_notes` reports.

    Raises
    ------
    StorageError
        If the file does not exist or cannot be read.
    FileFormatError, UnsafeFileError
        If the file is damaged or unsafe, or its format is not supported.
    InputError
        If the file has no such region, or ``region``, ``check`` or ``mat_order`` does not apply to its format.

    Examples
    --------
    >>> from lfcal.psf import open_psf
    >>> with open_psf("H.h5") as H:
    ...     print(H.shape, H.depths.round().tolist(), H.aperture(1).blades)
    (2, 19, 33, 55, 55) [-20035.0, -26018.0] 7
    """
    source = Path(path)
    matrix = _open(source, region, check, mat_order)
    if matrix.dtype.kind == "c":
        matrix.close()
        raise FileFormatError.expected(
            str(source), "real numbers", f"{matrix.dtype}", "store the intensity, which is |amplitude|²"
        )
    return matrix.opened_by(partial(open_psf, os.path.abspath(source), region=region, mat_order=mat_order))


def _open(source: Path, region: str, check: bool, mat_order: str) -> PSFMatrix:
    suffix = source.suffix.lower()
    if mat_order and suffix != ".mat":
        raise InputError.expected("file with an order of axes", "a .mat file", source.name, "omit the order")
    if region and suffix in FOREIGN:
        raise InputError.expected(f"{source}, region", "an lfcal H file", f"a {suffix} file", "omit the region")
    if check and suffix in FOREIGN:
        raise InputError.expected(f"{source}, checksums", "an lfcal H file", f"a {suffix} file", "omit the checksums")
    if suffix == ".npy":
        return _of_npy(source)
    if suffix == ".mat":
        from lfcal.psf.mat_import import open_mat

        return open_mat(source, mat_order=mat_order)
    if suffix == ".lfc":
        from lfcal.psf._lfc_import import open_lfc

        return open_lfc(source)
    if suffix in (".tif", ".tiff"):
        return _of_tiff(source)
    file = H5File(source)
    try:
        group = _region_group(file, region)
        matrix = _matrix_of(file, group)
        if check:
            _check_planes(file, group)
        return matrix
    except BaseException:
        file.close()
        raise


def _of_npy(source: Path) -> PSFMatrix:
    values = map_npy(source)
    return _stack_of(values, source) if values.ndim == 3 else _of_array(values, source, [])


def _of_tiff(source: Path) -> PSFMatrix:
    values = read_tiff(source)
    if values.ndim not in (2, 3) or values.shape[-1] in (3, 4):  # the last axis is one of colours
        raise InputError.expected(
            str(source), "one pattern for each plane", f"shape {values.shape}", "export H as a .h5, .mat or .npy file"
        )
    return _stack_of(values if values.ndim == 3 else values[None], source)


def _stack_of(values: NDArray[Any], source: Path) -> PSFMatrix:
    """Return the H of one pattern for each plane, ``values`` (z, t, s)."""
    return _of_array(values[:, None, None], source, [ONE_PER_PLANE])


def _of_array(values: NDArray[Any], source: Path, notes: list[str]) -> PSFMatrix:
    planes: Planes = FilePlanes(values, source)
    if note := padding_note(planes.shape[3:]):
        nt, ns = planes.shape[3:]
        planes, notes = PlacedPlanes(planes, (nt + 1 - nt % 2, ns + 1 - ns % 2)), [*notes, note]
    return PSFMatrix(planes, provenance={"imported": source.name, "notes": notes} if notes else None)


def opening_notes(matrix: PSFMatrix) -> tuple[str, ...]:
    """Return notes on how a file of other software was read, such as the order of its axes; one line each.

    The result is empty for an H file. If the H file was made from a file of other software, its provenance contains the
    notes.
    """
    if matrix.path and Path(matrix.path).suffix.lower() not in FOREIGN:
        return ()
    notes = matrix.provenance.get("notes", ())
    return tuple(str(note) for note in notes) if isinstance(notes, list) else ()


def mat_order_of(matrix: PSFMatrix) -> str:
    """Return the ``mat_order`` with which `open_psf` reads the file of ``matrix`` in the same way again.

    It is empty unless the file is a ``.mat`` file.
    """
    return str(matrix.provenance.get("mat_order", "")) if Path(matrix.path).suffix.lower() == ".mat" else ""


def mat_orders_of(matrix: PSFMatrix) -> tuple[str, ...]:
    """Return the ``mat_order`` in which a ``.mat`` file was read, then the other one; empty if the file states one."""
    from lfcal.psf.mat_import import MAT_ORDERS

    order = mat_order_of(matrix) if matrix.provenance.get("mat_order_open") else ""
    return (order, *(other for other in MAT_ORDERS if other != order)) if order else ()


def regions_of(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the names of the regions of the field in an H file, default region first (``""`` if it is unnamed).

    For the other formats that `open_psf` reads, the result is ``("",)``.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.psf import PSFMatrix, regions_of, save_regions
    >>> H = np.ones((1, 2, 2, 3, 3))
    >>> path = save_regions({"centre": PSFMatrix(H), "edge": PSFMatrix(0.8 * H)}, "field.h5")
    >>> regions_of(path)
    ('centre', 'edge')
    """
    if Path(path).suffix.lower() in FOREIGN:
        return ("",)
    with H5File(Path(path)) as file:
        _check_format(file)
        return (file.attributes().text("region", ""), *file.names(REGIONS))


def _check_format(file: H5File) -> int:
    """Return the version of the format; raise `FileFormatError` unless it is one that can be read."""
    attributes = file.attributes()
    found = attributes.text("format")
    if found != FORMAT:
        what = f"format {found[:60]!r}" if found is not None else "an HDF5 file of another kind"
        theirs = {".mat": "H" in file, ".lfc": "optics" in file}
        named = next((f"rename it to {suffix}" for suffix, known in theirs.items() if known), "")
        raise FileFormatError.expected(str(file.path), "an lfcal H file", what, named or "import it as frames instead")
    version = attributes.integer("version")
    if version not in VERSIONS:
        raise FileFormatError.expected(
            str(file.path), f"format version {VERSIONS[-1]} or older", f"version {version}", "update lfcal"
        )
    return version


def _region_group(file: H5File, region: str) -> str:
    """Return the group of a region; empty for the default region of the file."""
    _check_format(file)
    own = file.attributes().text("region", "")
    if not region or region == own:
        return ""
    names = (own, *file.names(REGIONS))
    if region not in names:
        if names == ("",):
            raise InputError(
                f"{file.path}: the file contains one region of the field, which has no name; leave the region "
                "out (--region)"
            )
        raise InputError.expected(
            f"{file.path}, region", any_of(filter(None, names)), repr(region), "choose one of these"
        )
    return f"{REGIONS}/{region}"


def _matrix_of(file: H5File, group: str) -> PSFMatrix:
    prefix = f"{group}/" if group else ""
    data = file.dataset(f"{prefix}H")
    shape = check_psf_shape(data.shape)
    attributes = file.attributes(group)
    _check_conventions(file, attributes)
    camera = attributes.text("camera")
    provenance = provenance_of(file, group)
    sums = f"{prefix}depth_sum"
    scale, offset = scaling_of(file, data)
    anchor = attributes.numbers("anchor", (2,))
    steps = steps_in(file, prefix, data)
    return PSFMatrix(
        data if steps is None else SteppedPlanes(DatasetPlanes(data), *steps),
        depths=_depths(file, prefix, shape[0]),
        camera=Camera.from_json(camera) if camera is not None else None,
        anchor=(0.0, 0.0) if anchor is None else (float(anchor[0]), float(anchor[1])),
        scale=scale,
        offset=offset,
        facts=facts_in(file, prefix, shape, provenance),
        uncertainty=_uncertainty(file, prefix, data),
        depth_sums=depth_sums_of(file, sums, shape) if sums in file else None,
        region=attributes.text("region", ""),
        transposed=attributes.text("matrix", "H") == "HT",
        provenance=provenance,
    )


@dataclass(frozen=True, eq=False)
class MatrixHead:
    """Description of the matrix of the default region of an H file, read without its values.

    Attributes
    ----------
    shape
        ``(nz, ny, nx, nt, ns)``.
    depths
        Depths of the planes ``(nz,)`` (µm); NaN if not stated.
    camera
        The camera of H; None if not stated.
    provenance
        Provenance of the matrix, as plain JSON types.
    transposed
        Whether the matrix is HT.
    """

    shape: tuple[int, int, int, int, int]
    depths: NDArray[np.float64]
    camera: Camera | None
    provenance: dict[str, Any]
    transposed: bool


def head_of(file: H5File) -> MatrixHead:
    """Return the description of the default region's matrix in an H file; only the dataset ``depths`` is read.

    Raises
    ------
    FileFormatError
        If the file is not an H file, is damaged, or has a newer version.
    """
    _check_format(file)
    shape = check_psf_shape(file.dataset_shape("H"))
    attributes = file.attributes()
    _check_conventions(file, attributes)
    camera = attributes.text("camera")
    return MatrixHead(
        shape,
        _depths(file, "", shape[0]),
        None if camera is None else Camera.from_json(camera),
        provenance_of(file),
        attributes.text("matrix", "H") == "HT",
    )


def depth_sums_of(file: H5File, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return the depth-plane sums ``(nz, nt, ns)`` in dataset ``name`` for a matrix of ``shape``.

    Raise `FileFormatError` if they have another shape, are not finite, or are too large.
    """
    most = MAX_SAMPLE * shape[1] * shape[2]
    return file.values(name, (shape[0], *shape[3:]), finite=True, at_most=most).astype(np.float64)


def _depths(file: H5File, prefix: str, planes: int) -> NDArray[np.float64]:
    """Return the depth of each plane (µm), all different; NaN if not stated."""
    if file.attributes(f"{prefix}depths").text("unit") == PLANE_NUMBER:
        return np.full(planes, np.nan)
    depths = file.values(f"{prefix}depths", (planes,), finite=True, at_most=1e15).astype(np.float64)
    if np.unique(depths).size < planes:
        raise FileFormatError.expected(
            f"{file.path}:/{prefix}depths",
            "different depths for all planes",
            "a repeated depth",
            "get the file from its source again",
        )
    return depths


def scaling_of(file: H5File, data: H5Data) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return scale and offset of the stored values ``data``, each with one entry, or one entry per plane.

    Since version 4 of the format, there is one scale, and the offset is 0. Raise `FileFormatError` if a scale is 0, or
    if scaled values could exceed the range of float32.
    """
    given: Iterable[NDArray[np.float64] | None]
    if _check_format(file) >= VERSION:
        given = (data.attributes.numbers("scaling_factor", (1,)), None)
    else:
        given = (data.attributes.numbers(name, (1, data.shape[0])) for name in ("scale", "offset"))
    scale, offset = (np.full(1, default) if v is None else v for v, default in zip(given, (1.0, 0.0), strict=True))
    largest = float(np.iinfo(data.dtype).max) if data.dtype.kind in "iu" else 1.0
    again = "get the file from its source again"
    if not scale.all():
        raise FileFormatError.expected(f"{data.where}, scale", "a number other than 0", "0", again)
    ends = np.abs(scale) * largest + np.abs(offset)
    if (ends > np.finfo(np.float32).max).any():
        raise FileFormatError.expected(
            f"{data.where}, scale and offset",
            "numbers that give finite values",
            f"values up to {ends.max():.3g}",
            again,
        )
    return scale, offset


def steps_in(file: H5File, prefix: str, data: H5Data) -> tuple[NDArray[np.float32], NDArray[np.uint16]] | None:
    """Return step and zero of every pattern, ``(nz, ny, nx)`` each, in a file of version 3; None for other versions.

    A value is ``(stored - zero) * step``. ``data`` is the dataset with the stored values. ``prefix`` is the path of its
    group, followed by a slash; empty for the default region.

    Raises
    ------
    FileFormatError
        If, in a file of version 3, step or zero is missing, or the stored values are not uint16. Also if, in such a
        file, a step is not positive, or values could exceed the range of float32.
    """
    shape = data.shape
    if _check_format(file) != STEPPED_VERSION:
        return None
    where, remedy = f"{file.path}:/{prefix}step", "get the file from its source again"
    if f"{prefix}step" not in file or f"{prefix}zero" not in file or data.dtype != np.uint16:
        raise FileFormatError.expected(where, "steps of uint16 patterns, step and zero", f"{data.dtype} alone", remedy)
    step = file.values(f"{prefix}step", shape[:3], kinds="f", finite=True).astype(np.float32)
    zero = file.values(f"{prefix}zero", shape[:3], kinds="u").astype(np.uint16)
    largest = np.float64(step) * np.maximum(zero, np.iinfo(np.uint16).max - np.int64(zero))
    if not ((step > 0) & (largest <= np.finfo(np.float32).max)).all():
        raise FileFormatError.expected(where, "steps above 0 that give finite values", f"{step.min():g}", remedy)
    return step, zero


def _check_conventions(file: H5File, attributes: Attributes) -> None:
    """Raise `FileFormatError` if the file states conventions that differ from those of lfcal."""
    for key, wanted in (("matrix", ("H", "HT")), ("axes", (",".join(AXES),)), ("centre", (CENTRE_RULE,))):
        found = attributes.text(key, wanted[0])
        if found not in wanted:
            raise FileFormatError.expected(
                f"{file.path}, attribute {key}",
                any_of(wanted),
                repr(found[:60]),
                "get the file from its source again",
            )


def provenance_of(file: H5File, group: str = "") -> dict[str, Any]:
    """Return the provenance of the matrix in ``group`` (empty: that of the default region).

    Raise `FileFormatError` if it is not a JSON object.
    """
    attributes = file.attributes(group)
    what, remedy = f"{file.path}, attribute provenance", "get the file from its source again"
    found = parse_json(attributes.text("provenance", "{}"), what, remedy=remedy, finite=False)
    if not isinstance(found, dict):
        raise FileFormatError.expected(what, "a JSON object", "text that is not JSON", remedy)
    return found


_KINDS = {
    "recorded": "iu",
    "saturated": "iu",
    "noise": "f",
    "spread": "f",
    "valid": "u",
    "error": "f",
    "origin": "u",
    "bound": "f",
}
"""Kinds of numbers of each fact, as numpy's ``dtype.kind``."""


def facts_in(file: H5File, prefix: str, shape: tuple[int, ...], provenance: Mapping[str, Any]) -> Facts:
    """Return the facts that ``file`` states about the positions of a matrix of ``shape`` ``(nz, ny, nx, nt, ns)``.

    ``prefix`` is the path of the matrix's group, followed by a slash; empty for the default region. ``provenance`` is
    the provenance of the matrix.
    """
    names = [entry.name for entry in fields(Facts) if prefix + entry.name in file]
    found = {name: file.values(prefix + name, kinds=_KINDS[name]) for name in names}
    if _check_format(file) == 1 and "saturated" in found and not provenance.get("corrections"):
        # at that time, assembly without corrections did not count saturated pixels, and wrote zeros
        found["saturated"] = np.where(found["saturated"] == 0, -1, found["saturated"].astype(np.int32))
    return Facts.of(shape[:3], (shape[3], shape[4]), **found)


def _uncertainty(file: H5File, prefix: str, data: H5Data) -> Planes | None:
    """Return the stated standard deviations of every entry, read when needed; None if there are none."""
    name = f"{prefix}uncertainty"
    if name not in file:
        return None
    found = file.dataset(name)
    kind = "f" if _check_format(file) >= VERSION else "u"
    if found.shape != data.shape or found.dtype.kind != kind:
        wanted = f"{'numbers' if kind == 'f' else 'integers'} of shape {data.shape}"
        raise FileFormatError.expected(
            found.where, wanted, f"{found.dtype} of shape {found.shape}", "get the file from its source again"
        )
    if kind == "f":
        return DatasetPlanes(found)
    scale, _ = scaling_of(file, found)
    return ScaledPlanes(DatasetPlanes(found), np.broadcast_to(scale, data.shape[0]), np.zeros(data.shape[0]))


def _check_planes(file: H5File, group: str) -> None:
    """Raise `FileFormatError` unless every plane has its stated checksum."""
    prefix = f"{group}/" if group else ""
    if f"{prefix}checksum" not in file:
        raise FileFormatError.expected(
            str(file.path),
            "an H file with checksums",
            "a file of version 1, which has none",
            "save it again with lfcal",
        )
    data = file.dataset(f"{prefix}H")
    sums = file.values(f"{prefix}checksum", data.shape[:1], kinds="u")
    for z, wanted in enumerate(sums.tolist()):
        found = plane_checksum(parallel_read(data, z))
        if found != wanted:
            raise FileFormatError.expected(
                f"{file.path}, plane {z}", f"checksum {wanted:08x}", f"{found:08x}", "copy the file again"
            )
