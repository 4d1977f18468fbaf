"""Maps of pixels from files: an image that is not 0 at these pixels, or a list of their rows and columns."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import FileFormatError, InputError, format_pixels, map_npy
from lfcal.base.h5 import H5File
from lfcal.frames.formats import open_image, split_dataset
from lfcal.frames.source import FrameSource

__all__ = ["frame_map", "sensor_map"]

LISTS = frozenset({".txt", ".csv", ".tsv", ".dat", ".lst"})
"""Suffixes of lists; all other files are images."""

_ROWS = frozenset({"row", "rows", "y", "line"})
_COLUMNS = frozenset({"column", "columns", "col", "x"})
"""Names of the columns of a list, in lower case."""


def sensor_map(
    path: str | os.PathLike[str], what: str, source: FrameSource, shape: tuple[int, int] | None
) -> NDArray[np.bool_]:
    """Return a boolean map of the pixels marked in a file, in the coordinates of the calibration frames.

    Parameters
    ----------
    path
        An image (``.npy``, TIFF, PNG, HDF5) of the frames or of the complete sensor, as delivered, that is not 0 at
        these pixels. Alternatively, a list of rows and columns on the sensor, counted from 0.
    what
        Name of the pixels for messages.
    source
        The frames; if they show one channel of a mosaic, the file refers to the mosaic.
    shape
        Rows and columns of the dark and white frames in use. None: there are none.

    Raises
    ------
    LfcalError
        If the file cannot be read, has another shape, or lists pixels outside the sensor.
    """
    known = source.metadata
    step, phase = known.pixel_step, known.channel_phase or (0, 0)
    target, first = _frame_of(source, shape)
    size = (target[0] * step, target[1] * step)
    marked = _marked(path, what, size, first)
    if marked.shape != target and first != (0, 0):
        marked = marked[first[0] : first[0] + size[0], first[1] : first[1] + size[1]]
    if known.channel_phase is not None and marked.shape != target:
        marked = marked[phase[0] :: step, phase[1] :: step][: target[0], : target[1]]
    return _checked(path, what, marked, target)


def frame_map(
    path: str | os.PathLike[str], what: str, shape: tuple[int, int], origin: tuple[int, int] = (0, 0)
) -> NDArray[np.bool_]:
    """Return a boolean map of the pixels marked in a file, for a frame that starts at the sensor pixel ``origin``.

    ``path`` and ``what`` are as in `sensor_map`; ``shape`` is that of the frame.
    """
    marked = _marked(path, what, shape, origin)
    if marked.shape != shape:
        marked = marked[origin[0] : origin[0] + shape[0], origin[1] : origin[1] + shape[1]] if any(origin) else marked
    return _checked(path, what, marked, shape)


def _marked(
    path: str | os.PathLike[str], what: str, size: tuple[int, int], first: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return a map of shape ``size`` from pixel ``first``, with the listed pixels marked; or the map in an image."""
    if split_dataset(path)[0].suffix.lower() not in LISTS:
        return _image(path, what)
    pixels = _listed(path) - np.array(first)
    inside = ((pixels >= 0) & (pixels < np.array(size))).all(axis=1)
    if first == (0, 0) and not inside.all():
        got = ",".join(str(n) for n in pixels[~inside][0].tolist())
        wanted = f"rows and columns from 0 on a sensor of {size[0]} x {size[1]} px"
        raise InputError.expected(f"{what} {path}", wanted, got, "correct this pixel in the list")
    marked = np.zeros(size, np.bool_)
    marked[tuple(pixels[inside].T)] = True
    return marked


def _checked(
    path: str | os.PathLike[str], what: str, marked: NDArray[np.bool_], target: tuple[int, int]
) -> NDArray[np.bool_]:
    """Return the marked pixels, or raise `InputError` if their shape is wrong."""
    if marked.shape != target:
        raise InputError.expected(
            f"{what} {path}",
            f"{format_pixels(target)}, as the frames come from the camera",
            format_pixels(marked.shape),
            "use a map for the sensor settings of the frames",
        )
    return np.ascontiguousarray(marked)


def _frame_of(source: FrameSource, shape: tuple[int, int] | None) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return the shape of all calibration frames, and the sensor position (row, column) of their first pixel."""
    known = source.metadata
    if known.origin is not None and shape in (None, source.shape):
        return source.shape, (known.origin[0] * known.pixel_step, known.origin[1] * known.pixel_step)
    if shape is not None:
        return shape, (0, 0)
    origins = np.array([source.info(k).origin for k in range(len(source))])
    if known.plan is not None and origins.any():
        return known.plan.camera.sensor.shape, (0, 0)
    rows, columns = (origins.max(axis=0) + np.array(source.shape)).tolist()
    return (rows, columns), (0, 0)


def _listed(path: str | os.PathLike[str]) -> NDArray[np.int64]:
    """Return the rows and columns in a text list, ``(n, 2)``."""
    from lfcal.frames.lists import read_table

    table = read_table(os.fspath(path))
    names = [name.strip().lower() for name in table.columns]
    if not table.header and len(names) == 2:
        names = ["row", "column"]
    found = [[k for k, name in enumerate(names) if name in wanted] for wanted in (_ROWS, _COLUMNS)]
    if any(len(one) != 1 for one in found):
        got = ", ".join(table.columns) if table.header else f"{len(names)} columns without names"
        raise FileFormatError.expected(str(path), "the columns row and column, or y and x", got, "rename the columns")
    (row,), (column,) = found
    pixels = []
    for number, cells in zip(table.lines, table.rows, strict=True):
        try:
            pixels.append((int(cells[row]), int(cells[column])))
        except ValueError:
            wanted, got = "whole numbers", f"{cells[row]}, {cells[column]}"
            raise FileFormatError.expected(
                f"{path} line {number}", wanted, got, "give the row and the column of a pixel"
            ) from None
    return np.array(pixels, np.int64).reshape(-1, 2)


def _image(path: str | os.PathLike[str], what: str) -> NDArray[np.bool_]:
    """Return a mask that is True where an image is not 0; NaN counts as not 0."""
    file, dataset = split_dataset(path)
    if file.suffix.lower() == ".npy":
        values: NDArray[Any] = map_npy(file)
    elif dataset is not None or file.suffix.lower() in (".h5", ".hdf5", ".mat", ".nxs"):
        with H5File(file) as data:
            values = data.values(dataset or _only_image(data, file), kinds="biuf")
    else:
        image = open_image(file)
        try:
            if image.pages > 1:
                raise InputError.expected(f"{what} {path}", "one image", f"{image.pages} pages", "keep one page")
            values = image.read()
        finally:
            image.close()
    if values.ndim > 2:
        values = values.reshape(values.shape[-2:] if values.size == np.prod(values.shape[-2:]) else values.shape)
    if values.ndim != 2 or values.dtype.kind not in "biuf":
        got = f"{values.dtype} of shape {values.shape}"
        raise FileFormatError.expected(
            f"{what} {path}", "one image with axes (row, column)", got, "save a single image"
        )
    return np.asarray(values != 0)


def _only_image(data: H5File, file: os.PathLike[str]) -> str:
    """Return the only dataset with two axes of an HDF5 file."""
    found = [name for name, shape in data.datasets().items() if len(shape) == 2]
    if len(found) != 1:
        got = ", ".join(f"/{name}" for name in found[:8]) or "none"
        remedy = f"name it as {os.fspath(file)}::/{found[0]}" if found else "check the file"
        raise FileFormatError.expected(os.fspath(file), "one dataset with axes (row, column)", got, remedy)
    return found[0]
