"""Agreement of repeated frames of a position."""

from __future__ import annotations

import numpy as np

from lfcal.judge.quality.across import MatrixMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _spread(measures: MatrixMeasures) -> list[Reading]:
    spread = measures.matrix.facts.spread
    if spread is None:  # nothing was recorded twice
        return [UNKNOWN] * len(measures.planes)
    return [Reading(100 * float(np.nanmedian(s))) if np.isfinite(s).any() else UNKNOWN for s in spread]


METRICS = (
    MetricSpec(
        key="repeatability",
        title="Repeatability",
        subject="frames",
        unit="% rms",
        limits=Limits(good=5.0, bad=25.0),
        cost=CostModel(at_bad=0.2, worst=1.0),
        meaning="Median difference between the repeated frames of a position, relative to the pattern.",
        advice="If the difference exceeds the noise of one frame, let the stage settle longer, and warm up the lamp.",
        of_matrix=_spread,
    ),
)
