"""A patch of positions computed for the camera, to which faults are added to measure their cost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfcal.judge._modelled import cut, plane_of
from lfcal.judge._scatter import noise_terms
from lfcal.judge.evidence import Evidence
from lfcal.judge.expected import Behind

__all__ = ["Patch", "patch_of"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

STEPS = 8
"""Largest number of depths of one plane that are computed."""


@dataclass(frozen=True, eq=False)
class Patch:
    """Patterns of some positions without faults, in the units of H.

    Attributes
    ----------
    evidence
        The compared patterns of H.
    known
        The camera of H, with cutouts of the size of the patch.
    gains
        Counts of H per fraction of the light through the iris, by plane ``(nz,)``.
    index
        Positions ``(n, 3)`` as (z, y, x).
    light, noise
        Patterns ``(n, nt, ns)`` predicted by the camera, and noise like the noise of H.
    """

    evidence: Evidence
    known: Behind
    gains: F8
    index: NDArray[np.intp]
    light: F4
    noise: F4

    @property
    def corners(self) -> NDArray[np.intp]:
        """Pixel (row, column) of the first sample of each cutout ``(n, 2)``, relative to the first of H."""
        return self.index[:, 1:] + self.inset

    @property
    def inset(self) -> NDArray[np.intp]:
        """Number of rows and columns ``(2,)`` by which the cutouts of H are larger on each side."""
        found: NDArray[np.intp] = (np.array(self.evidence.plan.cutout) - np.array(self.light.shape[1:])) // 2
        return found

    def seen(self, image: F8) -> F4:
        """Return the part ``(n, nt, ns)`` of ``image``, which starts at the first cutout of H, in each cutout."""
        nt, ns = self.light.shape[1:]
        return np.stack([image[r : r + nt, c : c + ns] for r, c in self.corners.tolist()]).astype(np.float32)

    def moved(self, source: F8 | None = None, window: F8 | None = None, depth: F8 | None = None) -> F4:
        """Return the light with sources or cutouts displaced ``(n, 2)`` (px), or relative changes of depth ``(n,)``."""
        n = len(self.index)
        source = np.zeros((n, 2)) if source is None else source
        window = np.zeros((n, 2)) if window is None else window
        steps = _rounded(np.zeros(n) if depth is None else depth)
        out = np.empty_like(self.light)
        for z in np.unique(self.index[:, 0]).tolist():
            for step in np.unique(steps[self.index[:, 0] == z]).tolist():
                own = np.flatnonzero((self.index[:, 0] == z) & (steps == step))
                patterns = plane_of(self.known, z, step).patterns(self.index[own, 1:], source[own])
                out[own] = cut(patterns, window[own]) * np.float32(self.gains[z])
        return out

    def at(self, index: NDArray[np.intp]) -> F4:
        """Return the predicted light of other positions ``(n, 3)``."""
        return replace(self, index=index, light=np.empty((len(index), *self.light.shape[1:]), np.float32)).moved()

    @cached_property
    def recorded(self) -> F4:
        """Values of H at the positions minus the noise of the patch, so that H results when this noise is added."""
        matrix, (t, s), (nt, ns) = self.evidence.matrix, self.inset.tolist(), self.light.shape[1:]
        out = self.light.copy()
        for k, (z, y, x) in enumerate(self.index.tolist()):
            good = matrix.valid(z, y, x)[t : t + nt, s : s + ns]
            values = np.asarray(matrix[z, y, x], np.float32)[t : t + nt, s : s + ns]
            good = good & np.isfinite(values)
            out[k][good] = values[good] - self.noise[k][good]
        return out


def patch_of(
    evidence: Evidence, index: NDArray[np.intp], cutout: tuple[int, int], seed: int = 0, *, wider: float = 1.0
) -> Patch:
    """Return the patch of positions ``(n, 3)``; ``cutout``, and ``wider`` times the cutout of H, limit its cutouts."""
    plan = evidence.plan
    # the same number on both sides
    rows, columns = (min(n + 2 * round((wider - 1) * n / 2), m) for n, m in zip(plan.cutout, cutout, strict=True))
    smaller = replace(plan, cutout=(rows, columns))
    known = replace(evidence.camera, plan=smaller)
    seen = np.isfinite(evidence.sigmas[:, 0])
    gains = np.full(plan.shape[0], float(np.median(evidence.values[seen, 0])))
    for z in np.unique(evidence.index[seen, 0]):
        gains[z] = float(np.median(evidence.values[seen & (evidence.index[:, 0] == z), 0]))
    nothing = np.zeros((len(index), *smaller.cutout), np.float32)
    bare = Patch(evidence, known, gains, index, nothing, nothing)
    light = bare.moved()
    constant, slope = noise_terms(evidence.matrix, evidence.data - evidence.left, evidence.left, evidence.valid)
    spread = np.sqrt(constant + slope * np.maximum(light, 0))
    drawn = np.random.default_rng(seed).standard_normal(light.shape, np.float32)
    return replace(bare, light=light, noise=(spread * drawn).astype(np.float32))


def _rounded(depth: F8) -> F8:
    """Return fractions of depths, rounded to at most `STEPS` different values."""
    low, high = float(depth.min(initial=0.0)), float(depth.max(initial=0.0))
    if len(np.unique(depth)) <= STEPS:
        return depth
    step = (high - low) / (STEPS - 1)
    return low + step * np.rint((depth - low) / step)
