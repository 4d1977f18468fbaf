"""Projection of H within a tolerance: interpolated between few patterns, corrected entry by entry."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors._direct import Direct
from lfcal.reconstruct.projectors._planes import trim
from lfcal.reconstruct.projectors._reduction import (
    SPACINGS,
    Nodes,
    quickest_spacing,
    reduce_plane,
    relative_work,
    sampled_share,
)
from lfcal.reconstruct.projectors._sparse import Sparse, SparseOperand
from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["Reduced", "ReducedOperand"]

Array = NDArray[Any]


@dataclass(frozen=True, slots=True)
class ReducedOperand:
    """One plane of H: patterns at nodes and additional entries, or all patterns if ``rest`` is None.

    ``error`` is the largest omitted fraction of a pattern, over all positions.
    """

    patterns: Array
    rest: SparseOperand | None
    spacing: float
    error: float


class Reduced:
    """Project a plane with few patterns, for weighted sums of sources, plus sparse corrections.

    |(H - Hs) g|_1 is at most ``tolerance`` times the sum of g_v |H_v|_1 over all voxels v, for any non-negative g. Hs
    is the projected operator, forward and back. A plane that no spacing of nodes makes faster is projected completely.

    Parameters
    ----------
    grid, dtype, workers, phases
        As in `lfcal.reconstruct.projectors._direct.Direct`.
    tolerance
        Largest fraction of a pattern (L1) that is omitted.
    work
        Function that returns the cost of one projection for a spacing of nodes and a fraction of kept entries. Each
        plane uses the spacing with the lowest cost.
    """

    name = "reduced"
    any_phases = False

    def __init__(
        self,
        grid: Grid,
        dtype: np.dtype[Any],
        workers: int | None = None,
        phases: NDArray[np.bool_] | None = None,
        *,
        tolerance: float,
        work: Callable[[float, float], float] = relative_work,
    ) -> None:
        self.grid, self.dtype, self.phases = grid, dtype, phases
        self.tolerance, self.work = tolerance, work
        self.whole = Direct(grid, dtype, workers, phases)
        self.workers, self.rounding = self.whole.workers, self.whole.rounding
        # positions beyond the last nodes belong to the nodes of one more cell
        ny, nx = grid.period
        self.wide = replace(grid, image_shape=(grid.image_shape[0] + ny, grid.image_shape[1] + nx))

    def prepare(self, plane: Array) -> ReducedOperand:
        """Return the fastest operand of one plane of H, ``(ny, nx, nt, ns)``."""
        spacing = self._quickest(plane)
        if spacing == 1:
            return ReducedOperand(trim(plane), None, 1.0, 0.0)
        found = reduce_plane(plane, spacing, self.tolerance, self.workers)
        rest = self._entries_engine(spacing).prepare(found.rest)
        return ReducedOperand(trim(found.patterns), rest, spacing, float(found.error.max()))

    def _quickest(self, plane: Array) -> float:
        """Return the fastest spacing for a plane, determined from some of its positions."""
        period, tolerance = self.grid.period, self.tolerance
        kept = {g: sampled_share(lambda y, x: plane[y, x], period, g, tolerance) for g in SPACINGS}
        return quickest_spacing(kept, self.work)

    def operand_bytes(self, operand: ReducedOperand) -> int:
        """Return the size of patterns and entries (bytes)."""
        rest = 0 if operand.rest is None else self._entries_engine(operand.spacing).operand_bytes(operand.rest)
        return self.whole.operand_bytes(operand.patterns) + rest

    # -- the pair --------------------------------------------------------------------------------------
    def forward(self, planes: Iterable[tuple[ReducedOperand, Array]]) -> Array:
        """Return the image of a volume, given as pairs (operand, volume plane)."""
        total = np.zeros(self.grid.image_shape, self.dtype)
        for operand, plane in planes:
            if operand.rest is None:
                total += self.whole.forward([(operand.patterns, plane)])
                continue
            nodes, between = self._nodes(operand)
            sources = nodes.collected(self.wide.pack(self._widened(plane), self.dtype))
            total += self._cropped(between.image_of(operand.patterns, sources))
            total += self._entries_engine(operand.spacing).forward([(operand.rest, plane)])
        return total if self.whole.mask is None else total * self.whole.mask

    def adjoint(self, image: Array, operands: Iterable[ReducedOperand]) -> Iterator[Array]:
        """Yield the back projection of ``image`` for each operand."""
        masked = image if self.whole.mask is None else image * self.whole.mask
        for operand in operands:
            if operand.rest is None:
                yield from self.whole.adjoint(image, [operand.patterns])
                continue
            nodes, between = self._nodes(operand)
            values = between.cells_of(operand.patterns, self._widened(masked))
            plane = self._cropped(self.wide.unpack(nodes.spread(values, self.wide.cells)))
            (rest,) = self._entries_engine(operand.spacing).adjoint(image, [operand.rest])
            yield plane + rest

    # -- steps -----------------------------------------------------------------------------------------
    def _nodes(self, operand: ReducedOperand) -> tuple[Nodes, Direct]:
        nodes = Nodes.of(self.grid.period, operand.spacing)
        return nodes, Direct(self.wide, self.dtype, self.workers, self.phases, nodes)

    def _entries_engine(self, spacing: float) -> Sparse:
        """Return the engine for the entries that are not interpolated from nodes; their cutouts are wider."""
        cutout = Nodes.of(self.grid.period, spacing).widened(self.grid.cutout)
        return Sparse(replace(self.grid, cutout=cutout), self.dtype, self.workers, self.phases)

    def _widened(self, plane: Array) -> Array:
        """Return an image or volume plane with a period of zeros below and to the right."""
        ny, nx = self.grid.period
        return np.pad(plane, ((0, ny), (0, nx)))

    def _cropped(self, wide: Array) -> Array:
        height, width = self.grid.image_shape
        return wide[:height, :width]
