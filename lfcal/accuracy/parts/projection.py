"""Projection: precision, method and sparsity of the projector versus time per iteration."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import InputError
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import Projector, nrmse

__all__ = ["PART", "PointByPoint"]

SETTINGS = (
    ("auto", False, 0.0),
    ("auto", False, 1e-3),
    ("auto", False, 1e-2),
    ("auto", True, 0.0),
    ("polyphase", False, 0.0),
    ("direct", False, 0.0),
    ("sparse", False, 0.0),
    ("sparse", False, 1e-4),
    ("sparse", False, 1e-3),
    ("sparse", False, 1e-2),
    ("sparse", False, 5e-2),
    ("direct", True, 0.0),
)
"""Method, double precision, and fraction of the peak below which entries of H count as zero."""

POINTS = 240
"""Number of voxels and pixels at which the projector is compared with an explicit sum."""

SIDE = 288
"""Side of the image (px), unless two periods and the cutout need more."""

ROUNDS = 2
ABOUT = 0.5
"""Approximate time of a setting (s); the first one also loads libraries."""


@dataclass(frozen=True, eq=False)
class PointByPoint:
    """Forward and back projection of some points as explicit sums in float64.

    The image f of one plane g of an object is ``f[p] = sum_v g[v] H[(v - anchor) mod n][p - v + c]``. Here p is a
    pixel, v the pixel onto which a voxel is imaged, n the period, and c the central pixel of the cutout. Voxels
    (z, y, x) have the plane index z and v = (y, x). The images of several planes are added.

    Attributes
    ----------
    H
        PSF matrix ``(nz, ny, nx, nt, ns)``.
    anchor
        Pixel (row, column) onto which position (0, 0) is imaged.
    shape
        Shape (rows, columns) of the image (px).
    """

    H: PSFMatrix
    anchor: tuple[int, int]
    shape: tuple[int, int]

    def pattern(self, voxel: tuple[int, int, int]) -> tuple[tuple[slice, slice], NDArray[np.float64]]:
        """Return the part of the image (as slices) that the pattern of voxel (z, y, x) covers, and the values there."""
        z, y, x = voxel
        _, ny, nx, nt, ns = self.H.shape
        whole = np.asarray(self.H[z, (y - self.anchor[0]) % ny, (x - self.anchor[1]) % nx], np.float64)
        top, left = y - (nt - 1) // 2, x - (ns - 1) // 2
        rows = slice(max(0, top), min(self.shape[0], top + nt))
        columns = slice(max(0, left), min(self.shape[1], left + ns))
        return (rows, columns), whole[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left]

    def forward(self, voxels: list[tuple[int, int, int]], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the image of an object with ``values`` ``(n,)`` at the n ``voxels`` (z, y, x), and zeros elsewhere."""
        out = np.zeros(self.shape)
        for voxel, value in zip(voxels, values, strict=True):
            where, pattern = self.pattern(voxel)
            out[where] += value * pattern
        return out

    def adjoint(self, voxels: list[tuple[int, int, int]], image: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the back projection ``(n,)`` of ``image`` ``(rows, columns)`` at the n ``voxels`` (z, y, x)."""
        found = [self.pattern(voxel) for voxel in voxels]
        return np.array([float((image[where] * pattern).sum()) for where, pattern in found])


@dataclass(frozen=True, eq=False)
class _Test:
    """Points at which results are compared, and dense arrays for measuring time."""

    truth: PointByPoint
    voxels: list[tuple[int, int, int]]
    sparse: NDArray[np.float32]
    image: NDArray[np.float32]
    forward: NDArray[np.float64]
    adjoint: NDArray[np.float64]


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error relative to explicit sums, and the time of a forward and a back projection, for each setting.

    Settings that do not fit into memory, or have the same effect as an earlier one, are left out.
    """
    sample = yield from subject.iter_sample(1)
    H = sample.matrix
    shape = _image_shape(H.shape)
    yield AccuracyStep("explicit sums")
    test = _test(H, shape)
    yield Truth(
        f"explicit sums in double precision at {len(test.voxels)} voxels, with all entries of H",
        (*sample.notes, f"image of {shape[0]} x {shape[1]} px; times are those of this sample"),
    )
    done: set[tuple[str, bool, float]] = set()
    for method, double, threshold in SETTINGS:
        yield AccuracyStep(f"{method}, {'float64' if double else 'float32'}, threshold {threshold:g}", ABOUT)
        try:
            found, point = _tried(H, shape, test, (method, double, threshold), subject.workers)
        except InputError:  # this method does not fit into the memory
            continue
        if found not in done:
            done.add(found)
            yield point


def _image_shape(shape: tuple[int, ...]) -> tuple[int, int]:
    _, ny, nx, nt, ns = shape
    return max(SIDE, 2 * ny + nt), max(SIDE, 2 * nx + ns)


def _test(H: PSFMatrix, shape: tuple[int, int]) -> _Test:
    rng = np.random.default_rng(0)
    anchor = (int(np.floor(H.anchor[0])), int(np.floor(H.anchor[1])))
    truth = PointByPoint(H, anchor, shape)
    flat = rng.choice(shape[0] * shape[1], min(POINTS, shape[0] * shape[1]), replace=False)
    voxels = [(0, int(k) // shape[1], int(k) % shape[1]) for k in flat]
    values = rng.random(len(voxels)).astype(np.float32)
    volume = np.zeros((H.shape[0], *shape), np.float32)
    volume[tuple(np.array(voxels).T)] = values
    image = rng.random(shape, np.float32)
    forward = truth.forward(voxels, values.astype(np.float64))
    return _Test(truth, voxels, volume, image, forward, truth.adjoint(voxels, image.astype(np.float64)))


def _tried(
    H: PSFMatrix, shape: tuple[int, int], test: _Test, setting: tuple[str, bool, float], workers: int | None
) -> tuple[tuple[str, bool, float], CostPoint]:
    """Return the point of a setting, and the setting with the method that was used."""
    method, double, threshold = setting
    start = time.perf_counter()
    P = Projector(
        H,
        shape,
        method=method,
        dtype=np.float64 if double else np.float32,
        threshold=threshold,
        workers=workers,
    ).prepare()
    setup = time.perf_counter() - start
    found = P.forward(test.sparse), P.adjoint(test.image)
    error = max(nrmse(found[0], test.forward), nrmse(found[1][tuple(np.array(test.voxels).T)], test.adjoint))
    dense = np.random.default_rng(1).random(P.volume_shape, np.float32)
    took = float("inf")
    for _ in range(ROUNDS):
        start = time.perf_counter()
        P.adjoint(P.forward(dense))
        took = min(took, time.perf_counter() - start)
    settings = {"method": P.method, "double": double, "threshold": threshold}
    words = f"{P.method}, {'float64' if double else 'float32'}" + (f", threshold {threshold:g}" if threshold else "")
    return (P.method, double, threshold), CostPoint(words, settings, error, took, "seconds", {"preparing (s)": setup})


PART = AccuracyPart(
    "projection",
    "Projector: precision and sparsity",
    "relative rms error of the projection (the larger of forward and adjoint)",
    "a forward and an adjoint projection of one plane",
    "seconds",
    measure,
    rank=70,
)
