"""Atomic writing and reading of reconstructed volumes: TIFF stacks, HDF5, OME-Zarr.

OME-Zarr is written in version 0.4 of the layout (https://ngff.openmicroscopy.org/0.4/) on zarr format 2, which napari,
Fiji (n5-ij, MoBIE, BigDataViewer) and the web viewers open. Fewer programs read version 0.5 (zarr format 3): napari's
plug-in needs ome-zarr 0.12 for it, and MoBIE does not support it. Chunks are compressed with zlib, for which no reader
needs an additional library. Both versions can be read.

TIFF and OME-Zarr readers know one spacing of the planes, and assume increasing depths. These files therefore contain
the planes from the smallest depth to the largest, and `load_volume` returns them in their original order.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, BinaryIO
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import (
    FileFormatError,
    InputError,
    any_of,
    check_stored,
    check_writable,
    check_zarr,
    map_npy,
    npy_header,
    ome_images,
    read_tiff,
    replace_store,
    replace_whole,
    require_space,
    storage_errors,
    understood,
)
from lfcal.base.h5 import H5File, new_h5

__all__ = [
    "DATASET",
    "SUFFIXES",
    "VOLUME_FORMAT",
    "VolumeFacts",
    "check_suffix",
    "load_labels",
    "load_volume",
    "open_ome_zarr",
    "save_volume",
    "volume_facts",
    "write_volumes",
    "zarr_contents",
]


@dataclass(frozen=True, slots=True)
class VolumeFacts:
    """Metadata of the volumes in a file.

    Attributes
    ----------
    depths_um
        Depth of each plane (µm), ``(nz,)``. None: unknown.
    voxel_um
        Voxel size (y, x) in object space (µm). None: unknown.
    details
        Further metadata to store, by name, as plain JSON types.
    origin_um
        Position (y, x) of the centre of the first voxel relative to the optical axis (µm). None: unknown.
    times_s
        Time of each volume of a series (s), ``(n,)``. None: unknown.
    """

    depths_um: NDArray[np.float64] | None = None
    voxel_um: tuple[float, float] | None = None
    details: dict[str, Any] = field(default_factory=dict)
    origin_um: tuple[float, float] | None = None
    times_s: Sequence[float] | None = None


VERSION = "0.4"
"""Version of the OME-Zarr layout."""

LFCAL_KEY = "lfcal"
"""Attribute of the folder for metadata outside the layout, such as the depth of every plane and the details."""

MOST_LABELS = 1 << 24
"""Largest label of a region: the largest integer up to which float32 represents all."""

STORED = "stored_planes"
"""Entry of the details: index in the volume of each plane of the file. Without it, both have the same order."""

KNOWN = ("depths_um", "voxel_um", "origin_um", "times_s")
"""Fields of `VolumeFacts`, by their names in the metadata of lfcal."""

LEVEL = "0"
"""Name of the array; there is only one resolution."""

PIECE = 1024
"""Largest number of rows and columns of a chunk; a chunk has one plane, the unit of display."""

AXES = (("t", "time"), ("z", "space"), ("y", "space"), ("x", "space"))


@contextmanager
def write_ome_zarr(
    target: Path, shape: tuple[int, ...], facts: VolumeFacts
) -> Iterator[Callable[[NDArray[np.float32]], None]]:
    """Yield a function that appends a volume ``(nz, Y, X)`` to the OME-Zarr folder ``target``.

    The folder appears when the block ends without error. ``shape`` is ``(nz, Y, X)`` or ``(n, nz, Y, X)``; the stored
    axes are always ``(t, z, y, x)``, with a single time in the first case. ``facts`` is the metadata to store.
    """
    zarr = check_zarr()
    check_writable(target)
    import numcodecs

    whole = (1, *shape) if len(shape) == 3 else shape
    with replace_store(target) as part:
        group = zarr.open_group(part, mode="w", zarr_format=2)
        stored = group.create_array(
            LEVEL,
            shape=whole,
            chunks=(1, 1, min(PIECE, whole[2]), min(PIECE, whole[3])),
            dtype="<f4",
            compressors=numcodecs.Zlib(1),
            fill_value=0.0,
            chunk_key_encoding={"name": "v2", "separator": "/"},
            # a missing chunk is lost, not dark
            config={"write_empty_chunks": True},
        )
        group.attrs.update(_attributes(target, facts))
        times = iter(range(whole[0]))

        def add(volume: NDArray[np.float32]) -> None:
            stored[next(times)] = np.ascontiguousarray(volume, "<f4")

        yield add


def _attributes(target: Path, facts: VolumeFacts) -> dict[str, Any]:
    """Return the metadata of the folder's array: axes, sizes in micrometres, and entries of lfcal."""
    scale, start = [1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]
    known: set[str] = set()
    if facts.depths_um is not None:
        known.add("z")
        # one spacing for all: the mean if planes are uneven; lfcal's attributes contain the depths
        scale[1], start[1] = _step(facts.depths_um), float(facts.depths_um[0])
    if facts.voxel_um is not None:
        known |= {"y", "x"}
        scale[2:] = map(float, facts.voxel_um)
        start[2:] = map(float, facts.origin_um or (0.0, 0.0))
    if facts.times_s is not None:
        known.add("t")
        scale[0], start[0] = _step(facts.times_s), float(facts.times_s[0])
    units = {"t": "second", "z": "micrometer", "y": "micrometer", "x": "micrometer"}
    axes = [{"name": name, "type": kind} | ({"unit": units[name]} if name in known else {}) for name, kind in AXES]
    placed: list[dict[str, Any]] = [{"type": "scale", "scale": scale}]
    if any(start):
        placed.append({"type": "translation", "translation": start})
    name = target.name.removesuffix(".zarr").removesuffix(".ome")
    own = {"version": 1, "details": json.loads(json.dumps(facts.details)), **_known(facts)}
    image = {
        "version": VERSION,
        "name": name,
        "axes": axes,
        "datasets": [{"path": LEVEL, "coordinateTransformations": placed}],
    }
    return {"multiscales": [image], LFCAL_KEY: own}


