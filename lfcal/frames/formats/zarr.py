"""OME-Zarr folders (0.4 and 0.5) and plain zarr arrays as frames; chunks are read when their frames are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import ZARR_MARKS, FileFormatError, check_region, check_stored, ome_images
from lfcal.frames.formats.codecs import codec_fact
from lfcal.frames.formats.image_file import Format, ImageFile, check_declared, check_samples, decoding

__all__ = ["ZarrImage"]


class ZarrImage(ImageFile):
    """The images of an OME-Zarr as pages, image by image; within an image, the last axis before (y, x) varies fastest.

    Parameters
    ----------
    path
        A file of metadata in the folder, such as ``zarr.json`` or ``.zattrs``.
    dataset
        Path of an image or array in the folder. None: all images.

    Raises
    ------
    FileFormatError, UnsafeFileError, StorageError, InputError
        As in `lfcal.base.ome_images`; also if images differ in shape or type, or their axes do not end with (y, x).
    """

    def __init__(self, path: Path, dataset: str | None = None) -> None:
        self.path = path.parent
        images, _ = ome_images(self.path, dataset or "")
        self._arrays = [array for array, _ in images]
        first, image = images[0]
        shape = tuple(first.shape)
        names = [
            str(axis.get("name")) if isinstance(axis, dict) else str(axis) for axis in image.get("axes", ())
        ]  # texts in version 0.3
        kinds = {(tuple(array.shape), array.dtype) for array in self._arrays}
        if len(kinds) > 1 or len(shape) < 2 or (names and names[-2:] != ["y", "x"]):
            got = " and ".join(f"{dtype} of shape {shape}" for shape, dtype in sorted(kinds, key=str)) + (
                f" with the axes ({', '.join(names)})" if names else ""
            )
            remedy = f"choose one: {self.path.name}::IMAGE"
            raise FileFormatError.expected(str(self.path), "images of one shape with the axes (…, y, x)", got, remedy)
        check_stored(self.path, self._arrays)
        self.shape, self.dtype = (int(shape[-2]), int(shape[-1])), np.dtype(first.dtype).newbyteorder("=")
        check_declared(self.path, self.shape, self.dtype.itemsize, int(np.prod(self.shape)) * self.dtype.itemsize)
        self._lead = (len(images), *map(int, shape[:-2]))
        self.pages = int(np.prod(self._lead))
        self.metadata = {"codec": codec_fact("zarr"), **self._axes(names[:-2]), **_pixel(image)}

    def _axes(self, names: list[str]) -> dict[str, Any]:
        """Return the axes of the pages: P for images, and the first letters of the others."""
        if not names and len(self._lead) == 4 and self._lead[0] == 1:
            return {"plan_shape": self._lead[1:]}
        letters = ["P", *(name[:1].upper() for name in names)]
        used = [(letter, n) for letter, n in zip(letters, self._lead, strict=False) if n > 1]
        if len(used) < 2:
            return {}
        return {"scan_axes": ("".join(letter for letter, _ in used), tuple(n for _, n in used))}

    def read(self, page: int = 0) -> NDArray[Any]:
        """Return frame ``page``, ``(rows, columns)``."""
        return self.read_region(page, slice(0, self.shape[0]), slice(0, self.shape[1]))

    def read_region(self, page: int, rows: slice, columns: slice) -> NDArray[Any]:
        """Return the part ``[rows, columns]`` of frame ``page``; only the chunks that contain it are read."""
        rows, columns = check_region((rows, columns), self.shape)
        image, *lead = (int(k) for k in np.unravel_index(self.check_page(page), self._lead))
        with decoding(self.path, "OME-Zarr"):
            part = self._arrays[image][(*lead, rows, columns)]
        return check_samples(self.path, np.ascontiguousarray(part, self.dtype))


def _pixel(image: dict[str, Any]) -> dict[str, float]:
    """Return the size of a pixel along x, if the image states it in µm."""
    with decoding(Path(str(image.get("name", "image"))), "OME-Zarr"):
        units = [axis.get("unit") for axis in image.get("axes", ()) if isinstance(axis, dict)]
        for one in image.get("datasets", ({},))[0].get("coordinateTransformations", ()) if units else ():
            if one.get("type") == "scale" and units[-1] == "micrometer" and (size := float(one["scale"][-1])) > 0:
                return {"pixel_um": size}
    return {}


FORMAT = Format(
    "OME-Zarr",
    frozenset(),
    lambda _, path: path.name in ZARR_MARKS,
    lambda path, _, dataset: ZarrImage(path, dataset),
    in_folders=False,
)
