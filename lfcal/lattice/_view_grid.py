"""Positions of the samples of a view on the frame, and the lenslets that contribute to them."""

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
"""Distance (pitches) below which a sample belongs to a lenslet alone: rounding must not add one outside the frame."""

SQUARE = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
"""Corners (q, r) of a cell."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Lenslets, and their contributions to samples.

    Attributes
    ----------
    lenslets
        ``(n, 2)``: indices (q, r), in the order in which rows of samples first need them.
    near, share
        ``(rows, columns, k)``: indices into `lenslets` of the lenslets of each sample, and their weights (sum 1).
    """

    lenslets: NDArray[np.intp] = field(repr=False)
    near: NDArray[np.int32] = field(repr=False)
    share: Array = field(repr=False)

    @classmethod
    def none(cls) -> Cells:
        """Return the contributions for no samples."""
        return cls(np.zeros((0, 2), np.intp), np.zeros((0, 0, 1), np.int32), np.zeros((0, 0, 1)))

    def cut(self, share: Array, part: tuple[slice, slice]) -> tuple[NDArray[np.bool_], NDArray[np.int32], Array]:
        """Return which lenslets have a share in a part of the samples, and `near` and `share` of this part.

        ``share`` ``(rows, columns, k)`` is used instead of the attribute.
        """
        near, left = self.near[part], np.ascontiguousarray(share[part])
        used = np.zeros(len(self.lenslets), np.bool_)
        used[near[left > 0]] = True
        number = np.cumsum(used, dtype=np.int32) - np.int32(1)
        # lenslets without a share may have any valid number
        return used, np.maximum(number[near], 0), left


def cells_between(kind: str, place: Array) -> Cells:
    """Return the contributions at fractional indices ``place`` ``(rows, columns, 2)`` as (q, r).

    Square lattice: the four corners of a cell, bilinear. Hexagonal lattice: the three corners of a triangle, by
    barycentric coordinates; the cell's short diagonal, from (1, 0) to (0, 1), divides it into two triangles.
    """
    base = np.floor(place + SNAP)
    q, r = np.moveaxis(np.where(np.abs(place - base) < SNAP, 0.0, place - base), -1, 0)
    corner = base.astype(np.intp)[..., None, :]
    if kind == "square":
        index = corner + SQUARE
        share = np.stack([(1 - q) * (1 - r), q * (1 - r), (1 - q) * r, q * r], axis=-1)
    else:
        upper = (q + r > 1)[..., None]
        # the third corner is (0, 0) or, beyond the diagonal, (1, 1)
        index = np.concatenate([corner + upper[..., None], corner + SQUARE[1:3]], axis=-2)
        lower = np.stack([1 - q - r, q, r], axis=-1)
        share = np.where(upper, np.stack([q + r - 1, 1 - r, 1 - q], axis=-1), lower)
    share[share < SNAP] = 0.0
    share /= share.sum(-1, keepdims=True)
    return Cells(*_numbered(index), share)


