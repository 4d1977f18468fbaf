"""Shapes of beads and lines in a volume, and how they depend on their parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["BEAD", "BEYOND", "LINE", "Shape", "VolumePart", "plane_weights"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

NARROWEST, WIDEST = 0.5, 6.0
"""Limits of the standard deviation of a profile (voxels); a narrower one could miss the centres of the voxels."""

BEYOND = 0.5
"""Distance beyond the first and last planes up to which H is extrapolated (planes), and beyond the volume (voxels)."""

REACH = 4.5
"""Half width of a painted profile, in standard deviations."""

BEAD = ("brightness", "row", "column", "plane", "width")
"""Parameters of a bead: sum of its voxels, centre (voxels), fractional plane index, standard deviation (voxels)."""

LINE = ("brightness", "row", "column", "plane", "width", "end_row", "end_column")
"""Parameters of a line: those of a bead, with the position of one end, and the position of the other end."""

STEPS = {"row": 0.05, "column": 0.05, "plane": 0.03, "width": 0.03, "end_row": 0.05, "end_column": 0.05}
"""Steps for numerical derivatives with respect to the parameters (voxels; planes for ``plane``)."""

FARTHEST = {"row": 1.0, "column": 1.0, "plane": 0.5, "width": 0.3, "end_row": 1.0, "end_column": 1.0}
"""Largest change of each parameter in an iteration (voxels; planes for ``plane``)."""


NODES = 4
"""Number of planes between which H is interpolated."""


def plane_weights(plane: float, planes: int, nodes: int = NODES) -> tuple[NDArray[np.intp], F8]:
    """Return the indices and the weights of the planes from which H is interpolated at the fractional index ``plane``.

    These are up to ``nodes`` of the ``planes`` planes. The weights are those of a Lagrange polynomial.
    """
    count = min(planes, nodes)
    first = min(max(round(plane - (count - 1) / 2), 0), planes - count)
    at = np.arange(first, first + count)
    weights = np.ones(count)
    for i in range(count):
        for j in range(count):
            if i != j:
                weights[i] *= (plane - at[j]) / (at[i] - at[j])
    return at, weights


@dataclass(frozen=True, eq=False)
class VolumePart:
    """A part of a volume that contains a feature.

    Attributes
    ----------
    corner
        Row and column of its first voxel.
    values
        Light ``(planes, rows, columns)`` of the planes ``at``.
    at
        Indices of the planes.
    """

    corner: tuple[int, int]
    values: F8
    at: NDArray[np.intp]

    def add_to(self, volume: F4, factor: float = 1.0) -> None:
        """Add ``factor`` times the light to ``volume`` ``(nz, Y, X)``; what is outside is lost."""
        (top, left), (_, rows, columns) = self.corner, self.values.shape
        y0, x0 = max(top, 0), max(left, 0)
        y1, x1 = min(top + rows, volume.shape[1]), min(left + columns, volume.shape[2])
        if y0 < y1 and x0 < x1:
            part = self.values[:, y0 - top : y1 - top, x0 - left : x1 - left]
            volume[self.at, y0:y1, x0:x1] += (factor * part).astype(np.float32)


@dataclass(frozen=True)
class Shape:
    """A bead or a line, with values for all parameters.

    Attributes
    ----------
    values
        Values of the parameters in the order of `BEAD` or `LINE`.
    free
        Indices of the parameters that are fitted.
    """

    values: tuple[float, ...]
    free: tuple[int, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return BEAD if len(self.values) == len(BEAD) else LINE

    def changed(self, k: int, by: float) -> Shape:
        """Return the shape with parameter ``k`` increased by ``by``."""
        values = list(self.values)
        values[k] += by
        return replace(self, values=tuple(values))

    def moved(self, step: F8, volume: tuple[int, ...], least: float) -> Shape:
        """Return the shape after a ``step`` of its free parameters, limited in size, and to possible values.

        ``volume`` is the shape ``(nz, Y, X)`` of the volume, and ``least`` the smallest brightness.
        """
        values = list(self.values)
        for k, change in zip(self.free, step, strict=True):
            name = self.names[k]
            most = FARTHEST.get(name, math.inf)
            value = values[k] + min(max(float(change), -most), most)
            low, high = (least, math.inf) if name == "brightness" else _limits(name, volume)
            values[k] = min(max(value, low), high)
        return replace(self, values=tuple(values))

    def at_a_limit(self, volume: tuple[int, ...]) -> bool:
        """Return whether `moved` has limited the position or the width, so that they are not determined."""
        free = {self.names[k]: self.values[k] for k in self.free if k > 0}
        return any(value in _limits(name, volume) for name, value in free.items())

    def _profile(self) -> tuple[tuple[int, int], F8]:
        """Return row and column of the first voxel, and the light ``(rows, columns)`` of a shape of brightness 1."""
        _, row, column, _, width, *end = self.values
        reach = REACH * width + 1
        to_row, to_column = end or (row, column)
        top, left = math.floor(min(row, to_row) - reach), math.floor(min(column, to_column) - reach)
        rows = np.arange(top, math.ceil(max(row, to_row) + reach) + 1) - row
        columns = np.arange(left, math.ceil(max(column, to_column) + reach) + 1) - column
        if end:
            return (top, left), _segment(rows[:, None], columns[None], (to_row - row, to_column - column), width)
        profile = np.outer(np.exp(-(rows**2) / (2 * width**2)), np.exp(-(columns**2) / (2 * width**2)))
        return (top, left), profile / (2 * math.pi * width**2)

    def patch(self, planes: int, brightness: float | None = None) -> VolumePart:
        """Return the light of the shape in a volume of ``planes`` planes, with its own or another ``brightness``."""
        corner, profile = self._profile()
        at, weights = plane_weights(self.values[3], planes)
        light = self.values[0] if brightness is None else brightness
        return VolumePart(corner, light * weights[:, None, None] * profile, at)

    def interpolation_error(self, planes: int) -> VolumePart:
        """Return the change of the light when H is interpolated with one more plane (one less if there are no more).

        Between planes, interpolated patterns of H differ from true ones by about as much.
        """
        corner, profile = self._profile()
        weights = np.zeros(planes)
        if planes > 1:
            most = min(NODES + 1, planes)
            for nodes, sign in ((most, 1), (most - 1, -1)):
                at, some = plane_weights(self.values[3], planes, nodes)
                weights[at] += sign * some
        return VolumePart(corner, self.values[0] * weights[:, None, None] * profile, np.arange(planes))

    def derivative(self, k: int, planes: int) -> tuple[tuple[VolumePart, float], ...]:
        """Return patches with factors; their weighted sum is the derivative with respect to parameter ``k``."""
        if k == 0:
            return ((self.patch(planes, 1.0), 1.0),)
        step = STEPS[self.names[k]]
        above, below = self.changed(k, step), self.changed(k, -step)
        return (above.patch(planes), 1 / (2 * step)), (below.patch(planes), -1 / (2 * step))


def _limits(name: str, volume: tuple[int, ...]) -> tuple[float, float]:
    """Return the smallest and largest value of a parameter in a ``volume`` ``(nz, Y, X)``; not of the brightness."""
    if name == "width":
        return NARROWEST, WIDEST
    axis = 0 if name == "plane" else 1 if name.endswith("row") else 2
    return -BEYOND, volume[axis] - 1 + BEYOND


def _segment(y: NDArray[Any], x: NDArray[Any], to: tuple[float, float], width: float) -> NDArray[Any]:
    """Return a line of total brightness 1 from (0, 0) ``to`` a point, convolved with a Gaussian of ``width``."""
    # slow to import
    from scipy.special import erf

    length = max(math.hypot(*to), 1e-6)
    down, across = to[0] / length, to[1] / length
    along, aside = y * down + x * across, x * down - y * across
    scale = width * math.sqrt(2)
    ends = (erf(along / scale) - erf((along - length) / scale)) / (2 * length)
    found: NDArray[Any] = ends * np.exp(-((aside / scale) ** 2)) / (width * math.sqrt(2 * math.pi))
    return found
