"""How far one H is from another: a recording from its simulation, or today's from last month's."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.base import Clock, InputError, Work, drained, for_each_chunk
from lfcal.psf import PSFMatrix

__all__ = ["Comparison", "centroids", "compare", "iter_compare"]

FLOOR = 0.05
"""Part of a pattern's peak that is taken off before its centroid: noise far out would move it."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """What sets an H apart from a reference of the same shape.

    Positions missing in either, dark in either, or holding not-a-number are left out.

    Attributes
    ----------
    correlation
        ``sum(a b) / sqrt(sum(a²) sum(b²))`` over everything compared: 1 for equal matrices in any units.
    per_plane
        The same for each plane ``(nz,)``; NaN where nothing could be compared.
    scale
        Energy of H over that of the reference, per plane ``(nz,)``.
    error
        ``|a / s - b| / |b|`` (L2) of each pattern at equal energy, s the ratio of both patterns' energies
        ``(nz, ny, nx)``; NaN where left out.
    shift_px
        Centroid (row, column) of each pattern minus that of the reference ``(nz, ny, nx, 2)`` (pixels).

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge import Comparison, compare
    >>> reference = np.zeros((1, 2, 2, 7, 7))
    >>> reference[..., 3, 3] = 1
    >>> found: Comparison = compare(np.roll(reference, (1, 2), axis=(3, 4)), reference)
    >>> print(found.compared, "positions, moved by", round(found.rms_shift_px, 3), "px")  # the root of 1² + 2²
    4 positions, moved by 2.236 px
    """

    correlation: float
    per_plane: NDArray[np.float64]
    scale: NDArray[np.float64]
    error: NDArray[np.float32]
    shift_px: NDArray[np.float32]

    @property
    def compared(self) -> int:
        """Number of positions compared."""
        return int(np.isfinite(self.error).sum())

    @property
    def max_shift_px(self) -> float:
        """Largest centroid shift (pixels); NaN where nothing was compared."""
        shifts = self._shifts()
        return float(shifts.max()) if shifts.size else math.nan

    @property
    def rms_shift_px(self) -> float:
        """Root mean square of the centroid shifts (pixels); NaN where nothing was compared."""
        shifts = self._shifts()
        return float(np.sqrt(np.mean(shifts**2))) if shifts.size else math.nan

    @property
    def rms_error(self) -> float:
        """Root mean square of ``error``; NaN where nothing was compared."""
        known = self.error[np.isfinite(self.error)].astype(np.float64)
        return float(np.sqrt(np.mean(known**2))) if known.size else math.nan

    def _shifts(self) -> NDArray[np.float64]:
        size = np.hypot(self.shift_px[..., 0], self.shift_px[..., 1]).astype(np.float64)
        return size[np.isfinite(size)]

    def to_dict(self) -> dict[str, object]:
        """Return everything but the maps as plain values."""
        return {
            "correlation": self.correlation,
            "per_plane": self.per_plane.tolist(),
            "scale": self.scale.tolist(),
            "rms_error": self.rms_error,
            "max_shift_px": self.max_shift_px,
            "rms_shift_px": self.rms_shift_px,
            "compared": self.compared,
        }


def iter_compare(
    H: PSFMatrix | ArrayLike, reference: PSFMatrix | ArrayLike, *, workers: int | None = None
) -> Work[Comparison]:
    """Compare two H of equal shape plane by plane; one plane of each is in memory.

    Parameters
    ----------
    H, reference
        Matrices ``(nz, ny, nx, nt, ns)``, in any unit each.
    workers
        Threads; every processor by default.

    Raises
    ------
    InputError
        If the shapes differ or numbers are complex.

    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge import iter_compare
    >>> H = np.ones((3, 1, 1, 5, 5))
    >>> [step.count for step in iter_compare(H, H)]
    ['0 of 3', '1 of 3', '2 of 3', '3 of 3']
    """
    a, b = (m if isinstance(m, PSFMatrix) else PSFMatrix(m) for m in (H, reference))
    if a.shape != b.shape:
        raise InputError.expected(
            "reference", f"shape {a.shape}", b.shape, "give an H of the same positions and cutout"
        )
    if "c" in (a.dtype.kind, b.dtype.kind):
        raise InputError("comparison: expected real numbers, got complex ones; give intensities")
    return _iter_planes(a, b, workers)


compare = drained(
    iter_compare,
    """
    Examples
    --------
    >>> import numpy as np
    >>> from lfcal.judge import compare
    >>> reference = np.zeros((1, 1, 1, 7, 7))
    >>> reference[..., 3, 2:5] = 1  # three pixels in a row
    >>> found = compare(2 * np.roll(reference, 1, axis=-1), reference)
    >>> print(f"{found.scale[0]:.1f} times as bright, {found.max_shift_px:.2f} px off, {found.correlation:.3f}")
    2.0 times as bright, 1.00 px off, 0.667
    """,
)


def _iter_planes(a: PSFMatrix, b: PSFMatrix, workers: int | None) -> Work[Comparison]:
    clock = Clock("comparing planes", len(a))
    products = np.zeros((len(a), 5))
    error = np.full(a.shape[:3], np.nan, np.float32)
    shift = np.full((*a.shape[:3], 2), np.nan, np.float32)
    yield clock.at(0)
    for z in range(len(a)):
        # a position that either lacks cannot be compared
        wanted = (a.recorded[z] > 0) & (b.recorded[z] > 0)
        products[z] = _compare_plane(a.plane(z), b.plane(z), wanted, error[z], shift[z], workers)
        yield clock.at(z + 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        per_plane = products[:, 0] / np.sqrt(products[:, 1] * products[:, 2])
        scale = products[:, 3] / products[:, 4]
        ab, aa, bb = products[:, :3].sum(0)
        return Comparison(float(ab / np.sqrt(aa * bb)), per_plane, scale, error, shift)


def _compare_plane(
    a: NDArray[np.generic],
    b: NDArray[np.generic],
    wanted: NDArray[np.bool_],
    error: NDArray[np.float32],
    shift: NDArray[np.float32],
    workers: int | None,
) -> NDArray[np.float64]:
    """Fill ``error`` and ``shift`` of a plane; return the sums of ab, a², b², a and b over what was compared."""

    def rows(start: int, stop: int) -> NDArray[np.float64]:
        sums = np.zeros(5)
        for y in range(start, stop):
            # in double precision: differences of near-equal patterns would drown in the rounding of float32
            p, q = (np.asarray(v[y], np.float64).reshape(wanted.shape[1], -1) for v in (a, b))
            energies = p.sum(1), q.sum(1)
            used = wanted[y] & np.isfinite(energies[0] + energies[1]) & (energies[0] > 0) & (energies[1] > 0)
            if not used.any():
                continue
            p, q, ep, eq = p[used], q[used], energies[0][used], energies[1][used]
            sums += [np.vdot(p, q), np.vdot(p, p), np.vdot(q, q), ep.sum(), eq.sum()]
            # at equal energy: a brighter lamp is no other pattern
            error[y, used] = np.linalg.norm(p * (eq / ep)[:, None] - q, axis=1) / np.linalg.norm(q, axis=1)
            shift[y, used] = centroids(p, a.shape[2:]) - centroids(q, a.shape[2:])
        return sums

    total: NDArray[np.float64] = np.sum(for_each_chunk(rows, wanted.shape[0], workers), axis=0)
    return total


def centroids(patterns: NDArray[np.float64], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return centroids (row, column) of patterns ``(n, nt ns)`` above `FLOOR` of their peaks, ``(n, 2)``."""
    above = np.maximum(patterns - FLOOR * patterns.max(1, keepdims=True), 0).reshape(-1, *shape)
    total = above.sum((1, 2))
    rows = above.sum(2) @ np.arange(shape[0])
    columns = above.sum(1) @ np.arange(shape[1])
    places: NDArray[np.float64] = np.stack([rows / total, columns / total], -1)
    return places
