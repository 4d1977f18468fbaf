"""Planes of H that hold no light: nothing can be reconstructed with them."""

from __future__ import annotations

from lfcal.psf.matrix import PSFMatrix

__all__ = ["dark_planes"]


def dark_planes(matrix: PSFMatrix) -> tuple[int, ...]:
    """Return the depth planes whose entries sum to zero or less; a file's own depth sums are believed."""
    return tuple(z for z in range(len(matrix)) if not matrix.depth_sum(z).sum() > 0)