def _step(values: ArrayLike) -> float:
    """Return the mean distance between successive values; 1 if there is none."""
    steps = np.diff(np.asarray(values, np.float64))
    return (float(np.abs(steps).mean()) if len(steps) else 0.0) or 1.0


def _known(facts: VolumeFacts) -> dict[str, Any]:
    """Return the known depths, sizes, origin and times as JSON types."""
    values = {name: getattr(facts, name) for name in KNOWN}
    return {name: np.asarray(value, np.float64).tolist() for name, value in values.items() if value is not None}


def _facts(own: Mapping[str, Any], details: Mapping[str, Any]) -> VolumeFacts:
    """Return the `VolumeFacts` from the results of `_said`, with the depths in the order of the volume."""
    depths, voxel, origin, times = (None if own.get(name) is None else np.asarray(own[name], float) for name in KNOWN)
    rest = dict(details)
    if depths is not None and (stored := rest.pop(STORED, None)) is not None:
        depths = depths[_original(stored, len(depths))]

    def pair(values: NDArray[np.float64] | None) -> tuple[float, float] | None:
        if values is None:
            return None
        row, column = np.broadcast_to(values, 2).tolist()  # one number: both are equal
        return row, column

    return VolumeFacts(depths, pair(voxel), rest, pair(origin), None if times is None else times.tolist())


def _original(stored: Any, planes: int) -> NDArray[np.intp]:
    """Return the index in the file of each plane of the volume."""
    order = np.asarray(stored)
    if order.shape != (planes,) or order.dtype.kind != "i" or (np.sort(order) != np.arange(planes)).any():
        raise ValueError(f"{STORED}, which is no order of {planes} planes")
    return np.argsort(order)


