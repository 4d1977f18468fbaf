"""NeXus attributes: with them, HDF5 viewers (silx, h5web, NeXpy) open an H file as a plot with named axes.

``/@default`` names an NXentry, whose ``@default`` names an NXdata. Its ``@signal`` and ``@axes`` name datasets in the
same group. They are hard links to the file's datasets, because soft links are refused when the file is opened. See
https://manual.nexusformat.org/datarules.html
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lfcal.base import centre

__all__ = ["mark_default_plot"]

PIXELS = {
    "y": "row of the source position (pixels)",
    "x": "column of the source position (pixels)",
    "t": "row from the cutout's centre (pixels)",
    "s": "column from the cutout's centre (pixels)",
}


def mark_default_plot(file: Any) -> None:
    """Make the sums over all positions the default plot of an H file, with H in the same group."""
    name = str(file.attrs["matrix"])
    nt, ns = file["H"].shape[3:]
    entry = file.create_group("entry")
    file.attrs.update({"NX_class": "NXroot", "default": "entry"})
    entry.attrs.update({"NX_class": "NXentry", "default": "depth_sum"})
    known = file["depths"].attrs["unit"] == "um"
    units, said = ("um", "depth away from the camera (um)") if known else ("", "plane number")
    file["depths"].attrs.update({"units": units, "long_name": said})
    file["depth_sum"].attrs.update({"long_name": f"{name} summed over all positions", "interpretation": "image"})
    file["H"].attrs["interpretation"] = "image"
    offsets = {"t": np.arange(nt) - centre(nt), "s": np.arange(ns) - centre(ns)}
    positions = {"y": np.arange(file["H"].shape[1]), "x": np.arange(file["H"].shape[2])}
    _plot(file, entry, "depth_sum", f"{name}: depth-plane sums", offsets)
    _plot(file, entry, "H", f"{name}: a pattern for each depth and position", positions | offsets)


def _plot(file: Any, entry: Any, signal: str, title: str, scales: dict[str, Any]) -> None:
    """Add an NXdata group of ``signal``, whose axes are the depth and, in order, those of ``scales``."""
    data = entry.create_group(signal)
    data[signal], data["depths"] = file[signal], file["depths"]
    data["title"] = title
    for name, values in scales.items():
        data.create_dataset(name, data=values.astype(np.int32)).attrs.update({"units": "px", "long_name": PIXELS[name]})
    axes = ["depths", *scales]
    data.attrs.update({"NX_class": "NXdata", "signal": signal, "axes": axes})
    data.attrs.update({f"{name}_indices": np.int32(k) for k, name in enumerate(axes)})
