"""Write depth maps: a TIFF file of several float images, and a point cloud (PLY)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from lfcal.base import replace_whole, write_tiff
from lfcal.lattice._depth_map import DepthMap

__all__ = ["save_depth", "save_points"]

CLOUD = np.dtype(
    [(name, "<f4") for name in ("x", "y", "z")]
    + [(name, "u1") for name in ("red", "green", "blue")]
    + [(name, "<f4") for name in ("intensity", "confidence")]
)
"""A point of the cloud; red, green and blue are the brightness, which most viewers show."""


def save_depth(path: Path, found: DepthMap) -> None:
    """Write the depth, its standard error, confidence, light and disparity to a TIFF file of float32 images.

    If ``found`` contains no depths in µm, slopes and their standard errors are written instead. Where the depth is
    unknown, the depth, its standard error and the disparity are NaN, and the confidence is 0. A slope beyond that of an
    object at infinity also gives a depth (µm) and a standard error of NaN, but keeps its confidence and disparity.

    The file is an ImageJ hyperstack, whose labels state the quantities and units of the pages. Its ``Info`` is a JSON
    object with the entries ``method``, ``pages`` (the labels), ``corner_px``, ``step_px`` and ``unknown`` (``"NaN"``,
    the value of unknown depths).

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> import tifffile
    >>> from lfcal.lattice import DepthMap, save_depth
    >>> one = np.ones((3, 4), np.float32)
    >>> save_depth(Path("depth.tif"), DepthMap(2 * one, one, one, one, "views", (0.0, 0.0), (4.0, 4.0), 0.5))
    >>> with tifffile.TiffFile("depth.tif") as file:
    ...     print(file.asarray().shape, file.imagej_metadata["Labels"][:2])
    (5, 3, 4) ['slope (1)', 'standard error of the slope (1)']
    """
    if found.z_um is None or found.z_sigma_um is None:
        first = {"slope (1)": found.slope, "standard error of the slope (1)": found.sigma}
    else:
        first = {"depth (um)": found.z_um, "standard error of the depth (um)": found.z_sigma_um}
    unit = "samples" if found.method == "views" else "px"
    confidence = np.where(found.known, found.confidence, 0)
    pages = {**first, "confidence (1)": confidence, "light (1)": found.image, f"disparity ({unit})": found.disparity}
    facts = {
        "method": found.method,
        "pages": list(pages),
        "corner_px": found.corner_px,
        "step_px": found.step_px,
        "unknown": "NaN",
    }
    write_tiff(
        path,
        np.stack(list(pages.values())).astype(np.float32),
        imagej=True,
        metadata={"axes": "CYX", "Labels": list(pages), "Info": json.dumps(facts), "mode": "grayscale"},
    )


def save_points(path: Path, found: DepthMap) -> int:
    """Write the points of known depth (`DepthMap.points`) with light and confidence to a PLY file; return their number.

    A comment in the file states the axes and units of the coordinates.

    Examples
    --------
    >>> from pathlib import Path
    >>> import numpy as np
    >>> from lfcal.lattice import DepthMap, save_points
    >>> one = np.ones((3, 4), np.float32)
    >>> found = DepthMap(2 * one, one, one, one, "views", (0.0, 0.0), (4.0, 4.0), 0.5)
    >>> save_points(Path("points.ply"), found)
    12
    """
    points, chosen = found.points()
    light, cloud = found.image[chosen], np.zeros(len(points), CLOUD)
    low, high = np.quantile(light, (0.005, 0.997)) if len(light) else (0.0, 1.0)
    grey = np.rint(255 * np.clip((light - low) / max(high - low, 1e-30), 0, 1))
    for k, name in enumerate("xyz"):
        cloud[name] = points[:, k]
    for name in ("red", "green", "blue"):
        cloud[name] = grey
    cloud["intensity"], cloud["confidence"] = light, found.confidence[chosen]
    metric = "x right, y down, z away from the camera, in um from the axis in the working plane"
    said = "x, y in pixels of the frame, z is the slope" if found.z_um is None else metric
    kinds = {"<f4": "float", "|u1": "uchar"}
    lines = ["ply", "format binary_little_endian 1.0", f"comment lfcal: {said}", f"element vertex {len(cloud)}"]
    lines += [f"property {kinds[CLOUD[name].str]} {name}" for name in CLOUD.names or ()]
    with replace_whole(path) as part:
        part.write_bytes("\n".join([*lines, "end_header", ""]).encode() + cloud.tobytes())
    return len(cloud)
