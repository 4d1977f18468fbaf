"""How the micro-images of a white image depart from straight rows, and from the lattice fitted. No Qt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.lattice import LatticeFit

__all__ = ["DISTORTION", "RESIDUALS", "LatticeMap", "distortion_map", "lattice_words", "residual_map"]

DISTORTION, RESIDUALS = "distortion", "residuals"
CELLS = 24
"""Cells along the longer side."""
REACH = 0.9
"""Length of the longest arrow, in cells."""
HEAD = 0.3
"""Length of an arrow's head over that of the arrow."""


@dataclass(frozen=True, eq=False)
class LatticeMap:
    """Displacements on a grid over the frame.

    Attributes
    ----------
    size
        ``(rows, columns)``: how far (pixels); NaN where no lenslet was placed.
    arrows
        ``(2 n, 2)``: ends (row, column) of line segments, pair after pair, in pixels of the frame.
    cell
        Side of a cell (pixels).
    gain
        By how much the arrows are drawn too long.
    """

    size: NDArray[np.float64]
    arrows: NDArray[np.float64]
    cell: float
    gain: float

    @property
    def largest(self) -> float:
        """Largest displacement (pixels); 0 where there is none."""
        return float(np.nanmax(self.size)) if np.isfinite(self.size).any() else 0.0


def residual_map(fit: LatticeFit) -> LatticeMap:
    """Return what the micro-images of each cell together depart from the lattice fitted."""
    return _map(fit.residual_map(CELLS), max(fit.shape) / CELLS)


def distortion_map(fit: LatticeFit) -> LatticeMap | None:
    """Return how far from the straight lattice micro-images are seen; None where the lattice is straight."""
    if fit.distortion is None:
        return None
    cell = max(fit.shape) / CELLS
    rows, columns = (np.arange(max(1, -(-n // cell))) for n in fit.shape)
    seen = np.stack(np.meshgrid((columns + 0.5) * cell, (rows + 0.5) * cell), axis=-1)
    bent = fit.distortion.displacement(fit.distortion.invert(seen))
    return _map(np.stack([bent[..., 1], bent[..., 0]]), cell)


def _map(shift: NDArray[np.float64], cell: float) -> LatticeMap:
    """Return the map of displacements ``(2, rows, columns)`` (row, column)."""
    size = np.hypot(*shift)
    known = np.isfinite(size)
    longest = float(size[known].max()) if known.any() else 0.0
    gain = REACH * cell / longest if longest > 0 else 1.0
    place = (np.argwhere(known) + 0.5) * cell
    step = gain * shift[:, known].T
    start, end = place - step / 2, place + step / 2
    side = np.stack([-step[:, 1], step[:, 0]], axis=-1)
    barbs = [end - HEAD * (step + sign * side / 2) for sign in (-1, 1)]
    arrows = np.stack([start, end, end, barbs[0], end, barbs[1]], axis=1).reshape(-1, 2)
    return LatticeMap(size, arrows, cell, gain)


def lattice_words(fit: LatticeFit) -> str:
    """Return which lattice was chosen and why, and what is doubtful of the frame, a line each."""
    dead = int(fit.dead.sum())
    count = f"{len(fit.index)} lenslets{f', {dead} of them dead' if dead else ''}"
    lines = [f"Lattice {fit.reason or fit.form}. {count}, {fit.residual_rms_px:.3f} px rms off it."]
    return "\n".join([*lines, *(f"Doubtful: {note}" for note in fit.notes)])