def zarr_contents(source: Path) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Open an OME-Zarr; return its full-resolution array, the metadata of the image, and the metadata of lfcal.

    The values of the array are not read. The metadata of lfcal are empty if there are none.

    Raises
    ------
    FileFormatError, StorageError, InputError
        If the folder is not an OME-Zarr or cannot be read, or the library zarr is not installed.
    """
    images, said = ome_images(source)
    array, image = images[0]
    if not image:
        raise FileFormatError.expected(str(source), "an OME-Zarr image", "a plain array", "choose another one")
    own = said.get(LFCAL_KEY)
    return array, image, dict(own) if isinstance(own, Mapping) else {}


def open_ome_zarr(source: Path) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Return the result of `zarr_contents`, after checking that the files can contain an array of the declared size.

    Raises
    ------
    FileFormatError, StorageError, InputError
        As in `zarr_contents`; also if the declared size is larger than the files can contain.
    """
    array, image, own = zarr_contents(source)
    check_stored(source, [array])
    return array, image, own


def read_ome_zarr(source: Path) -> NDArray[np.float32]:
    """Return the volume of an OME-Zarr; leading axes of size one (time, channel) are removed.

    Raises
    ------
    FileFormatError, StorageError, InputError
        As in `open_ome_zarr`; also if a chunk is damaged or there are several volumes.
    """
    array = open_ome_zarr(source)[0]
    if math.prod(array.shape[:-3]) != 1:
        raise InputError.expected(str(source), "a volume (z, y, x)", f"shape {array.shape}", "choose another file")
    with understood(source, "intact chunks", "copy it again"):
        data = np.asarray(array[...], np.float32)
    return data.reshape(data.shape[-3:])


SUFFIXES = (".tif", ".tiff", ".h5", ".hdf5", ".npy", ".zarr")
"""File types of volumes."""

IMAGEJ_BYTES = 3 << 30
"""Size (bytes) up to which a TIFF has the format of ImageJ, and 32-bit offsets; both are limited to 4 GB."""

DATASET = "volume"
"""Name of the volumes in an HDF5 file."""

VOLUME_FORMAT = "lfcal-volume"
"""Value of the file's format attribute."""


def check_suffix(path: str | os.PathLike[str]) -> Path:
    """Return ``path`` after checking that its suffix is that of a volume file.

    Raises
    ------
    InputError
        If the suffix is not in `SUFFIXES`.
    """
    target = Path(path)
    if target.suffix.lower() not in SUFFIXES:
        raise InputError.expected(
            "volume file", any_of(SUFFIXES), target.name, "end the name of the file with one of these"
        )
    return target


def save_volume(
    path: str | os.PathLike[str],
    volume: ArrayLike,
    *,
    depths_um: ArrayLike | None = None,
    voxel_um: float | tuple[float, float] | None = None,
    origin_um: tuple[float, float] | None = None,
    details: Mapping[str, Any] | None = None,
) -> None:
    """Write a volume as float32; the suffix of ``path`` selects the format.

    Parameters
    ----------
    path
        File to write: ``.tif`` (a stack for ImageJ), ``.ome.tif`` (OME-TIFF, with the depth of each plane),
        ``.ome.zarr`` (an OME-Zarr folder; requires the library zarr), ``.h5`` (dataset ``volume``, axes z, y, x, with
        ``depths``), or ``.npy`` (values only). TIFF and OME-Zarr files contain the planes in the order of increasing
        depth, if the depths are known.
    volume
        Volume ``(nz, Y, X)``.
    depths_um
        Depth of each plane (µm), ``(nz,)``. None: unknown.
    voxel_um
        Lateral voxel size in object space (µm): one number, or (y, x). None: unknown.
    origin_um
        Position (y, x) of the centre of the first voxel relative to the optical axis (µm). None: unknown.
    details
        Further metadata to store, by name, as plain JSON types.

    Raises
    ------
    InputError, StorageError
        If the suffix is unknown, or the file cannot be written; no incomplete file remains.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import load_volume, save_volume
    >>> volume = np.zeros((3, 20, 30))
    >>> volume[1, 5, 7] = 4.0
    >>> save_volume("bead.tif", volume, depths_um=[-10, 0, 10], voxel_um=1.4)
    >>> bead = load_volume("bead.tif")
    >>> print(bead.shape, bead.dtype, bead[1, 5, 7])
    (3, 20, 30) float32 4.0
    """
    data = np.ascontiguousarray(volume, np.float32)
    if data.ndim != 3:
        raise InputError.expected("volume", "three axes (z, y, x)", f"shape {data.shape}", "add the missing axis")
    depths = None if depths_um is None else np.asarray(depths_um, np.float64)
    sides = (voxel_um, voxel_um) if isinstance(voxel_um, int | float) else voxel_um
    facts = VolumeFacts(depths, sides, dict(details or {}), origin_um)
    with write_volumes(path, data.shape, facts) as add:
        add(data)


