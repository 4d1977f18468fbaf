"""Which lenslets make the pixels of a view: the largest box of the lattice inside a frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["ViewGrid", "view_grid"]

SLACK = 1e-9
"""A lenslet this close to the limit is inside: whole-pixel lattices touch it exactly (pixels, pitches)."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewGrid:
    """View pixels on a lattice: box of consecutive lattice rows, all sampled at the same columns.

    Attributes
    ----------
    rows
        Lattice rows r, consecutive.
    columns
        Columns in pitches along the rows, counted from the lenslet q = r = 0. Lenslet (q, r) lies at
        ``q + lean r``; columns need not meet lenslets where the lattice is hexagonal.
    lean
        How far each row is shifted along against the one before (pitches): 1/2 for a hexagonal lattice, else 0.
    """

    rows: NDArray[np.intp] = field(repr=False)
    columns: NDArray[np.float64] = field(repr=False)
    lean: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a view."""
        return len(self.rows), len(self.columns)

    def neighbours(self) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
        """Return the lenslet q at or left of each view pixel, and the share of the one to its right, ``shape`` each."""
        place = self.columns[None, :] - self.lean * self.rows[:, None]
        left = np.floor(place + SLACK).astype(np.intp)
        share = np.asarray(place - left, np.float64)
        # rounding must not draw in a lenslet that may lie outside the frame
        share[np.abs(share) < 1e-6] = 0.0
        return left, share


def view_grid(
    kind: str, basis_px: ArrayLike, origin_px: tuple[float, float], shape: tuple[int, ...], margin: float
) -> ViewGrid:
    """Return the grid with most view pixels whose lenslets all have ``margin`` pixels of frame about their centres.

    The box is upright along the lattice's own axes, whatever their angle to the pixels'. In a row, the lenslets
    inside the frame are an interval ``[first, last]`` (the frame is convex), so rows r0 to r1 share the columns
    from the largest ``first`` to the smallest ``last``; of all pairs (r0, r1) the one with most view pixels is taken.

    Parameters
    ----------
    kind
        ``"square"``: one column per lenslet; or ``"hexagonal"``: columns are a row pitch apart, so that views have
        square samples, and lie between two lenslets of their row.
    basis_px
        Lattice vectors as rows (x, y): to the next lenslet of a row, and to the next row (pixels).
    origin_px
        Centre (row, column) of the lenslet q = r = 0; it may lie outside the frame.
    shape
        Rows and columns of the frame.
    margin
        Least distance of a centre from the frame's outermost pixel centres (pixels).

    Returns
    -------
    ViewGrid
        Empty where no lenslet fits.
    """
    basis = np.asarray(basis_px, float)
    lean = 0.5 if kind == "hexagonal" else 0.0
    rows, first, last = _rows_inside(basis, np.array(origin_px)[::-1], np.array(shape[::-1], float), margin)
    if not rows.size:
        return ViewGrid(np.zeros(0, np.intp), np.zeros(0), lean)
    step = _row_step(basis) if kind == "hexagonal" else 1.0
    top, bottom = _largest_box(first + lean * rows, last + lean * rows, step)
    left = float((first + lean * rows)[top:bottom].max())
    right = float((last + lean * rows)[top:bottom].min())
    columns = np.asarray(left + step * np.arange(_count(left, right, step)), np.float64)
    return ViewGrid(rows[top:bottom], columns, lean)


def _row_step(basis: NDArray[np.float64]) -> float:
    """Return the row pitch in pitches."""
    (ax, ay), (bx, by) = basis.tolist()
    return float(abs(ax * by - ay * bx) / (ax * ax + ay * ay))


def _count(left: float, right: float, step: float) -> int:
    return int((right - left) / step + SLACK) + 1 if right >= left - SLACK else 0


def _rows_inside(
    basis: NDArray[np.float64], origin: NDArray[np.float64], size: NDArray[np.float64], margin: float
) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.float64]]:
    """Return the lattice rows with lenslets inside, and the first and last q of each; all vectors are (x, y)."""
    low, high = margin - SLACK - origin, size - 1 - margin + SLACK - origin
    if (high < low).any():
        return np.zeros(0, np.intp), np.zeros(0), np.zeros(0)
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    reach = (corners @ np.linalg.inv(basis))[:, 1]
    rows = np.arange(np.floor(reach.min()), np.ceil(reach.max()) + 1)
    first, last = np.full(rows.shape, -np.inf), np.full(rows.shape, np.inf)
    for axis in (0, 1):  # low <= q * along + r * across <= high, a pair of bounds on q for each axis
        along, start = basis[0, axis], rows * basis[1, axis]
        if abs(along) > SLACK:
            ends = np.sort([(low[axis] - start) / along, (high[axis] - start) / along], axis=0)
            first, last = np.maximum(first, ends[0]), np.minimum(last, ends[1])
        else:
            last = np.where((start >= low[axis]) & (start <= high[axis]), last, -np.inf)
    some = np.ceil(first) <= np.floor(last)
    return rows[some].astype(np.intp), np.ceil(first[some]), np.floor(last[some])


def _largest_box(first: NDArray[np.float64], last: NDArray[np.float64], step: float) -> tuple[int, int]:
    """Return the range of rows ``top:bottom`` whose common columns make the most view pixels."""
    best, box = 0, (0, 0)
    for top in range(len(first)):
        if best >= (len(first) - top) * _count(float(first.min()), float(last.max()), step):
            break  # fewer rows than this cannot win any more
        left, right = np.maximum.accumulate(first[top:]), np.minimum.accumulate(last[top:])
        columns = np.where(right >= left - SLACK, np.floor((right - left) / step + SLACK) + 1, 0)
        areas = columns * np.arange(1, len(columns) + 1)
        k = int(np.argmax(areas))
        if areas[k] > best:
            best, box = int(areas[k]), (top, top + k + 1)
    return box
