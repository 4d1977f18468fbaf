"""Regions that the user draws in the pictures of a volume, for the sums of error bars. No Qt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal_gui.models import Label, Outline, Overlay

COLOUR = "#5ce1e6"


class DrawnBox(NamedTuple):
    """First voxel and last voxel plus one of a region along z, y and x."""

    z: tuple[int, int]
    y: tuple[int, int]
    x: tuple[int, int]


@dataclass(frozen=True)
class DrawnRegions:
    """Boxes in a volume, numbered from 1 in the order in which they were drawn.

    Attributes
    ----------
    shape
        Shape ``(Z, Y, X)`` of the volume.
    boxes
        All boxes. Where two overlap, the voxels belong to the later one.
    axes
        The two axes of the picture in which the last one was drawn.
    """

    shape: tuple[int, ...] = ()
    boxes: tuple[DrawnBox, ...] = ()
    axes: frozenset[str] = frozenset()

    def begun(self, axes: frozenset[str], whole: Mapping[str, tuple[int, int]]) -> DrawnRegions:
        """Return the regions when a drag begins in the picture of ``axes``.

        In the picture in which the last box was drawn, a drag draws a new one, with the extents ``whole`` at first. In
        another picture, it sets the extents of the last box along the axes of that picture.
        """
        if self.boxes and axes != self.axes:
            return self
        return replace(self, boxes=(*self.boxes, DrawnBox(**whole)), axes=axes)

    def extended(self, ends: Mapping[str, tuple[int, int]]) -> DrawnRegions:
        """Return the regions with the last box between both voxels of a drag along each axis in ``ends``."""
        *others, last = self.boxes
        sides = {axis: (min(both), max(both) + 1) for axis, both in ends.items()}
        return replace(self, boxes=(*others, last._replace(**sides)))

    def labels(self) -> NDArray[np.int32]:
        """Return the number of the region of each voxel of the volume; 0 outside."""
        found = np.zeros(self.shape, np.int32)
        for number, box in enumerate(self.boxes, 1):
            found[tuple(slice(*ends) for ends in box)] = number
        return found

    def overlays(
        self, across: str, down: str, at: Mapping[str, int | None], edges: Mapping[str, NDArray[np.float64]]
    ) -> tuple[Overlay, ...]:
        """Return the numbered outlines of the regions in a picture with the axes ``across`` and ``down``.

        Parameters
        ----------
        across, down
            Axes of the picture.
        at
            Voxel of the slice along each axis. Regions without it are not drawn. None: a projection, which shows all.
        edges
            Both edges of every voxel along each axis, ``(n, 2)``, in the units of the picture.
        """
        (third,) = {*"xyz"} - {across, down}
        cut, found = at[third], list[Overlay]()
        for number, box in enumerate(self.boxes, 1):
            first, stop = getattr(box, third)
            if cut is not None and not first <= cut < stop:
                continue
            left, right = _span(edges[across], getattr(box, across))
            top, bottom = _span(edges[down], getattr(box, down))
            corners = np.array([(top, left), (top, right), (bottom, right), (bottom, left)])
            found += [Outline(corners, COLOUR), Label(corners.mean(0)[None], str(number), COLOUR)]
        return tuple(found)


def _span(edges: NDArray[np.float64], ends: tuple[int, int]) -> tuple[float, float]:
    """Return the outermost edges of some voxels."""
    part = edges[slice(*ends)]
    return float(part.min()), float(part.max())


def labels_file(out: str) -> Path:
    """Return the file for the labels of drawn regions, next to the table of their sums in the volume ``out``."""
    from lfcal.reconstruct import bar_outputs

    return bar_outputs(Path(out), regions=True)[-1].with_suffix(".tif")


class DrawnLabels(NamedTuple):
    """Labels ``(Z, Y, X)`` of drawn regions, and the depth of each plane (µm; None: unknown)."""

    labels: NDArray[np.int32]
    depths_um: NDArray[np.float64] | None

    def write(self, out: str) -> None:
        """Write the `labels_file` of the volume ``out``."""
        from lfcal.reconstruct import save_volume

        save_volume(labels_file(out), self.labels, depths_um=self.depths_um)
