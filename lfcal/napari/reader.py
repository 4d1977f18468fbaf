"""napari reader: H, HT, recorded sessions and volumes as layers, loaded lazily, with sizes, units and axes."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire import NAME, RecordingSource
from lfcal.base import FileFormatError, LfcalError
from lfcal.base.h5 import H5File
from lfcal.napari._lazy import Index, Lazy
from lfcal.psf import FORMAT, open_psf, pixel_um, regions_of, voxel_um
from lfcal.reconstruct import DATASET, VOLUME_FORMAT, open_ome_zarr, zarr_contents

if TYPE_CHECKING:
    from lfcal.psf import PSFMatrix

__all__ = ["Layer", "get_reader", "read_layers"]

Layer = tuple[Any, dict[str, Any], str]
"""Data, keyword arguments and type of a napari layer."""

H_AXES = ("z", "y", "x", "t", "s")
MICROMETRE, PIXEL, SECOND = "micrometer", "pixel", "second"

Read = Callable[[Index], Any]


def get_reader(path: str | Sequence[str]) -> Callable[[str | Sequence[str]], list[Layer]] | None:
    """Return the reader for ``path``, or None if it is not a single file or session of lfcal; napari calls this.

    Parameters
    ----------
    path
        A file or folder, or a list that contains one.
    """
    paths = [path] if isinstance(path, str) else list(path)
    if len(paths) != 1:
        return None
    try:
        known = _kind_of(Path(paths[0])) is not None
    except LfcalError:
        return None
    return _read if known else None


def _read(path: str | Sequence[str]) -> list[Layer]:
    return read_layers(path if isinstance(path, str) else path[0])


def read_layers(path: str | Path) -> list[Layer]:
    """Return the napari layers of an H or HT file, a session, or a volume; values are loaded when displayed.

    Planes are in the order of increasing depth; the metadata ``planes`` of a layer lists their indices in the file. For
    an H file, a hidden layer with HT is added. A file with several regions of the field has these layers for each of
    them.

    Raises
    ------
    FileFormatError
        If ``path`` is not an lfcal file.
    LfcalError
        If the file is damaged or cannot be read.
    """
    source = Path(path)
    read = _kind_of(source)
    if read is None:
        raise FileFormatError.expected(
            str(source),
            "H, HT, a recorded session or a volume of lfcal",
            "a file of another kind",
            "open it with another reader",
        )
    return read(source)


def _kind_of(source: Path) -> Callable[[Path], list[Layer]] | None:
    """Return the function that reads a file or folder; None if it is not from lfcal."""
    if source.name == NAME and source.is_file():
        return lambda path: _session(path.parent)
    if (source / NAME).is_file():
        return _session
    if source.suffix.lower() == ".zarr":
        return _ome_zarr if zarr_contents(source)[2] else None
    if source.suffix.lower() in (".h5", ".hdf5") and source.is_file():
        with H5File(source) as file:
            return {FORMAT: _matrices, VOLUME_FORMAT: _volume}.get(file.attributes().text("format", ""))
    return None


# -- H and HT --------------------------------------------------------------------------------------------


def _matrices(source: Path) -> list[Layer]:
    layers: list[Layer] = []
    for region in regions_of(source):
        H = open_psf(source, region=region)
        name = f"{source.stem} {region}".strip()
        own = "HT" if H.is_transposed else "H"
        layers.append(_matrix_layer(H, f"{name} ({own})", visible=not layers))
        if not H.is_transposed:
            layers.append(_matrix_layer(H.T, f"{name} (HT)", visible=False))
    return layers


def _matrix_layer(H: PSFMatrix, name: str, *, visible: bool) -> Layer:
    known = _along_z(len(H), H.depths if H.knows_depths else None)
    step, pixel = voxel_um(H), pixel_um(H)
    sides = (*(step or (1.0, 1.0)), *(pixel or (1.0, 1.0)))
    sides = (*sides[2:], *sides[:2]) if H.is_transposed else sides  # positions of HT are pixels
    unit = PIXEL if step is None or pixel is None else MICROMETRE
    middle = [n // 2 for n in H.shape[:3]]
    depths = [float(H.depths[z]) for z in known.planes] if H.knows_depths else None
    facts = {"anchor": H.anchor, "region": H.region, "path": H.path, "depths_um": depths, "planes": known.planes}
    words = {
        "name": name,
        "axis_labels": H_AXES,
        "scale": (known.step, *sides),
        "translate": (known.start, *(0.0,) * 4),
        "units": (known.unit, *(unit,) * 4),
        # from one pattern, as the range of all of H would load it
        "contrast_limits": _limits(np.asarray(H[middle[0], middle[1], middle[2]])),
        "visible": visible,
        "metadata": {"lfcal": facts},
    }
    return Lazy(H.shape, H.dtype, known.sorted(H.__getitem__), H), words, "image"


# -- sessions --------------------------------------------------------------------------------------------


def _session(folder: Path) -> list[Layer]:
    """Return the frames of a session by position; positions that were not recorded are dark."""
    source = RecordingSource(folder, skip_damaged=True)
    plan = source.plan
    where = {tuple(source.info(k).position): k for k in range(len(source))}
    frame = source.shape

    def read(index: Index) -> NDArray[Any]:
        picks = [range(n)[part] for part, n in zip(index[:3], plan.shape[:3], strict=True)]
        spread = [range(p, p + 1) if isinstance(p, int) else p for p in picks]
        rows, columns = index[3:]
        out = []
        for z in spread[0]:
            for y in spread[1]:
                for x in spread[2]:
                    found = where.get((z, y, x))
                    out.append(np.zeros(frame, source.dtype) if found is None else _whole(source, found))
        stack = np.array(out, source.dtype).reshape(*(len(s) for s in spread), *frame)
        return stack[tuple(0 if isinstance(p, int) else slice(None) for p in picks)][..., rows, columns]

    known = _along_z(len(plan.depths_um), np.asarray(plan.depths_um, np.float64))
    step = plan.camera.step_um(float(np.median(plan.depths_um)))
    pixel = plan.camera.sensor.pixel_um
    words = {
        "name": folder.resolve().name,
        "axis_labels": (*H_AXES[:3], "row", "column"),
        "scale": (known.step, step, step, pixel, pixel),
        "translate": (known.start, *(0.0,) * 4),
        "units": (MICROMETRE,) * 5,
        "contrast_limits": _limits(_whole(source, len(source) // 2)),
        "metadata": {
            "lfcal": {
                "path": str(folder),
                "depths_um": [plan.depths_um[z] for z in known.planes],
                "planes": known.planes,
                "frames": len(source),
            }
        },
    }
    return [(Lazy((*plan.shape[:3], *frame), source.dtype, known.sorted(read), source), words, "image")]


def _whole(source: RecordingSource, k: int) -> NDArray[Any]:
    """Return a frame; a damaged one is dark."""
    try:
        return source.read(k)
    except FileFormatError:
        return np.zeros(source.shape, source.dtype)


# -- volumes ---------------------------------------------------------------------------------------------


def _volume(source: Path) -> list[Layer]:
    file = H5File(source)
    try:
        data = file.dataset(DATASET)
        own: dict[str, Any] = {
            name: None if found is None else found.tolist()
            for name, found in (
                ("depths_um", file.values("depths", (data.shape[-3],), finite=True) if "depths" in file else None),
                ("times_s", file.values("times", finite=True) if "times" in file else None),
                ("voxel_um", file.attributes().numbers("voxel_um", (2,))),
                ("origin_um", file.attributes().numbers("origin_um", (2,))),
            )
        }
        known = file.attributes().plain()
    except BaseException:
        file.close()
        raise
    words, along = _volume_words(source, data.shape, own, known)
    words["contrast_limits"] = _limits(data.read((*(n // 2 for n in data.shape[:-2]),)))
    return [(Lazy(data.shape, data.dtype, along.sorted(data.read, data.ndim - 3), file), words, "image")]


def _ome_zarr(source: Path) -> list[Layer]:
    array, image, own = open_ome_zarr(source)
    words, along = _volume_words(source, array.shape, own, own)
    placed = {one.get("type"): one for one in image["datasets"][0].get("coordinateTransformations", ())}
    z = array.ndim - 3
    for name, key in (("scale", "scale"), ("translate", "translation")):
        if kind := placed.get(key):
            stated = list(map(float, kind[key]))
            # files of earlier versions with decreasing depths state no correct start
            words[name] = (*stated[:z], words[name][z], *stated[z + 1 :])
    axes = [axis for axis in image.get("axes", ()) if isinstance(axis, dict)]
    if len(axes) == array.ndim:
        words["axis_labels"] = tuple(str(axis.get("name")) for axis in axes)
        words["units"] = tuple(str(axis.get("unit", PIXEL)) for axis in axes)
    words["contrast_limits"] = _limits(np.asarray(array[tuple(n // 2 for n in array.shape[:-2])]))
    return [(Lazy(array.shape, array.dtype, along.sorted(partial(_piece, array), z), array), words, "image")]


def _piece(array: Any, index: Index) -> NDArray[Any]:
    return np.asarray(array[index])


def _volume_words(
    source: Path, shape: tuple[int, ...], own: Mapping[str, Any], known: Mapping[str, Any]
) -> tuple[dict[str, Any], _AlongZ]:
    """Return the keyword arguments of a layer of volumes with the axes (t), z, y, x, and its planes."""
    depths, times, sides = own.get("depths_um"), own.get("times_s"), own.get("voxel_um")
    along = _along_z(shape[-3], None if depths is None else np.asarray(depths, np.float64))
    first, step = (0.0, 1.0) if not times else (times[0], float(np.diff(times).mean()) if len(times) > 1 else 1.0)
    n = len(shape)
    words = {
        "name": source.name.removesuffix(".zarr").removesuffix(".ome").removesuffix(".h5"),
        "axis_labels": ("t", *H_AXES[:3])[-n:],
        "scale": (step, along.step, *(sides or (1.0, 1.0)))[-n:],
        "translate": (first, along.start, *((own.get("origin_um") if sides else None) or (0.0, 0.0)))[-n:],
        "units": (SECOND if times else PIXEL, along.unit, *((PIXEL if sides is None else MICROMETRE,) * 2))[-n:],
        "metadata": {
            "lfcal": {**known, "planes": along.planes}
            | ({} if depths is None else {"depths_um": [float(depths[z]) for z in along.planes]})
        },
    }
    return words, along


@dataclass(frozen=True)
class _AlongZ:
    """Position and spacing of the planes for napari, which assumes one spacing and increasing depths.

    ``planes`` are the planes of the file from the smallest depth to the largest.
    """

    planes: list[int]
    step: float = 1.0
    start: float = 0.0
    unit: str = PIXEL

    def sorted(self, read: Read, axis: int = 0) -> Read:
        """Return a function like ``read`` whose planes, along ``axis``, are in the order of `planes`."""
        if self.planes == list(range(len(self.planes))):
            return read

        def read_sorted(index: Index) -> NDArray[Any]:
            before, part, after = index[:axis], index[axis], index[axis + 1 :]
            if isinstance(part, int):
                return np.asarray(read((*before, self.planes[part], *after)))
            # the axis of the planes follows those of slices
            at = sum(isinstance(one, slice) for one in before)
            if not (picked := self.planes[part]):
                return np.asarray(read((*before, slice(0, 0), *after)))
            return np.stack([read((*before, z, *after)) for z in picked], at)

        return read_sorted


def _along_z(planes: int, depths: NDArray[np.float64] | None) -> _AlongZ:
    """Return the planes by increasing depth, their mean spacing and the position of the first."""
    if depths is None:
        return _AlongZ(list(range(planes)))
    order = np.argsort(depths, kind="stable")
    steps = np.diff(depths[order])
    step = float(steps.mean()) if len(steps) else 1.0
    return _AlongZ(order.tolist(), step or 1.0, float(depths[order[0]]), MICROMETRE)


def _limits(values: NDArray[Any]) -> tuple[float, float]:
    """Return the display range that shows the contents of an image."""
    finite = values[np.isfinite(values)]
    low, high = (0.0, 0.0) if not finite.size else (min(0.0, float(finite.min())), float(finite.max()))
    return low, high if high > low else low + 1.0