@contextmanager
def write_volumes(
    path: str | os.PathLike[str], shape: tuple[int, ...], facts: VolumeFacts
) -> Iterator[Callable[[NDArray[np.float32]], None]]:
    """Yield a function that appends a volume ``(nz, Y, X)`` to a file, which appears when the block ends without error.

    Parameters
    ----------
    path
        As in `save_volume`.
    shape
        Shape ``(nz, Y, X)`` of a single volume, or ``(n, nz, Y, X)`` of a time series with the axes TZYX, which ImageJ
        opens as a hyperstack.
    facts
        Metadata of the volumes to store in the file.

    Raises
    ------
    InputError, StorageError
        If the suffix, the number of depths or times, or the shape or the number of the volumes is wrong, or the file
        cannot be written; no incomplete file remains.
    """
    target = check_suffix(path)
    series = shape[0] if len(shape) > 3 else 1
    for what, values, count in (("depths", facts.depths_um, shape[-3]), ("times", facts.times_s, series)):
        if values is not None and len(values) != count:
            each = "plane" if what == "depths" else "volume of the series"
            raise InputError.expected(f"{what} of the volume", count, len(values), f"state one for each {each}")
    require_space(target.parent, 4 * math.prod(shape) + (1 << 16), what="the volume")
    kind = target.suffix.lower()
    usual = _ome_tiff if is_ome(target) else _tiff
    own = {".npy": _npy, ".h5": _h5, ".hdf5": _h5, ".zarr": write_ome_zarr}
    depths, order = facts.depths_um, None
    if depths is not None and (np.diff(depths) < 0).any() and kind not in (".npy", ".h5", ".hdf5"):
        order = np.argsort(depths, kind="stable")
        facts = replace(facts, depths_um=depths[order], details={**facts.details, STORED: order.tolist()})
    with own.get(kind, usual)(target, shape, facts) as add:
        counted = _CountedVolumes(add, shape, order)
        yield counted
        counted.check_complete()


@dataclass
class _CountedVolumes:
    """Function that passes volumes to ``add`` if they have the ``shape`` stated in the file.

    ``order`` contains the index in the volume of each plane of the file. None: the order is the same.
    """

    add: Callable[[NDArray[np.float32]], None]
    shape: tuple[int, ...]
    order: NDArray[np.intp] | None
    count: int = 0

    def __call__(self, volume: NDArray[np.float32]) -> None:
        wanted = self.shape[-3:]
        if volume.shape != wanted:
            remedy = "write volumes of another shape to a separate file"
            raise InputError.expected("volume", f"shape {wanted}", f"shape {volume.shape}", remedy)
        self.add(volume if self.order is None else volume[self.order])
        self.count += 1

    def check_complete(self) -> None:
        """Raise `InputError` unless the file contains as many volumes as it states."""
        wanted = self.shape[0] if len(self.shape) > 3 else 1
        if self.count != wanted:
            raise InputError.expected("volumes of the file", wanted, self.count, "write all volumes of the series")


