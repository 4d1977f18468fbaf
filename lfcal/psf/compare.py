"""H against a reference: simulated, or recorded earlier."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lfcal.errors import InputError, expectation
from lfcal.progress import Clock, Work, drain
from lfcal.psf.matrix import PSFMatrix
from lfcal.psf.quality.dark import dark_corners
from lfcal.threads import for_each_chunk, njit

__all__ = ["Comparison", "compare", "iter_compare"]

GOOD, BAD = 0.05, 0.15
"""Relative error up to which two matrices agree, and beyond which they do not."""

DARK = 1e-6
"""A pattern with less than this share of the usual squares is dark."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """How H differs from a reference.

    Attributes
    ----------
    correlation
        Normalised correlation of each pattern with its reference ``(nz, ny, nx)``, -1 to 1.
    error
        Norm of the difference over the reference's, each plane of H scaled to the reference ``(nz, ny, nx)``.
    shift
        Centroid of the pattern less the reference's, along (y, x), ``(nz, 2, ny, nx)`` (pixels).
    gain
        Factor that brings each plane of H to the reference ``(nz,)``.
    """

    correlation: NDArray[np.float64]
    error: NDArray[np.float64]
    shift: NDArray[np.float64]
    gain: NDArray[np.float64]

    @property
    def overall_correlation(self) -> float:
        """Median correlation."""
        return float(np.nanmedian(self.correlation))

    @property
    def overall_error(self) -> float:
        """Root mean square of the errors."""
        return float(np.sqrt(np.nanmean(self.error**2)))

    @property
    def overall_shift(self) -> float:
        """Root mean square distance of the centroids (pixels)."""
        return float(np.sqrt(np.nanmean((self.shift**2).sum(1))))

    @property
    def merit(self) -> str:
        """``"good"`` below 5 % overall error, ``"bad"`` above 15 %, else ``"fair"``."""
        if math.isnan(self.overall_error):
            return "unknown"
        return "good" if self.overall_error < GOOD else "bad" if self.overall_error > BAD else "fair"

    def worst(self, n: int = 10) -> NDArray[np.intp]:
        """Return the ``n`` positions (z, y, x) of the largest errors, ``(n, 3)``."""
        order = np.argsort(np.nan_to_num(self.error, nan=-1.0), axis=None)[::-1][:n]
        return np.stack(np.unravel_index(order, self.error.shape), axis=1)

    def to_dict(self) -> dict[str, object]:
        """Return the overall numbers and those of each plane as plain values."""
        planes = [
            {
                "correlation": float(np.nanmedian(self.correlation[z])),
                "error": float(np.sqrt(np.nanmean(self.error[z] ** 2))),
                "shift_px": float(np.sqrt(np.nanmean((self.shift[z] ** 2).sum(0)))),
                "gain": float(self.gain[z]),
            }
            for z in range(len(self.gain))
        ]
        return {
            "merit": self.merit,
            "correlation": self.overall_correlation,
            "error": self.overall_error,
            "shift_px": self.overall_shift,
            "planes": planes,
            "worst": self.worst().tolist(),
        }


@njit()
def pair_pass(
    a: NDArray[np.float32],
    b: NDArray[np.float32],
    dark: tuple[float, float],
    floor: tuple[float, float],
    out: NDArray[np.float64],
) -> None:
    """Sum squares and product of two rows of patterns ``(nx, nt, ns)`` and their lit pixels' moments.

    ``out (nx, 9)``: squares of a and b, product; weight, row and column moment of a; the same of b. ``dark`` is
    taken off first; moments count what exceeds ``floor``, from the cutout's centre (pixels).
    """
    nx, nt, ns = a.shape
    for x in range(nx):
        out[x] = 0.0
        for t in range(nt):
            i = t - (nt - 1) // 2
            for s in range(ns):
                u, v = a[x, t, s] - dark[0], b[x, t, s] - dark[1]
                if not (math.isfinite(u) and math.isfinite(v)):
                    continue
                j = s - (ns - 1) // 2
                out[x, 0] += u * u
                out[x, 1] += v * v
                out[x, 2] += u * v
                if u > floor[0]:
                    w = u - floor[0]
                    out[x, 3] += w
                    out[x, 4] += w * i
                    out[x, 5] += w * j
                if v > floor[1]:
                    w = v - floor[1]
                    out[x, 6] += w
                    out[x, 7] += w * i
                    out[x, 8] += w * j


def compare(
    matrix: PSFMatrix | ArrayLike, reference: PSFMatrix | ArrayLike, *, workers: int | None = None
) -> Comparison:
    """Return how H differs from a reference: see `iter_compare`."""
    return drain(iter_compare(matrix, reference, workers=workers))


def iter_compare(
    matrix: PSFMatrix | ArrayLike, reference: PSFMatrix | ArrayLike, *, workers: int | None = None
) -> Work[Comparison]:
    """Compare H with a reference, plane by plane; memory is that of one plane of each.

    Backgrounds are taken off, and each plane is scaled to its reference, so that units do not matter. Cutouts of
    different size are compared over the smaller one.

    Parameters
    ----------
    matrix, reference
        Two matrices of as many planes and positions.
    workers
        Threads.

    Raises
    ------
    InputError
        If planes or periods differ.
    """
    H = matrix if isinstance(matrix, PSFMatrix) else PSFMatrix(matrix)
    R = reference if isinstance(reference, PSFMatrix) else PSFMatrix(reference)
    if H.shape[:3] != R.shape[:3] or H.is_transposed != R.is_transposed:
        raise InputError(
            expectation("reference", f"planes and positions {H.shape[:3]} like H", R.shape[:3],
                        "simulate or record it with the same plan")
        )  # fmt: skip
    nz, ny, nx = H.shape[:3]
    correlation, error = np.full((nz, ny, nx), np.nan), np.full((nz, ny, nx), np.nan)
    shift, gain = np.full((nz, 2, ny, nx), np.nan), np.full(nz, np.nan)
    cutout = tuple(min(m, n) for m, n in zip(H.cutout, R.cutout, strict=True))
    clock = Clock("comparing planes", nz)
    yield clock.at(0)
    for z in range(nz):
        sums = _sums(_middle(H.plane(z), cutout), _middle(R.plane(z), cutout), workers)
        aa, bb, ab, wa, ya, xa, wb, yb, xb = np.moveaxis(sums, -1, 0)
        total = float(aa.sum())
        gain[z] = float(ab.sum()) / total if total > 0 else math.nan
        aa, bb = (np.where(squares > DARK * np.median(squares), squares, np.nan) for squares in (aa, bb))
        with np.errstate(divide="ignore", invalid="ignore"):
            correlation[z] = ab / np.sqrt(aa * bb)
            error[z] = np.sqrt(np.maximum(gain[z] ** 2 * aa - 2 * gain[z] * ab + bb, 0) / bb)
            error[z] = np.where(np.isnan(aa) & ~np.isnan(bb), 1.0, error[z])  # nothing where there should be light
            shift[z] = ya / wa - yb / wb, xa / wa - xb / wb
        yield clock.at(z + 1)
    return Comparison(correlation, error, shift, gain)


def _middle(plane: NDArray[np.generic], cutout: tuple[int, ...]) -> NDArray[np.float32]:
    """Return the middle of all patterns, ``(ny, nx, *cutout)``, as float32."""
    (t, s), (nt, ns) = ((n - m) // 2 for n, m in zip(plane.shape[2:], cutout, strict=True)), cutout
    return np.ascontiguousarray(plane[:, :, t : t + nt, s : s + ns], np.float32)


def _sums(a: NDArray[np.float32], b: NDArray[np.float32], workers: int | None) -> NDArray[np.float64]:
    dark, floor = [], []
    for values in (a, b):
        corners = dark_corners(values)
        some = values.reshape(-1, values.shape[2] * values.shape[3])[:: max(1, values.shape[0] * values.shape[1] // 64)]
        peak = float(np.median(np.where(np.isfinite(some), some, -np.inf).max(1))) - corners.background
        dark.append(corners.background)
        floor.append(max(4 * corners.noise, 0.003 * max(peak, 0.0)))
    out = np.empty((*a.shape[:2], 9))

    def rows(start: int, stop: int) -> None:
        for y in range(start, stop):
            pair_pass(a[y], b[y], (dark[0], dark[1]), (floor[0], floor[1]), out[y])

    for_each_chunk(rows, len(a), workers)
    return out
