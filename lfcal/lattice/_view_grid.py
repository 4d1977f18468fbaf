"""Where the samples of a view lie on the frame, and which lenslets make them: the one home of both."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lfcal.base import check_choice
from lfcal.lattice._view_kernels import largest_box
from lfcal.lattice.micro_images import MicroImageLattice

__all__ = ["AXES", "Cells", "ViewGrid", "cells_between", "cells_in_rows", "view_grid"]

Array = NDArray[np.float64]

SNAP = 1e-5
"""A sample this close to a lenslet (pitches) is that lenslet's: rounding must not draw in one that may lie outside."""

SQUARE = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
"""Corners (q, r) of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Lenslets, and which of them make which sample.

    Attributes
    ----------
    lenslets
        ``(n, 2)``: indices (q, r), in the order in which rows of samples need them first.
    near, share
        ``(rows, columns, k)``: a sample's lenslets by their number, and their shares (sum 1).
    """

    lenslets: NDArray[np.intp] = field(repr=False)
    near: NDArray[np.int32] = field(repr=False)
    share: Array = field(repr=False)

    @classmethod
    def none(cls) -> Cells:
        """Return the cells of no samples."""
        return cls(np.zeros((0, 2), np.intp), np.zeros((0, 0, 1), np.int32), np.zeros((0, 0, 1)))

    def cut(self, share: Array, part: tuple[slice, slice]) -> tuple[NDArray[np.bool_], NDArray[np.int32], Array]:
        """Return for a part of the samples, with other shares: which lenslets have one, and `near` and `share`."""
        near, left = self.near[part], np.ascontiguousarray(share[part])
        used = np.zeros(len(self.lenslets), np.bool_)
        used[near[left > 0]] = True
        number = np.cumsum(used, dtype=np.int32) - np.int32(1)
        # what counts for nothing may be any number that exists
        return used, np.maximum(number[near], 0), left


def cells_between(kind: str, place: Array) -> Cells:
    """Return the cells about fractional indices ``place`` ``(rows, columns, 2)`` as (q, r).

    Square: the four corners of a cell, bilinear. Hexagonal: the three of the triangle, by barycentric coordinates; the
    cell's short diagonal, from (1, 0) to (0, 1), parts it into two.
    """
    base = np.floor(place + SNAP)
    q, r = np.moveaxis(np.where(np.abs(place - base) < SNAP, 0.0, place - base), -1, 0)
    corner = base.astype(np.intp)[..., None, :]
    if kind == "square":
        index = corner + SQUARE
        share = np.stack([(1 - q) * (1 - r), q * (1 - r), (1 - q) * r, q * r], axis=-1)
    else:
        upper = (q + r > 1)[..., None]
        # the third corner lies at (0, 0) or, beyond the diagonal, at (1, 1)
        index = np.concatenate([corner + upper[..., None], corner + SQUARE[1:3]], axis=-2)
        lower = np.stack([1 - q - r, q, r], axis=-1)
        share = np.where(upper, np.stack([q + r - 1, 1 - r, 1 - q], axis=-1), lower)
    share[share < SNAP] = 0.0
    share /= share.sum(-1, keepdims=True)
    return Cells(*_numbered(index), share)