@contextmanager
def _npy(target: Path, shape: tuple[int, ...], _: VolumeFacts) -> Iterator[Callable[[NDArray[np.float32]], None]]:
    with replace_whole(target) as part, part.open("wb") as file:
        file.write(npy_header(shape, np.dtype("<f4")))
        yield lambda volume: _append(file, volume)


def _append(file: BinaryIO, volume: NDArray[np.float32]) -> None:
    file.write(np.ascontiguousarray(volume, "<f4").data)


@contextmanager
def _tiff(target: Path, shape: tuple[int, ...], facts: VolumeFacts) -> Iterator[Callable[[NDArray[np.float32]], None]]:
    import tifffile

    # ImageJ knows one spacing of planes and frames, so the depths and times are stated separately
    own = json.dumps({**facts.details, **_known(facts)})
    metadata: dict[str, Any] = {"axes": "TZYX"[-len(shape) :], "unit": "um", "lfcal": own}
    if facts.depths_um is not None:
        metadata["spacing"] = step = _step(facts.depths_um)
        # ImageJ counts its origin in voxels, from the first one
        metadata["zorigin"] = -float(facts.depths_um[0]) / step
    if facts.times_s is not None and len(facts.times_s) > 1:
        metadata |= {"finterval": _step(facts.times_s), "tunit": "s"}
    # TIFF has x first
    resolution = None if facts.voxel_um is None else (1 / facts.voxel_um[1], 1 / facts.voxel_um[0])
    if facts.voxel_um is not None and facts.origin_um is not None:
        pairs = zip("yx", facts.origin_um, facts.voxel_um, strict=True)
        metadata |= {f"{axis}origin": -start / side for axis, start, side in pairs}
    big = 4 * math.prod(shape) > IMAGEJ_BYTES
    with replace_whole(target) as part, part.open("r+b") as file:
        # allocated first and filled in order, so that a time series is never in memory as a whole
        place = tifffile.imwrite(
            file,
            shape=shape,
            dtype="<f4",
            byteorder="<",
            imagej=not big,
            bigtiff=big,
            metadata=metadata,
            resolution=resolution,
            photometric="minisblack",
            returnoffset=True,
        )
        assert place is not None  # because the samples are contiguous
        file.seek(place[0])
        yield lambda volume: _append(file, volume)


def is_ome(path: Path) -> bool:
    """Return whether the name of a file is that of an OME-TIFF."""
    return path.name.lower().endswith((".ome.tif", ".ome.tiff"))


@contextmanager
def _ome_tiff(
    target: Path, shape: tuple[int, ...], facts: VolumeFacts
) -> Iterator[Callable[[NDArray[np.float32]], None]]:
    """Write the metadata that OME readers need: sizes in µm, and position and time of every plane.

    `PositionX` and `PositionY` are those of the centre of the first voxel.
    """
    import tifffile

    metadata: dict[str, Any] = {"axes": "TZYX"[-len(shape) :], "MapAnnotation": {"lfcal": json.dumps(facts.details)}}
    if facts.voxel_um is not None:
        for axis, side in zip("YX", facts.voxel_um, strict=True):
            metadata |= {f"PhysicalSize{axis}": side, f"PhysicalSize{axis}Unit": "µm"}
    series = math.prod(shape) // math.prod(shape[-3:])
    if facts.depths_um is not None and len(facts.depths_um) > 1:
        # one spacing for all: the mean if planes are uneven; the depths are stated separately
        metadata |= {"PhysicalSizeZ": _step(facts.depths_um), "PhysicalSizeZUnit": "µm"}
    if facts.times_s is not None and len(facts.times_s) > 1:
        metadata |= {"TimeIncrement": _step(facts.times_s), "TimeIncrementUnit": "s"}
    if planes := _ome_planes(facts, series, shape[-3]):
        metadata["Plane"] = planes
    big = 4 * math.prod(shape) > IMAGEJ_BYTES
    with replace_whole(target) as part, part.open("r+b") as file:
        place = tifffile.imwrite(
            file,
            shape=shape,
            dtype="<f4",
            byteorder="<",
            ome=True,
            bigtiff=big,
            metadata=metadata,
            photometric="minisblack",
            returnoffset=True,
        )
        assert place is not None  # because the samples are contiguous
        file.seek(place[0])
        yield lambda volume: _append(file, volume)


