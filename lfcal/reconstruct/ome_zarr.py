"""Volumes as OME-Zarr: a folder of compressed pieces that viewers open without reading the whole.

Written is version 0.4 of the layout (https://ngff.openmicroscopy.org/0.4/) on zarr format 2, which napari, Fiji
(n5-ij, MoBIE, BigDataViewer) and the web viewers all open; readers of 0.5 (zarr format 3) are fewer: napari's plug-in
needs ome-zarr 0.12 for it, and MoBIE has none. Pieces are packed by zlib, for which no reader needs a library of its
own. Both versions are read.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import (
    MAX_EXPANSION,
    FileFormatError,
    InputError,
    StorageError,
    check_writable,
    replace_store,
    storage_errors,
    storage_words,
)
from lfcal.reconstruct.facts import VolumeFacts

if TYPE_CHECKING:
    from types import ModuleType

__all__ = ["OWN", "VERSION", "check_zarr", "open_ome_zarr", "read_ome_zarr", "told_of", "write_ome_zarr"]

VERSION = "0.4"
"""Of the layout."""

OWN = "lfcal"
"""Attribute of the folder with what the layout has no word for: the depth of every plane, and how it was made."""

LEVEL = "0"
"""Name of the array, the only resolution there is."""

PIECE = 1024
"""Most rows and columns of a piece; a piece is of one plane, as volumes are looked at."""

AXES = (("t", "time"), ("z", "space"), ("y", "space"), ("x", "space"))


def check_zarr() -> ModuleType:
    """Return the library; raises `InputError` where it is not installed."""
    try:
        import zarr
    except ImportError:
        raise InputError("OME-Zarr needs the library zarr; pip install 'lfcal[zarr]'") from None
    found: ModuleType = zarr
    return found


@contextmanager
def write_ome_zarr(
    target: Path, shape: tuple[int, ...], facts: VolumeFacts
) -> Iterator[Callable[[NDArray[np.float32]], None]]:
    """Give a function that adds the next volume of a series to the folder ``target``, which appears when all are there.

    ``shape`` is ``(nz, Y, X)`` or ``(n, nz, Y, X)``; stored is always ``(t, z, y, x)``, a single volume with one time.
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
            # a piece that is not there is lost, not dark
            config={"write_empty_chunks": True},
        )
        group.attrs.update(_attributes(target, facts))
        times = iter(range(whole[0]))

        def add(volume: NDArray[np.float32]) -> None:
            stored[next(times)] = np.ascontiguousarray(volume, "<f4")

        yield add


def _attributes(target: Path, facts: VolumeFacts) -> dict[str, Any]:
    """Return what the folder says of its array: axes, sizes in micrometres, and lfcal's own words."""
    scale, start = [1.0, 1.0, 1.0, 1.0], [0.0, 0.0, 0.0, 0.0]
    known: set[str] = set()
    depths = None if facts.depths_um is None else np.asarray(facts.depths_um, np.float64)
    if depths is not None and len(depths) > 1:
        # one size for all: the mean where planes are uneven, whose own places stand in lfcal's words
        scale[1] = float(np.abs(np.diff(depths)).mean()) or 1.0
    if depths is not None and len(depths):
        known.add("z")
        # readers count upwards: planes from far to near have no start that would be true of them
        start[1] = float(depths[0]) if (np.diff(depths) > 0).all() else 0.0
    if facts.voxel_um is not None:
        known |= {"y", "x"}
        scale[2:] = map(float, facts.voxel_um)
        start[2:] = map(float, facts.origin_um or (0.0, 0.0))
    if facts.times_s is not None and len(facts.times_s) > 1:
        known.add("t")
        scale[0] = float(np.diff(facts.times_s).mean())
    units = {"t": "second", "z": "micrometer", "y": "micrometer", "x": "micrometer"}
    axes = [{"name": name, "type": kind} | ({"unit": units[name]} if name in known else {}) for name, kind in AXES]
    placed: list[dict[str, Any]] = [{"type": "scale", "scale": scale}]
    if any(start):
        placed.append({"type": "translation", "translation": start})
    name = target.name.removesuffix(".zarr").removesuffix(".ome")
    own: dict[str, Any] = {"version": 1, "details": json.loads(json.dumps(facts.details))}
    if depths is not None:
        own["depths_um"] = depths.tolist()
    if facts.times_s is not None:
        own["times_s"] = list(facts.times_s)
    image = {
        "version": VERSION,
        "name": name,
        "axes": axes,
        "datasets": [{"path": LEVEL, "coordinateTransformations": placed}],
    }
    return {"multiscales": [image], OWN: own}


@contextmanager
def _understood(source: Path, wanted: str, remedy: str) -> Iterator[None]:
    """Tell what the disk refuses as `StorageError`, whatever else is raised as `FileFormatError`."""
    try:
        yield
    except Exception as error:  # zarr and its codecs raise many kinds on folders that are something else
        if isinstance(error, OSError) and error.errno is not None:
            raise StorageError(storage_words(error, source)) from error
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise FileFormatError.expected(str(source), wanted, reason, remedy) from error


def told_of(source: Path) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Return the array of the finest resolution (nothing of it is read), the image's words, and lfcal's own.

    Raises
    ------
    FileFormatError, StorageError, InputError
        If it is no OME-Zarr, cannot be read, or the library is not installed.
    """
    zarr = check_zarr()
    with storage_errors(source):
        if not source.exists():
            raise StorageError(f"{source}: no such file or folder; check the path")
    with _understood(source, "an OME-Zarr image", "choose another one"):
        group = zarr.open_group(source, mode="r")
        said = dict(group.attrs)
        image = dict(said.get("ome", said)["multiscales"][0])
        array = group[str(image["datasets"][0]["path"])]
        shape, _ = tuple(array.shape), np.dtype(array.dtype)
    names = [str(axis.get("name")) if isinstance(axis, Mapping) else str(axis) for axis in image.get("axes", ())]
    if names and len(names) != len(shape):
        raise FileFormatError.expected(str(source), f"{len(shape)} axes", len(names), "copy it again")
    own = said.get(OWN)
    return array, image, dict(own) if isinstance(own, Mapping) else {}


def open_ome_zarr(source: Path) -> tuple[Any, dict[str, Any], dict[str, Any]]:
    """Return array, image's words and lfcal's own as `told_of`, where the pieces may hold what the array says it has.

    Raises
    ------
    FileFormatError
        If the array is larger than its pieces can be: it would be empty room.
    """
    array, image, own = told_of(source)
    nbytes = math.prod(array.shape) * np.dtype(array.dtype).itemsize
    with storage_errors(source):
        held = sum(path.stat().st_size for path in source.rglob("*") if path.is_file())
    if nbytes > MAX_EXPANSION * held:
        raise FileFormatError.expected(
            str(source), f"pieces of {nbytes} bytes", f"{held} bytes on disk", "copy it again"
        )
    return array, image, own


def read_ome_zarr(source: Path) -> NDArray[np.float32]:
    """Return the volume of an OME-Zarr; leading axes of one (time, channel) are left out.

    Raises
    ------
    FileFormatError, StorageError, InputError
        As `open_ome_zarr`, and if a piece is damaged or there are several times.
    """
    array = open_ome_zarr(source)[0]
    if math.prod(array.shape[:-3]) != 1:
        raise InputError.expected(str(source), "a volume (z, y, x)", array.shape, "choose another file")
    with _understood(source, "intact pieces", "copy it again"):
        data = np.asarray(array[...], np.float32)
    return data.reshape(data.shape[-3:])