def _numbered(index: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
    """Return the distinct lenslets ``(n, 2)`` in order of appearance, and the number of each of ``index``."""
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
    """Return the contributions for samples at ``columns`` of lattice rows ``rows``, from neighbours in their row.

    ``columns`` are in pitches along the rows; lenslet (q, r) is at ``q + lean r``.
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
"""Directions of the rows and columns of a view."""

EDGE_TOLERANCE_PX = 1e-6
"""Tolerance (pixels) for lenslets at the limit, which the lenslets of whole-pixel lattices touch exactly."""

MIN_SHARE = 0.5 - 1e-9
"""Smallest total fraction of existing lenslets for a sample to be seen."""


@dataclass(frozen=True, slots=True, eq=False)
class ViewGrid:
    """Regular grid of the samples of a view, to each of which one to four lenslets contribute.

    Attributes
    ----------
    centres_px
        Centres (row, column) of the n contributing lenslets (px), ``(n, 2)``, approximately in row-major order.
    near
        Indices into `centres_px` of the lenslets that contribute to each sample, ``(rows, columns, k)``.
    share
        Weights of these lenslets, ``(rows, columns, k)``, with a sum of 1 for each sample, or 0 if no lenslet sees the
        sample.
    corner_px
        Position (row, column) of sample (0, 0) on the frame (px), which may be between lenslets.
    step_px
        Spacing of the samples, down and to the right in the view (px).
    rotation_rad
        Angle (rad) from the +x axis of the frame to the rows of the view, positive downwards; 0 if they are parallel.
    field_shape
        Number of rows and columns of the complete field: the smallest box around all lenslets whose micro-image is
        inside the frame.
    kept
        Fraction of the samples of the complete field that this grid contains.
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
        """Shape ``(rows, columns)`` of a view (samples)."""
        return self.near.shape[0], self.near.shape[1]

    @property
    def mask(self) -> NDArray[np.bool_]:
        """Boolean mask of the samples that at least one lenslet sees, ``(rows, columns)``."""
        return np.asarray((self.share > 0).any(-1), np.bool_)

    def described(self) -> str:
        """Return a text that states the size of the view and the fraction of the field that it contains."""
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
    """Return the grid of view samples for the lenslets whose centres are at least ``margin`` px inside the frame.

    A sample counts as seen if such lenslets have at least half of its interpolation weight; their weights are then
    scaled to a sum of 1.

    Parameters
    ----------
    lattice
        Lattice of the micro-images.
    shape
        Shape ``(rows, columns)`` of the frame (px).
    margin
        Minimum distance (px) of the centre of a lenslet from the outermost pixel centres of the frame.
    axes
        ``"frame"``: rows and columns are parallel to those of the frame, so that views have the orientation of the
        frame at any angle of the lattice. A sample between lenslets is interpolated in lattice indices from the four
        (hexagonal: three) lenslets around it, also for a distorted lattice. ``"lattice"``: rows are those of the
        lattice. The samples of a square lattice are its lenslets. Those of a hexagonal lattice are between two lenslets
        of their row.
    full
        False: return the largest box that contains only seen samples. True: return the complete field, with a mask of
        the seen samples (`ViewGrid.mask`).
    missing
        Lenslets (q, r) without light, which do not reduce the box; samples that need them are masked.
    raster
        Lattice that defines the positions of the samples if ``axes`` is ``"frame"``. None: ``lattice``. With a common
        raster, views of different lens types have the same sample positions.

    Returns
    -------
    ViewGrid
        Grid of the samples, which is empty if no lenslet is far enough inside the frame. One sample is at the lenslet
        nearest to the centre of the frame. For a hexagonal lattice, both steps are the row pitch; for a square one,
        they are the pitch and the row pitch.

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
    """Return the contributions to the samples of an upright raster, and its corner, steps and angle."""
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
    """Return the steps down and right of upright samples; square ones of the row pitch for a hexagonal lattice."""
    if lattice.kind == "hexagonal":
        return lattice.row_pitch_px, lattice.row_pitch_px
    # a square lattice's pitches may differ: rows closer to the direction of the frame's columns swap them
    swapped = round(lattice.rotation_rad / (math.pi / 2)) % 2
    pair = (lattice.row_pitch_px, lattice.pitch_px)
    return pair[::-1] if swapped else pair


def _lattice_places(lattice: MicroImageLattice, shape: tuple[int, int], margin: float) -> Places:
    """Return the contributions to samples along the lattice's rows, and their corner, steps and angle."""
    hexagonal = lattice.kind == "hexagonal"
    lean, step = (0.5, lattice.row_pitch_px / lattice.pitch_px) if hexagonal else (0.0, 1.0)
    distance = (lattice.row_pitch_px, step * lattice.pitch_px)
    high, wide = shape[0] - 1 - margin + EDGE_TOLERANCE_PX, shape[1] - 1 - margin + EDGE_TOLERANCE_PX
    if high < margin - EDGE_TOLERANCE_PX or wide < margin - EDGE_TOLERANCE_PX:
        return Cells.none(), (0.0, 0.0), distance, lattice.rotation_rad
    # the frame's border bounds the indices for any distortion, with a margin of one between these points
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
    """Return which micro-images are inside the frame, ``(n,)``."""
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
    """Return the fractions of the lenslets that are ``present``, with sum 1, or 0 if they are less than half."""
    share = cells.share * present[cells.near]
    total = share.sum(-1, keepdims=True)
    enough = total >= MIN_SHARE
    result: Array = np.divide(share, total, out=np.zeros_like(share), where=enough)
    return result


def _around(seen: NDArray[np.bool_]) -> Box:
    """Return the smallest box that contains all true values."""
    rows, columns = np.flatnonzero(seen.any(1)), np.flatnonzero(seen.any(0))
    if not rows.size:
        return 0, 0, 0, 0
    return int(rows[0]), int(rows[-1]) + 1, int(columns[0]), int(columns[-1]) + 1
