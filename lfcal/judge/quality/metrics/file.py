"""Consistency of the file: its depth-plane sums, and its transpose."""

from __future__ import annotations

import numpy as np

from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]

SAMPLED_SLICES = 2


def _identities(plane: PlaneMeasures) -> Reading:
    stated = plane.about.depth_sum
    if not np.isfinite(plane.about.matrix.depth_sum(plane.about.z)).all():
        return UNKNOWN
    total = float(plane.table.column("energy").sum())
    wrong = abs(float(stated.sum()) - total) / max(abs(total), 1e-300)
    return Reading(max(wrong, _transposition(plane)))


def _transposition(plane: PlaneMeasures) -> float:
    """Return the largest difference between sampled slices of HT and the equal entries of H, relative to the peak.

    ``HT[y, x, t, s] = H[(y + t - ct) mod ny, (x + s - cs) mod nx, nt - 1 - t, ns - 1 - s]`` in every plane.
    """
    ny, nx, nt, ns = plane.patterns.shape
    transposed = plane.about.matrix.T
    t, s = np.meshgrid(np.arange(nt), np.arange(ns), indexing="ij")
    rng = np.random.default_rng(2)
    worst = 0.0
    for _ in range(SAMPLED_SLICES):
        y, x = int(rng.integers(ny)), int(rng.integers(nx))
        rows, columns = (y + t - (nt - 1) // 2) % ny, (x + s - (ns - 1) // 2) % nx
        entries = plane.patterns[rows, columns, nt - 1 - t, ns - 1 - s]
        difference = np.abs(np.asarray(transposed[plane.about.z, y, x], np.float64) - entries)
        if np.isfinite(difference).any():
            worst = max(worst, float(np.nanmax(difference)))
    return worst / max(abs(plane.table.peak), 1e-300)


METRICS = (
    MetricSpec(
        key="identities",
        title="Identities",
        subject="file",
        unit="of peak",
        limits=Limits(good=1e-6, bad=1e-4),
        cost=CostModel(at_bad=0.5, worst=2.0),
        meaning=(
            "Largest difference between sampled entries of HT and H, and between stored and computed depth-plane sums."
        ),
        advice="The file is inconsistent: write it again.",
        of_plane=_identities,
    ),
)