def _ome_planes(facts: VolumeFacts, series: int, planes: int) -> dict[str, Any]:
    """Return the attributes of all planes, by time and then by depth."""
    said: dict[str, list[float]] = {}
    if facts.depths_um is not None:
        said["PositionZ"] = [float(z) for z in facts.depths_um] * series
    if facts.origin_um is not None:
        said |= {f"Position{axis}": [at] * (series * planes) for axis, at in zip("YX", facts.origin_um, strict=True)}
    if facts.times_s is not None:
        said["DeltaT"] = [float(t) for t in facts.times_s for _ in range(planes)]
    units = {f"{name}Unit": ["s" if name == "DeltaT" else "µm"] * len(values) for name, values in said.items()}
    return {**said, **units}


@contextmanager
def _h5(target: Path, shape: tuple[int, ...], facts: VolumeFacts) -> Iterator[Callable[[NDArray[np.float32]], None]]:
    with new_h5(target) as file:
        stored = file.create_dataset(
            DATASET,
            shape,
            "f4",
            # one plane per chunk, the unit of display
            chunks=(1,) * (len(shape) - 2) + shape[-2:],
            compression="gzip",
            compression_opts=1,
            shuffle=True,
            fletcher32=True,
        )
        stored.attrs["axes"] = ", ".join("tzyx"[-len(shape) :])
        file.attrs["format"] = VOLUME_FORMAT
        file.attrs["version"] = 1
        file.attrs["details"] = json.dumps(facts.details)
        if facts.depths_um is not None:
            file.create_dataset("depths", data=facts.depths_um).attrs["unit"] = "um"
        if facts.voxel_um is not None:
            file.attrs["voxel_um"] = facts.voxel_um
        if facts.origin_um is not None:
            file.attrs["origin_um"] = facts.origin_um
        if facts.times_s is not None:
            file.create_dataset("times", data=np.asarray(facts.times_s, np.float64)).attrs["unit"] = "s"
        _mark_plot(file, shape, facts)
        places = iter([...] if len(shape) == 3 else range(shape[0]))

        def add(volume: NDArray[np.float32]) -> None:
            stored[next(places)] = volume

        yield add


def _mark_plot(file: Any, shape: tuple[int, ...], facts: VolumeFacts) -> None:
    """Make the volumes the default plot of NeXus viewers, with axes in µm and s where they are known."""
    file.attrs.update({"NX_class": "NXroot", "default": "entry"})
    entry = file.create_group("entry")
    entry.attrs.update({"NX_class": "NXentry", "default": "data"})
    data = entry.create_group("data")
    data[DATASET] = file[DATASET]
    names = ("times", "depths", "y", "x")[-len(shape) :]
    starts = facts.origin_um or (0.0, 0.0)
    for k, name in enumerate(names):
        unit = "s" if name == "times" else "um"
        if name in file:  # a hard link, because soft links are refused when the file is opened
            data[name] = file[name]
        elif name in "yx" and facts.voxel_um is not None:
            data[name] = starts["yx".index(name)] + facts.voxel_um["yx".index(name)] * np.arange(shape[k])
        else:
            data[name], unit = np.arange(shape[k]), ""
        data[name].attrs.update({"units": unit, "long_name": f"{name} ({unit})" if unit else name})
    data.attrs.update({"NX_class": "NXdata", "signal": DATASET, "axes": list(names)})
    data.attrs.update({f"{name}_indices": np.int32(k) for k, name in enumerate(names)})


