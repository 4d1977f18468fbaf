"""The files of ``lfcal views``: stacks for ImageJ, pictures for people."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfcal.base import replace_whole

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["save_picture", "save_stack", "stack_names", "view_names"]

LARGEST = 3 << 30
"""Bytes from which on a stack is no longer in ImageJ's own form, which holds 4 GB at most."""


def view_names(label: str) -> list[str]:
    """Return the files of a set of views."""
    return [f"views{label}.tif", f"views{label}.png", f"central_view{label}.png"]


def stack_names(label: str, slopes: tuple[float, ...]) -> list[str]:
    """Return the files of a focal stack."""
    return [f"focal_stack{label}.tif", *(f"focus{label}_{slope:+07.2f}.png" for slope in slopes)]


def save_stack(path: Path, stack: NDArray[Any], axes: str, labels: list[str] | None = None) -> None:
    """Write float32 images as a hyperstack; ``axes`` are those of ``stack``, ``labels`` name the steps along z."""
    import numpy as np

    from lfcal.base import write_tiff

    metadata: dict[str, Any] = {"axes": axes}
    big = 4 * math.prod(stack.shape) > LARGEST
    if labels is not None and not big:
        # one label a picture: all channels of a plane have the plane's
        each = stack.shape[axes.index("C")] if "C" in axes else 1
        metadata["Labels"] = [label for label in labels for _ in range(each)]
    data = np.ascontiguousarray(stack, np.float32)
    write_tiff(path, data, imagej=not big, bigtiff=big, metadata=metadata)


def save_picture(path: Path, image: NDArray[Any], times: int = 1) -> None:
    """Write ``(rows, columns)`` or ``(colours, rows, columns)`` as PNG, each sample ``times`` as wide and high.

    White is the 99.7th percentile, black the 0.5th: hot pixels and dead lenslets would otherwise decide. Red, green
    and blue share the scale.
    """
    import cv2
    import numpy as np

    low, high = np.nanpercentile(image, (0.5, 99.7))
    grey = np.nan_to_num(np.clip((image - low) / max(high - low, 1e-30), 0, 1))
    shown = np.rint(255 * grey).astype(np.uint8).repeat(times, axis=-2).repeat(times, axis=-1)
    if shown.ndim == 3:
        shown = np.ascontiguousarray(shown[::-1].transpose(1, 2, 0))
    ok, encoded = cv2.imencode(".png", shown)
    if not ok:
        raise RuntimeError("PNG encoding failed")
    with replace_whole(path) as part:
        part.write_bytes(encoded.tobytes())
