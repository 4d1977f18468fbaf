"""Of an H from frames of many points: what the target's frames said of themselves when its points were found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from lfcal.psf.quality.across import MatrixMeasures
from lfcal.psf.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _told(key: str, factor: float = 1.0) -> Callable[[MatrixMeasures], Sequence[Reading]]:
    """Return a measure that reads a number of H's provenance; unknown for an H of single points."""

    def of_matrix(measures: MatrixMeasures) -> Sequence[Reading]:
        target: Any = measures.matrix.provenance.get("target")
        value = target.get(key) if isinstance(target, dict) else None
        # provenance is what a file says, and may be anything
        if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value) or value < 0:
            return [UNKNOWN]
        says = target.get("mistakes")
        words = (
            [str(one.get("says", ""))[:120] for one in says if isinstance(one, dict)] if isinstance(says, list) else []
        )
        return [Reading(factor * float(value), detail="; ".join(words[:3]) if key == "doubtful" else "")]

    return of_matrix


METRICS = (
    MetricSpec(
        key="target_crosstalk",
        title="Light of neighbouring points",
        unit="%",
        limits=Limits(good=0.5, bad=3.0),
        cost=CostModel(at_bad=0.1, worst=0.5),
        meaning="Most light of a target's other holes in a cutout, over that of its own.",
        advice="Take a target with holes farther apart, or cover the bright ones.",
        of_matrix=_told("crosstalk", 100.0),
    ),
    MetricSpec(
        key="target_pose",
        title="Points beside the target's lattice",
        unit="px",
        limits=Limits(good=0.2, bad=0.5),
        cost=CostModel(at_bad=0.15, worst=0.5),
        meaning="How far the light of holes lies beside the pose, pitch and distortion that explain all of them (rms).",
        advice="Describe the target as it is: pitch, kind, depth; look for dirt and reflections.",
        of_matrix=_told("pose_rms_px"),
    ),
    MetricSpec(
        key="target_stage",
        title="Target moved otherwise than planned",
        unit="px",
        limits=Limits(good=0.2, bad=1.0),
        cost=CostModel(at_bad=0.02, worst=0.1),
        meaning="How far images lie beside where the stage was to move them, but for what all frames share (rms).",
        advice="Points are used where they are found; to meet phases as planned check the stage's scale and axes.",
        of_matrix=_told("stage_px"),
    ),
    MetricSpec(
        key="target_brightness",
        title="Holes of unequal brightness",
        unit="%",
        limits=Limits(good=15.0, bad=50.0),
        cost=CostModel(at_bad=0.05, worst=0.2),
        meaning="Spread of the light of a target's holes; patterns are divided by it, dim ones keep more noise.",
        advice="Light the target more evenly, clean it, and expose for its brightest holes.",
        of_matrix=_told("brightness_spread", 100.0),
    ),
    MetricSpec(
        key="target_labels",
        title="Doubtful labels of points",
        unit="%",
        limits=Limits(good=1.0, bad=5.0),
        cost=CostModel(at_bad=0.6, worst=1.2),
        meaning="Share of a target's points whose label or place is not certain: dim, doubled, or beside the lattice.",
        advice="Look at the frames where holes are named; clean the target, or leave these holes out with absent=.",
        of_matrix=_told("doubtful", 100.0),
        verdict_detail=True,
    ),
)