def load_volume(path: str | os.PathLike[str]) -> NDArray[np.float32]:
    """Read the volume ``(nz, Y, X)`` from a file that `save_volume` wrote, or from a stack of the same format.

    A single image becomes a volume of one plane.

    Raises
    ------
    InputError
        If the suffix is not that of a volume file, or the file contains several volumes.
    FileFormatError, StorageError
        If the file is damaged or cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.reconstruct import load_volume, save_volume
    >>> save_volume("planes.npy", np.arange(24).reshape(2, 3, 4))
    >>> print(load_volume("planes.npy").mean(axis=(1, 2)).tolist())
    [5.5, 17.5]
    """
    source = check_suffix(path)
    if source.suffix.lower() in (".h5", ".hdf5"):
        with H5File(source) as file:
            data = file.dataset(DATASET).read()
    elif source.suffix.lower() == ".npy":
        data = map_npy(source)
    elif source.suffix.lower() == ".zarr":
        data = read_ome_zarr(source)
    else:
        data = read_tiff(source)
    volume = np.asarray(data, np.float32)
    if volume.ndim == 2:
        volume = volume[None]
    if volume.ndim != 3:
        raise InputError.expected(str(source), "a volume (z, y, x)", f"shape {volume.shape}", "choose another file")
    with understood(source, "metadata of a volume", "copy the file again"):
        stored = _stored(source)
        return volume if stored is None else volume[_original(stored, len(volume))]


def load_labels(path: str | os.PathLike[str], depths_um: NDArray[np.float64] | None) -> NDArray[np.float32]:
    """Read labels ``(nz, Y, X)`` that were drawn on a volume with planes at ``depths_um`` (µm; None: unknown).

    A stack that another program wrote as TIFF or OME-Zarr has its planes in ascending order of depth, like the volume
    on which it was drawn. The planes are returned in the order of ``depths_um``.

    Raises
    ------
    InputError
        If a label is larger than `MOST_LABELS`.
    InputError, FileFormatError, StorageError
        As in `load_volume`.
    """
    source, found = Path(path), load_volume(path)
    if float(np.max(found, initial=0)) > MOST_LABELS:
        got = f"{float(found.max()):.10g}"
        raise InputError.expected(
            f"labels in {source}", f"numbers up to {MOST_LABELS}", got, "number the regions from 1"
        )
    drawn = source.suffix.lower() in (".tif", ".tiff", ".zarr") and _stored(source) is None
    if drawn and depths_um is not None and len(found) == len(depths_um):
        return found[np.argsort(np.argsort(depths_um, kind="stable"))]
    return found


def _stored(source: Path) -> Any:
    """Return the entry `STORED` of a file; None: the file has the planes in their original order."""
    if source.suffix.lower() == ".zarr":
        return zarr_contents(source)[2].get("details", {}).get(STORED)
    if source.suffix.lower() not in (".tif", ".tiff"):
        return None
    import tifffile

    with storage_errors(source), tifffile.TiffFile(source) as tiff:
        # other programs' metadata, which may be damaged, say nothing of the order
        if STORED not in tiff.pages[0].description:
            return None
    return _said(source)[1].get(STORED)


def volume_facts(path: str | os.PathLike[str]) -> VolumeFacts:
    """Return the metadata of a file that `load_volume` can read; values that are not stated are None.

    Raises
    ------
    InputError
        If the suffix is not that of a volume file.
    FileFormatError, StorageError
        If the file cannot be read, or its metadata are damaged.
    """
    source = check_suffix(path)
    with understood(source, "metadata of a volume", "copy the file again"):
        return _facts(*_said(source))


Said = tuple[dict[str, Any], dict[str, Any]]
"""Values that a file states for `KNOWN`, with planes in the order of the file, and its details."""


