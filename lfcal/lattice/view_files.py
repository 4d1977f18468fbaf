"""Files of views and focal stacks: stacks for ImageJ, and images for viewing."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import write_png, write_tiff
from lfcal.lattice.views import Views

__all__ = ["TOTAL", "save_focal_stack", "save_total_focus", "save_views", "stack_names", "view_names"]

Array = NDArray[Any]

LARGEST = 3 << 30
"""Size (bytes) of the largest stack in ImageJ's own format, which is limited to 4 GB."""

TOTAL = ("all_in_focus.tif", "all_in_focus.png", "slopes.tif")
"""Files written by `save_total_focus`."""


def view_names(label: str) -> list[str]:
    """Return the names of the files that `save_views` writes: stack, mosaic and central view."""
    return [f"views{label}.tif", f"views{label}.png", f"central_view{label}.png"]


def stack_names(label: str, slopes: tuple[float, ...]) -> list[str]:
    """Return the names of the files that `save_focal_stack` writes: the stack, and one image for each of ``slopes``."""
    return [f"focal_stack{label}.tif", *(f"focus{label}_{slope:+07.2f}.png" for slope in slopes)]


def save_views(out: Path, label: str, colours: list[Views], times: int) -> None:
    """Write a stack of all views ``(v, u, y, x)``, a mosaic of every second view, and the central view.

    In ImageJ, the axes of the stack are (t, z, y, x), or (t, z, c, y, x) for several colours. Samples that no lenslet
    sees are NaN. ``label`` is part of the names of the files in the folder ``out``. ``colours`` contains the views of
    each colour channel, and ``times`` is the integer factor by which the central view is enlarged.
    """
    stack, mosaic, central = (out / name for name in view_names(label))
    images = _joined([np.where(one.mask, one.images, np.float32(np.nan)) for one in colours], 2)
    _save_stack(stack, images, "TZCYX" if len(colours) > 1 else "TZYX")
    for path, shown, larger in (
        (mosaic, _joined([one.mosaic(2) for one in colours], 0), 1),
        (central, _joined([one.central for one in colours], 0), times),
    ):
        _save_picture(path, shown if shown.ndim == 2 or len(shown) == 3 else shown[0], larger)


def save_focal_stack(out: Path, label: str, colours: list[Array], slopes: tuple[float, ...]) -> None:
    """Write all planes of a focal stack to one TIFF file, and each plane to a PNG file for display.

    ``label`` is part of the names of the files in the folder ``out``. ``colours`` contains the stack ``(n, rows,
    columns)`` of each colour channel, and ``slopes`` the slope of each of the n planes.
    """
    stack, names = _joined(colours, 1), stack_names(label, slopes)
    _save_stack(out / names[0], stack, "ZCYX" if stack.ndim == 4 else "ZYX", [f"slope {w:+.3f}" for w in slopes])
    for name, image in zip(names[1:], stack, strict=True):
        _save_picture(out / name, image)


def save_total_focus(out: Path, colours: list[tuple[Array, Array]]) -> None:
    """Write the all-in-focus image, a copy of it for display, and its slope map to the folder ``out``.

    ``colours`` contains for each colour channel the image and the slope at which each sample is in focus, both ``(rows,
    columns)``.
    """
    image, slopes = (_joined(list(of), 0) for of in zip(*colours, strict=True))
    for name, one in ((TOTAL[0], image), (TOTAL[2], slopes)):
        _save_stack(out / name, one, "CYX" if one.ndim == 3 else "YX")
    _save_picture(out / TOTAL[1], image)


def _joined(colours: list[Array], axis: int) -> Array:
    """Return arrays of several colours as one array; for a single colour, no axis is added."""
    return colours[0] if len(colours) == 1 else np.stack(colours, axis=axis)


def _save_stack(path: Path, stack: Array, axes: str, labels: list[str] | None = None) -> None:
    """Write float32 images as a hyperstack; ``axes`` are those of ``stack``, ``labels`` name the steps along z."""
    metadata: dict[str, Any] = {"axes": axes}
    big = 4 * math.prod(stack.shape) > LARGEST
    if labels is not None and not big:
        # one label per picture: all channels of a plane have the plane's label
        each = stack.shape[axes.index("C")] if "C" in axes else 1
        metadata["Labels"] = [label for label in labels for _ in range(each)]
    write_tiff(path, np.ascontiguousarray(stack, np.float32), imagej=not big, bigtiff=big, metadata=metadata)


def _save_picture(path: Path, image: Array, times: int = 1) -> None:
    """Write ``(rows, columns)`` or ``(colours, rows, columns)`` as PNG, each sample ``times`` as wide and high.

    White is the 99.7th percentile, black the 0.5th, because hot pixels and dead lenslets would dominate otherwise.
    Red, green and blue share the scale.
    """
    low, high = np.nanpercentile(image, (0.5, 99.7))
    grey = np.nan_to_num(np.clip((image - low) / max(high - low, 1e-30), 0, 1))
    shown = np.rint(255 * grey).astype(np.uint8).repeat(times, axis=-2).repeat(times, axis=-1)
    if shown.ndim == 3:
        shown = np.ascontiguousarray(shown[::-1].transpose(1, 2, 0))
    write_png(path, shown)
