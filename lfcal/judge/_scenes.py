"""Fixed scenes for measuring costs; they are reconstructed with patterns that differ from the true ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import Projector, points, richardson_lucy

__all__ = ["ITERATIONS", "SCENES", "SceneTrial", "beads", "difference", "lines", "scene", "sparse"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

Scene = Callable[[tuple[int, int, int]], F8]
"""Function that returns a scene ``(nz, Y, X)`` of a given shape."""

ITERATIONS = 25
"""Number of iterations of Richardson-Lucy; with more, the noise of H dominates the volume."""

POINTS = 120
"""Number of voxels for each point of the scene."""

BEADS = 400
"""Number of voxels for each bead of the sparse scenes."""

BEAD_PX, LINE_PX = 1.0, 0.8
"""Standard deviations of the profiles of beads and lines (pixels)."""

MARGIN = 0.125
"""Fraction of the cutouts by which the volume extends beyond the image on each side. Of voxels farther outside, the
image contains only tails and noise."""

BACKGROUND = 0.1
"""Background of the image as a fraction of its mean; real images have a known background.

At a dead pixel, light is divided by the value of H there, which is noise. Without background, one such pixel would
cost between a hundredth and a third, by chance. With it, it costs the same in every scene.
"""


def scene(shape: tuple[int, int, int], seed: int = 0, density: float = 1 / POINTS) -> F8:
    """Return the fixed scene ``(nz, Y, X)`` of points and a smooth part of the same energy."""
    rng = np.random.default_rng(seed)
    nz, rows, columns = shape
    count = max(3, round(density * rows * columns))
    sharp = points(shape, [(z, *rng.integers(0, (rows, columns)).tolist()) for z in range(nz) for _ in range(count)])
    y, x = np.mgrid[:rows, :columns]
    waves = [np.cos(2 * np.pi * y / rows * (1 + z) + z) + np.cos(2 * np.pi * x / columns + 2 * z) for z in range(nz)]
    smooth = 1.0 + 0.4 * np.stack(waves)
    return sharp + smooth * float(np.linalg.norm(sharp) / np.linalg.norm(smooth))


def beads(shape: tuple[int, int, int], seed: int = 0) -> F8:
    """Return beads of different brightness on a dark background ``(nz, Y, X)``, at positions between voxels."""
    rng = np.random.default_rng(seed)
    rows, columns = shape[1:]
    y, x = np.arange(rows)[:, None], np.arange(columns)[:, None]
    out = np.empty(shape)
    for plane in out:
        many = max(3, rows * columns // BEADS)
        down, across = (
            np.exp(-np.square(axis - rng.uniform(0, len(axis), many)) / (2 * BEAD_PX**2)) for axis in (y, x)
        )
        plane[:] = (down * rng.uniform(0.4, 1, many)) @ across.T
    return out


def lines(shape: tuple[int, int, int], seed: int = 0, many: int = 2) -> F8:
    """Return ``many`` thin straight lines in each plane on a dark background ``(nz, Y, X)``."""
    rng = np.random.default_rng(seed)
    rows, columns = shape[1:]
    y, x = np.mgrid[:rows, :columns]
    out = np.zeros(shape)
    for plane in out:
        for angle in rng.uniform(0, np.pi, many).tolist():
            top, left = rng.uniform(0.2, 0.8, 2) * (rows, columns)
            away = np.cos(angle) * (y - top) + np.sin(angle) * (x - left)
            plane += np.exp(-np.square(away) / (2 * LINE_PX**2))
    return out


def sparse(shape: tuple[int, int, int], seed: int = 0) -> F8:
    """Return beads and a line in each plane ``(nz, Y, X)``, for which the positions of sources matter most."""
    return beads(shape, seed) + lines(shape, seed, 1)


SCENES: tuple[Scene, ...] = (scene, sparse)
"""Scenes with which costs are measured: smooth light shows errors of brightness, and single points show errors of
position."""


def difference(volume: F8, reference: F8) -> float:
    """Return the norm of ``volume - reference`` over that of ``reference``, at the best overall brightness."""
    power = float((volume * volume).sum())
    scale = float((volume * reference).sum()) / power if power > 0 else 0.0
    return float(np.linalg.norm(scale * volume - reference) / np.linalg.norm(reference))


class SceneTrial:
    """Images of scenes with true patterns, and reconstructions of them with other patterns.

    The volume extends beyond the image, as in a reconstruction with a margin. Otherwise pixels along the border see
    few positions, and where all of these have a dead pixel, light is divided by noise. Costs would be dominated by the
    border, which is larger in a small image.

    Parameters
    ----------
    light
        The true patterns ``(nz, ny, nx, nt, ns)``; positions repeat with their period ``(ny, nx)``.
    side
        Smallest size of the images along each axis (pixels).
    scenes
        Functions that make the scenes.
    workers
        Number of threads. None: all processors.
    """

    def __init__(self, light: F4, side: int, scenes: Sequence[Scene] = SCENES, workers: int | None = None) -> None:
        nz, *period = light.shape[:3]
        sides = [-(-side // n) * n for n in period]
        margins = [round(MARGIN * m) for m in light.shape[3:]]
        self._anchor = (float(margins[0] % period[0]), float(margins[1] % period[1]))
        self._workers = workers
        self._shape = (sides[0] + 2 * margins[0], sides[1] + 2 * margins[1])
        self._inside = tuple(slice(m, m + n) for m, n in zip(margins, sides, strict=True))
        self._weights = np.zeros(self._shape, np.float32)
        self._weights[self._inside] = 1
        P = self._projector(light)
        self._images = [P.forward(make((nz, *self._shape))) for make in scenes]
        self._background = [BACKGROUND * float(image[self._inside].mean()) for image in self._images]
        self._reference = self.volumes(light)

    def volumes(self, patterns: F4) -> F8:
        """Return the reconstructions ``(scenes, nz, Y, X)`` of the images with patterns ``(nz, ny, nx, nt, ns)``."""
        P = self._projector(patterns)
        found = []
        for image, b in zip(self._images, self._background, strict=True):
            options: dict[str, Any] = {"weights": self._weights, "background": b}
            volume = richardson_lucy(P, image + np.float32(b), ITERATIONS, **options).volume
            found.append(volume[(slice(None), *self._inside)])
        return np.stack(found).astype(np.float64)

    def error(self, patterns: F4) -> float:
        """Return the error relative to the reconstruction with the true patterns (NRMSE, rms over the scenes)."""
        try:
            found = self.volumes(patterns)
        except InputError:  # the total light is too small for any reconstruction
            return 1.0
        return float(np.sqrt(np.mean([difference(a, b) ** 2 for a, b in zip(found, self._reference, strict=True)])))

    def _projector(self, patterns: F4) -> Projector:
        return Projector(PSFMatrix(patterns), self._shape, self._anchor, workers=self._workers)