def _numbered(index: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Return the different lenslets ``(n, 2)`` as they come first, and the number of each of ``index``."""
    low = index.min((0, 1, 2))
    span = int(index[..., 1].max() - low[1]) + 1
    code = (index[..., 0] - low[0]) * span + (index[..., 1] - low[1])
    different, first, number = np.unique(code, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int32)
    rank[order] = np.arange(len(order), dtype=np.int32)
    lenslets = np.stack(np.divmod(different[order], span), axis=-1) + low
    return lenslets, rank[number].reshape(index.shape[:-1])


def cells_in_rows(rows: NDArray[np.intp], columns: Array, lean: float) -> Cells:
    """Return the cells of samples at ``columns`` of lattice rows ``rows``, made of neighbours in their row.

    ``columns`` count pitches along the rows; lenslet (q, r) lies at ``q + lean r``.
    """
    place = columns[None, :] - lean * rows[:, None]
    left = np.floor(place + SNAP)
    between = place - left
    between[np.abs(between) < SNAP] = 0.0
    first = left[:, :1]
    most = 2 if between.any() else 1
    count = int((left[:, -1] - first[:, 0]).max()) + most
    q = (first.astype(np.intp) + np.arange(count)).ravel()
    lenslets = np.stack([q, np.repeat(rows, count)], axis=-1)
    near = (left - first + count * np.arange(len(rows))[:, None]).astype(np.int32)
    if most == 1:
        return Cells(lenslets, near[..., None], np.ones((*near.shape, 1)))
    return Cells(lenslets, np.stack([near, near + 1], axis=-1), np.stack([1 - between, between], axis=-1))


Box = tuple[int, int, int, int]

AXES = ("frame", "lattice")
"""Along what the rows and columns of a view run."""

EDGE_TOLERANCE_PX = 1e-6
"""A lenslet this close to the limit is inside: whole-pixel lattices touch it exactly (pixels)."""

MIN_SHARE = 0.5 - 1e-9
"""A sample is seen where the lenslets that are there have this share of it."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewGrid:
    """The samples of a view: rows and columns at equal steps, each made of one to four lenslets.

    Attributes
    ----------
    centres_px
        ``(n, 2)``: centres (row, column) of the lenslets used, about in the order of the rows (pixels).
    near
        ``(rows, columns, k)``: the lenslets of each sample, by their number.
    share
        ``(rows, columns, k)``: what they count for; their sum is 1, or 0 where nothing is seen.
    corner_px
        Place (row, column) of sample (0, 0) on the frame, which need not hold a lenslet (pixels).
    step_px
        Distance of samples down and to the right in the view (pixels).
    rotation_rad
        Angle from the frame's +x axis to the rows of a view, positive downwards: 0 for axes of the frame (rad).
    field_shape
        Rows and columns of the whole field: the smallest box about every lenslet whose micro-image is inside.
    kept
        Share of the field's samples that this grid has.
    """

    centres_px: Array = field(repr=False)
    near: NDArray[np.int32] = field(repr=False)
    share: Array = field(repr=False)
    corner_px: tuple[float, float]
    step_px: tuple[float, float]
    rotation_rad: float
    field_shape: tuple[int, int]
    kept: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of a view."""
        return self.near.shape[0], self.near.shape[1]

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Samples that some lenslet sees, ``(rows, columns)``."""
        return np.asarray((self.share > 0).any(-1), np.bool_)

    def described(self) -> str:
        """Return the size in words, and what of the field is left out."""
        (rows, columns), (high, wide) = self.shape, self.field_shape
        return f"{rows} x {columns} of {high} x {wide} samples, {100 * self.kept:.1f} % of the field"


def view_grid(
    lattice: MicroImageLattice,
    shape: tuple[int, ...],
    margin: float,
    *,
    axes: str = "frame",
    full: bool = False,
    missing: Iterable[tuple[int, int]] = (),
    raster: MicroImageLattice | None = None,
) -> ViewGrid:
    """Return the grid of samples seen by lenslets that have ``margin`` pixels of frame about their centres.

    A sample is seen where such lenslets have at least half a share in it; they take over what the others would have.

    Parameters
    ----------
    lattice
        Where the micro-images lie.
    shape
        Rows and columns of the frame.
    margin
        Least distance of a lenslet's centre from the frame's outermost pixel centres (pixels).
    axes
        ``"frame"``: rows and columns run along the frame's, so that views look like the picture at any angle of the
        lattice; a sample between lenslets is interpolated between the four (hexagonal: three) around it, in lattice
        indices, so along a distorted lattice as well. ``"lattice"``: rows are lattice rows, turned with the lattice;
        a square lattice's samples are its lenslets, those of a hexagonal one lie between two of their row.
    full
        False: the largest box of samples that are seen. True: the whole field, with every lenslet inside, and a mask
        of what is seen (`ViewGrid.mask`).
    missing
        Lenslets (q, r) that show nothing. The box is not made smaller by them: their samples are masked.
    raster
        Lattice whose steps and place the samples along the frame's axes take, by default ``lattice`` itself: so the
        views of single lens types lie on the same places. Samples along the lattice's axes are ``lattice``'s own.

    Returns
    -------
    ViewGrid
        Empty where no lenslet fits. One sample lies on the lenslet nearest to the frame's centre; steps are the row
        pitch (hexagonal), or pitch and row pitch.

    Examples
    --------
    >>> from lfcal.camera import preset
    >>> from lfcal.lattice import ViewGrid, lattice_of, view_grid
    >>> lattice = lattice_of(preset("bench"))
    >>> grid: ViewGrid = view_grid(lattice, lattice.shape, margin=5.0)
    >>> print(grid.described(), [round(step, 2) for step in grid.step_px])
    33 x 33 of 33 x 33 samples, 100.0 % of the field [9.53, 9.53]
    """
    check_choice("axes of the views", axes, AXES)
    size = (int(shape[0]), int(shape[1]))
    if axes == "frame":
        cells, corner, step, turn = _frame_places(lattice, raster or lattice, size, margin)
    else:
        cells, corner, step, turn = _lattice_places(lattice, size, margin)
    if not cells.near.size:
        return ViewGrid(np.zeros((0, 2)), cells.near, cells.share, corner, step, turn, (0, 0), 0.0)
    centres = lattice.centres_px(*cells.lenslets.T)
    inside = _inside(centres, size, margin)
    seen = (cells.share * inside[cells.near]).sum(-1) >= MIN_SHARE
    share = _shares(cells, inside & ~_among(cells.lenslets, missing))
    field_box = _around(seen)
    top, bottom, left, right = field_box if full else largest_box(seen)
    part = slice(top, bottom), slice(left, right)
    kept = int(seen[part].sum()) / max(int(seen.sum()), 1)
    down, along = np.array([math.cos(turn), -math.sin(turn)]), np.array([math.sin(turn), math.cos(turn)])
    begin = np.array(corner) + top * step[0] * down + left * step[1] * along
    used, near, share = cells.cut(share, part)
    return ViewGrid(
        centres[used],
        near,
        share,
        (float(begin[0]), float(begin[1])),
        step,
        turn,
        (field_box[1] - field_box[0], field_box[3] - field_box[2]),
        kept,
    )


Places = tuple[Cells, tuple[float, float], tuple[float, float], float]


def _frame_places(
    lattice: MicroImageLattice, raster: MicroImageLattice, shape: tuple[int, int], margin: float
) -> Places:
    """Return the cells about the samples of an upright raster, its corner, steps and angle."""
    step = _steps(raster)
    middle = np.rint(raster.lenslet_at((shape[0] - 1) / 2, (shape[1] - 1) / 2))
    anchor = raster.centres_px(middle[0], middle[1])
    axes = []
    for n, distance, place in zip(shape, step, anchor, strict=True):
        low = math.ceil((margin - EDGE_TOLERANCE_PX - place) / distance)
        high = math.floor((n - 1 - margin + EDGE_TOLERANCE_PX - place) / distance)
        axes.append(place + distance * np.arange(low, high + 1))
    rows, columns = axes
    if not rows.size or not columns.size:
        return Cells.none(), (0.0, 0.0), step, 0.0
    cells = cells_between(lattice.kind, lattice.lenslet_at(rows[:, None], columns[None, :]))
    return cells, (float(rows[0]), float(columns[0])), step, 0.0


def _steps(lattice: MicroImageLattice) -> tuple[float, float]:
    """Return the steps down and right of upright samples: square ones of the row pitch where hexagonal."""
    if lattice.kind == "hexagonal":
        return lattice.row_pitch_px, lattice.row_pitch_px
    # a square lattice's pitches may differ: rows that run nearer the frame's columns swap them
    swapped = round(lattice.rotation_rad / (math.pi / 2)) % 2
    pair = (lattice.row_pitch_px, lattice.pitch_px)
    return pair[::-1] if swapped else pair


def _lattice_places(lattice: MicroImageLattice, shape: tuple[int, int], margin: float) -> Places:
    """Return the cells about the samples along the lattice's own rows, and their corner, steps and angle."""
    hexagonal = lattice.kind == "hexagonal"
    lean, step = (0.5, lattice.row_pitch_px / lattice.pitch_px) if hexagonal else (0.0, 1.0)
    distance = (lattice.row_pitch_px, step * lattice.pitch_px)
    high, wide = shape[0] - 1 - margin + EDGE_TOLERANCE_PX, shape[1] - 1 - margin + EDGE_TOLERANCE_PX
    if high < margin - EDGE_TOLERANCE_PX or wide < margin - EDGE_TOLERANCE_PX:
        return Cells.none(), (0.0, 0.0), distance, lattice.rotation_rad
    # the frame's border bounds the indices, whatever the distortion; one to spare for what lies between these points
    y, x = (np.linspace(margin, end, 65) for end in (high, wide))
    ends = [lattice.lenslet_at(y, margin), lattice.lenslet_at(y, wide), lattice.lenslet_at(margin, x)]
    q, r = np.concatenate([*ends, lattice.lenslet_at(high, x)]).T
    rows = np.arange(math.floor(r.min()) - 1, math.ceil(r.max()) + 2)
    along = q + lean * r
    first = math.floor(along.min() / step) - 1
    columns = step * np.arange(first, math.ceil(along.max() / step) + 2)
    cells = cells_in_rows(rows, columns, lean)
    corner = lattice.centres_px(columns[0] - lean * rows[0], rows[0])
    return cells, (float(corner[0]), float(corner[1])), distance, lattice.rotation_rad


def _inside(centres: Array, shape: tuple[int, int], margin: float) -> NDArray[np.bool_]:
    """Return which micro-images lie inside the frame, ``(n,)``."""
    far = np.array(shape) - 1 - margin + EDGE_TOLERANCE_PX
    y, x = centres[..., 0], centres[..., 1]
    inside: NDArray[np.bool_] = (
        (y >= margin - EDGE_TOLERANCE_PX) & (y <= far[0]) & (x >= margin - EDGE_TOLERANCE_PX) & (x <= far[1])
    )
    return inside


def _among(lenslets: NDArray[np.intp], missing: Iterable[tuple[int, int]]) -> NDArray[np.bool_]:
    """Return which lenslets are missing, ``(n,)``."""
    lost = np.array(list(missing), np.intp).reshape(-1, 2)
    if not len(lost) or not lenslets.size:
        return np.zeros(1, np.bool_)
    span = int(np.abs(lenslets).max()) + 1
    lost = lost[(np.abs(lost) < span).all(1)]
    found: NDArray[np.bool_] = np.isin(lenslets @ np.array([2 * span, 1]), lost @ np.array([2 * span, 1]))
    return found


def _shares(cells: Cells, present: NDArray[np.bool_]) -> Array:
    """Return the shares of the lenslets that are ``present``, their sum 1, or 0 where they are less than half."""
    share = cells.share * present[cells.near]
    total = share.sum(-1, keepdims=True)
    enough = total >= MIN_SHARE
    result: Array = np.divide(share, total, out=np.zeros_like(share), where=enough)
    return result


def _around(seen: NDArray[np.bool_]) -> Box:
    """Return the smallest box about all true values."""
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    if not rows.size:
        return 0, 0, 0, 0
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
