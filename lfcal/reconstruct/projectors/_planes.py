"""Read the depth planes of H for projectors: converted, set to zero below a threshold, one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import MAX_SAMPLE, InputError, check_psf_shape
from lfcal.psf import denoised, with_new_noise
from lfcal.reconstruct.projectors._reduction import sampled_share

__all__ = ["PlaneReader", "centre_of", "runs_of_rows", "trim"]


@dataclass(frozen=True)
class PlaneReader:
    """Read planes of ``H`` (a `PSFMatrix` or any 5-D array, memory map or dataset) as floats.

    Attributes
    ----------
    H
        Array of shape ``(nz, ny, nx, nt, ns)``.
    dtype
        float32 or float64.
    threshold
        Entries whose magnitude is below this fraction of the largest one in their plane are treated as zero.
    denoise
        Whether to reduce the noise of recorded patterns, if it is known.
    noise_seed
        Seed of new noise that is added to the patterns, and reduced like that of recorded patterns, if their noise is
        known. None: no noise is added.
    """

    H: Any
    dtype: np.dtype[Any]
    threshold: float = 0.0
    denoise: bool = False
    noise_seed: int | None = None

    def __post_init__(self) -> None:
        """Check shape, type and threshold."""
        check_psf_shape(tuple(self.H.shape))
        if self.dtype not in (np.float32, np.float64):
            raise InputError.expected(
                "data type of the projector", "float32 or float64", self.dtype, "choose one of these"
            )
        if not 0 <= self.threshold < 1:
            raise InputError.expected(
                "cropping threshold",
                "a fraction of the plane's peak from 0 to below 1",
                self.threshold,
                "choose a value in this range",
            )

    @property
    def shape(self) -> tuple[int, int, int, int, int]:
        """Shape of H, ``(nz, ny, nx, nt, ns)``."""
        return check_psf_shape(tuple(self.H.shape))

    @property
    def changes(self) -> dict[str, Any]:
        """Changes of the noise of the patterns, by the names of the attributes; empty if there are none."""
        known = {"denoise": self.denoise or None, "noise_seed": self.noise_seed}
        return {name: value for name, value in known.items() if value is not None}

    def read(self, z: int) -> NDArray[Any]:
        """Return plane ``z`` as ``(ny, nx, nt, ns)`` of `dtype`; it must not be modified.

        Raises
        ------
        InputError
            If the plane contains NaN, infinity, or values too large for counts of light.
        """
        raw = self.H.plane(z) if hasattr(self.H, "plane") else np.asarray(self.H[z])
        copy = True if self.threshold > 0 else None
        plane: NDArray[Any] = np.array(raw, self.dtype, order="C", copy=copy)
        low, high = float(plane.min()), float(plane.max())
        largest = max(high, -low)
        if not largest <= MAX_SAMPLE:
            found = f"{largest:.3g}" if np.isfinite(largest) else "NaN or infinity"
            expected = f"finite values up to {MAX_SAMPLE:g}"
            raise InputError.expected(f"PSF matrix, plane {z}", expected, found, "record these positions again")
        if self.denoise:
            plane = denoised(self.H, z, plane)
        if self.noise_seed is not None:
            plane = with_new_noise(self.H, z, plane, self.noise_seed)
            plane = denoised(self.H, z, plane) if self.denoise else plane
        if self.threshold > 0:
            limit = self.dtype.type(self.threshold * largest)
            for row in plane:  # row by row, to limit working memory
                row[np.abs(row) < limit] = 0
        return plane

    def density(self, samples: int = 24) -> float:
        """Return an estimate of the fraction of non-zero entries after the threshold, from some of the positions."""
        nz, ny, nx = self.shape[:3]
        rng = np.random.default_rng(0)
        count = max(1, min(samples, ny * nx))
        filled = 0
        for z in range(nz):
            where = rng.choice(ny * nx, count, replace=False)
            patterns = np.stack([np.asarray(self.H[z, int(k) // nx, int(k) % nx]) for k in where])
            limit = self.threshold * float(np.abs(patterns).max(initial=0.0))
            filled += int(np.count_nonzero(np.abs(patterns) >= limit if limit > 0 else patterns))
        return filled / (nz * count * self.shape[3] * self.shape[4])

    def reduced(self, tolerance: float, spacings: Sequence[float], *, planes: int = 3) -> dict[float, float]:
        """Return an estimate of the fraction of kept entries for each spacing of nodes.

        The estimate is based on a few positions of some planes (see `lfcal.reconstruct.projectors._reduction`).
        """
        nz, *period = self.shape[:3]
        chosen = sorted({z * (nz - 1) // max(1, planes - 1) for z in range(planes)})
        found: dict[float, float] = {}
        for spacing in spacings:
            each = [
                sampled_share(partial(self._pattern, z), (period[0], period[1]), spacing, tolerance) for z in chosen
            ]
            found[spacing] = sum(each) / len(each)
        return found

    def _pattern(self, z: int, y: int, x: int) -> NDArray[Any]:
        return np.ascontiguousarray(self.H[z, y, x], self.dtype)


def trim(plane: NDArray[Any]) -> NDArray[Any]:
    """Return ``plane`` ``(ny, nx, nt, ns)`` with its cutout cropped about the centre to the non-zero entries."""
    sizes = []
    for axis, other in ((2, 3), (3, 2)):
        n = plane.shape[axis]
        c = (n - 1) // 2
        used = np.flatnonzero(plane.any(axis=(0, 1, other)))
        sizes.append((c, int(np.abs(used - c).max()) if used.size else 0))
    (ct, ht), (cs, hs) = sizes
    return plane[:, :, ct - ht : ct + ht + 1, cs - hs : cs + hs + 1]


def centre_of(patterns: Any) -> tuple[int, int]:
    """Return the middle pixel of patterns ``(…, …, nt, ns)``, also for arrays of a device."""
    return (patterns.shape[2] - 1) // 2, (patterns.shape[3] - 1) // 2


def runs_of_rows(phases: NDArray[np.bool_] | None, height: int, first: int) -> list[tuple[int, int]]:
    """Return the runs (start, stop) of ``height`` rows with selected image phases; row 0 has phase ``first``.

    ``phases`` ``(ny, nx)`` is the mask of selected phases. None: all.
    """
    if phases is None:
        return [(0, height)]
    wanted = np.asarray(phases.any(axis=1))[(first + np.arange(height)) % len(phases)]
    # ends of the runs of selected rows, with an unselected row on either side
    edges = np.flatnonzero(np.diff(np.concatenate(([0], wanted.astype(np.int8), [0]))))
    return [(int(start), int(stop)) for start, stop in edges.reshape(-1, 2)]