def _said(source: Path) -> Said:
    kind = source.suffix.lower()
    if kind in (".h5", ".hdf5"):
        return _said_h5(source)
    if kind == ".npy":
        return {}, {}
    if kind == ".zarr":
        _, image, own = open_ome_zarr(source)
        return _zarr_said(image) | {name: own[name] for name in KNOWN if name in own}, dict(own.get("details", {}))
    import tifffile

    with storage_errors(source), tifffile.TiffFile(source) as tiff:
        if is_ome(source) and tiff.ome_metadata:
            return _ome_said(tiff.ome_metadata)
        tags = tiff.pages[0].tags
        resolution = [tags[name].value if name in tags else (1, 1) for name in ("YResolution", "XResolution")]
        return _imagej_said(tiff.imagej_metadata or (tiff.shaped_metadata or ({},))[0], resolution)


def _said_h5(source: Path) -> Said:
    with H5File(source) as file:
        planes = file.dataset(DATASET).shape[-3]
        attributes = file.attributes()
        own = {name: attributes.numbers(name, (2,)) for name in ("voxel_um", "origin_um")}
        own["depths_um"] = file.values("depths", (planes,), finite=True) if "depths" in file else None
        own["times_s"] = file.values("times", finite=True) if "times" in file else None
        return own, json.loads(attributes.text("details", "{}"))


def _zarr_said(image: Mapping[str, Any]) -> dict[str, Any]:
    placed = {one.get("type"): one for one in image["datasets"][0].get("coordinateTransformations", ())}
    known = {axis.get("name") for axis in image.get("axes", ()) if axis.get("unit") == "micrometer"}
    scale = placed.get("scale", {}).get("scale")
    return {"voxel_um": scale[-2:]} if scale and {"y", "x"} <= known else {}


def _ome_said(words: str) -> Said:
    root = ElementTree.fromstring(words)
    pixels = root.find("{*}Image/{*}Pixels")
    if pixels is None:
        return {}, {}
    # of several channels, the first
    planes = [plane for plane in pixels.findall("{*}Plane") if plane.get("TheC", "0") == "0"]
    at = {(int(plane.get("TheT", "0")), int(plane.get("TheZ", "0"))): plane for plane in planes}

    def of_planes(where: Iterable[tuple[int, int]], *names: str) -> list[list[float]] | None:
        """Return attributes of the planes (t, z); None if any of them is not stated."""
        rows = [[at[place].get(name, "") if place in at else "" for name in names] for place in where]
        return [list(map(float, row)) for row in rows] if all(map(all, rows)) else None

    nz, nt = (int(pixels.get(f"Size{axis}", "1")) for axis in "ZT")
    depths = of_planes(((0, z) for z in range(nz)), "PositionZ")
    times = of_planes(((t, 0) for t in range(nt)), "DeltaT")
    origin = of_planes([(0, 0)], "PositionY", "PositionX")
    sides = [pixels.get(f"PhysicalSize{axis}", "") for axis in "YX"]
    note = next((one.text for one in root.iter() if one.tag.endswith("}M") and one.get("K") == "lfcal"), None)
    return {
        "depths_um": None if depths is None else [z for (z,) in depths],
        "voxel_um": list(map(float, sides)) if all(sides) else None,
        "origin_um": None if origin is None else origin[0],
        "times_s": None if times is None else [t for (t,) in times],
    }, json.loads(note or "{}")


def _imagej_said(said: Mapping[str, Any], resolution: Sequence[tuple[int, int]]) -> Said:
    own = json.loads(said.get("lfcal", "{}"))
    details = {name: value for name, value in own.items() if name not in KNOWN}
    # a file without a voxel size also has a resolution of 1
    if said.get("unit") == "um" and all(n and n != d for n, d in resolution):
        own = {"voxel_um": [d / n for n, d in resolution]} | own
    return own, details
