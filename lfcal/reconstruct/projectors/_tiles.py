"""Overlap-save tiles on the coarse lattice, with the Fourier transform of a tile as a small matrix."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.reconstruct.projectors.grid import Grid

__all__ = ["AxisTiles", "TilePlan"]


@dataclass(frozen=True)
class AxisTiles:
    """Tiles along one axis of the lattice.

    Attributes
    ----------
    cells
        Lattice cells to cover.
    reach
        Reach of a pattern to either side, in cells.
    count
        Number of tiles; a single tile needs zero padding on only one side.
    half
        Whether only the non-negative half of the spectrum is kept (real data).
    """

    cells: int
    reach: int
    count: int
    half: bool = False

    @property
    def valid(self) -> int:
        """Number of valid cells per tile."""
        return -(-self.cells // self.count)

    @property
    def lead(self) -> int:
        """Number of cells before the first valid one in a tile."""
        return self.reach if self.count > 1 else 0

    @property
    def length(self) -> int:
        """Length of the circular transform."""
        return self.valid + (2 * self.reach if self.count > 1 else self.reach)

    @property
    def taken(self) -> int:
        """Number of cells that a tile reads."""
        return self.length if self.count > 1 else self.cells

    @property
    def frequencies(self) -> int:
        """Number of frequencies that are kept."""
        return self.length // 2 + 1 if self.half else self.length

    @property
    def padded(self) -> int:
        """Cells of the padded lattice from which all tiles read: `lead` cells before, the rest after."""
        return (self.count - 1) * self.valid + self.taken

    def _phase(self, cells: NDArray[np.intp]) -> NDArray[np.complex128]:
        # reduce the product before multiplying by 2*pi, so that the phase is exact for every size.
        turns = np.outer(np.arange(self.frequencies), cells) % self.length
        phase: NDArray[np.complex128] = np.exp(-2j * np.pi * turns / self.length)
        return phase

    def analysis(self) -> NDArray[np.complex128]:
        """Return the transform of a tile's cells, ``(frequencies, taken)``."""
        return self._phase(np.arange(self.taken))

    def synthesis(self) -> NDArray[np.complex128]:
        """Return the inverse transform to the valid cells, ``(valid, frequencies)``; if `half`, use its real part."""
        weights = np.full(self.frequencies, 2.0 if self.half else 1.0)
        if self.half:
            # frequencies at both ends of a real spectrum have no mirror image and count once
            weights[0] = 1.0
            if self.length % 2 == 0:
                weights[-1] = 1.0
        phase = self._phase(np.arange(self.valid) + self.lead)
        inverse: NDArray[np.complex128] = phase.conj().T * (weights / self.length)
        return inverse

    def kernel(self) -> NDArray[np.complex128]:
        """Return the transform of taps ``-reach … reach``, ``(frequencies, 2*reach + 1)``."""
        return self._phase(np.arange(-self.reach, self.reach + 1))


@dataclass(frozen=True)
class TilePlan:
    """Tiles along both axes of a `Grid`'s lattice."""

    grid: Grid
    counts: tuple[int, int]

    @cached_property
    def y(self) -> AxisTiles:
        """Tiles along the rows."""
        return AxisTiles(self.grid.cells[0], self.grid.reach[0], self.counts[0])

    @cached_property
    def x(self) -> AxisTiles:
        """Tiles along the columns, whose spectrum is halved."""
        return AxisTiles(self.grid.cells[1], self.grid.reach[1], self.counts[1], half=True)

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return self.counts[0] * self.counts[1]

    @property
    def frequencies(self) -> int:
        """Number of frequencies of a tile."""
        return self.y.frequencies * self.x.frequencies

    def product_flops(self, pixels: int) -> float:
        """Return the real operations of the matrix products at all frequencies, for ``pixels`` selected phases."""
        return 8.0 * self.frequencies * self.tiles * self.grid.phases * pixels

    def transform_flops(self, phases: int) -> float:
        """Return the real operations of the forward transform of ``phases`` components; the inverse takes as many."""
        y, x = self.y, self.x
        along_x = x.count * x.frequencies * x.taken * y.padded
        along_y = y.count * x.count * x.frequencies * y.frequencies * y.taken
        return 8.0 * phases * (along_x + along_y)

    def spectrum_bytes(self, itemsize: int, pixels: int) -> int:
        """Return the size of one plane's spectra (bytes), with complex numbers of ``itemsize`` bytes."""
        return self.frequencies * self.grid.phases * pixels * itemsize

    def scratch_bytes(self, itemsize: int) -> int:
        """Return the size of the tiles' spectra during the projection of one plane, in three buffers (bytes)."""
        y, x = self.y, self.x
        slabs = x.count * x.frequencies * (y.padded + y.count * y.valid)
        spectra = 2 * self.frequencies * self.tiles
        return (slabs + spectra + y.padded * x.padded) * self.grid.phases * itemsize

    def matrices(self, dtype: Any) -> dict[str, NDArray[Any]]:
        """Return the small transform matrices of both axes as ``dtype``."""
        axes = {"y": self.y, "x": self.x}
        kinds = ("analysis", "synthesis", "kernel")
        return {f"{kind}_{name}": getattr(axis, kind)().astype(dtype) for name, axis in axes.items() for kind in kinds}
