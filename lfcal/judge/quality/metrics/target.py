"""Metrics of an H from frames of a target, as stated when its points were found."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

from lfcal.judge.quality.across import MatrixMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, MetricSpec, Reading

__all__ = ["METRICS"]


def _reported(key: str, factor: float = 1.0) -> Callable[[MatrixMeasures], Sequence[Reading]]:
    """Return a measure that reads a number from the provenance of H; unknown for an H of single points."""

    def of_matrix(measures: MatrixMeasures) -> Sequence[Reading]:
        target: Any = measures.matrix.provenance.get("target")
        value = target.get(key) if isinstance(target, dict) else None
        # provenance comes from a file, and may contain anything
        if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value) or value < 0:
            return [UNKNOWN]
        says = target.get("mistakes")
        words = (
            [str(one.get("says", ""))[:120] for one in says if isinstance(one, dict)] if isinstance(says, list) else []
        )
        return [Reading(factor * float(value), detail="; ".join(words[:3]) if key == "doubtful" else "")]

    return of_matrix


def _metric(
    key: str,
    reported: str,
    limits: tuple[float, float],
    cost: tuple[float, float],
    words: tuple[str, str, str],
    **more: Any,
) -> MetricSpec:
    """Return a metric of a number stated in the provenance; fractions are in per cent.

    ``limits`` are the limits of good and bad values. The pair ``cost`` is the cost at the limit of bad values and the
    largest cost. The texts ``words`` are title, meaning and advice.
    """
    (good, bad), (at_bad, worst), (title, meaning, advice) = limits, cost, words
    pixels = reported.endswith("_px")
    return MetricSpec(
        key=f"target_{key}",
        title=title,
        subject="target",
        unit="px" if pixels else "%",
        limits=Limits(good=good, bad=bad),
        cost=CostModel(at_bad=at_bad, worst=worst),
        meaning=meaning,
        advice=advice,
        of_matrix=_reported(reported, 1.0 if pixels else 100.0),
        **more,
    )


METRICS = (
    _metric(
        "crosstalk",
        "crosstalk",
        (0.5, 3.0),
        (0.1, 0.5),
        (
            "Light of neighbouring points",
            "Largest amount of light from other holes of the target in a cutout, relative to the hole at its centre.",
            "Use a target with holes farther apart, or cover the bright holes.",
        ),
    ),
    _metric(
        "pose",
        "pose_rms_px",
        (0.2, 0.5),
        (0.15, 0.5),
        (
            "Points off the target lattice",
            "Deviation of the images of the holes from the common pose, pitch and distortion (rms).",
            "Correct the description of the target (pitch, kind, depth); look for dirt and reflections.",
        ),
    ),
    _metric(
        "stage",
        "stage_px",
        (0.2, 1.0),
        (0.02, 0.1),
        (
            "Target not moved as planned",
            "Deviation of the images from their planned positions, apart from the deviation common to all "
            "frames (rms).",
            "Points are used where they are found. To reach the planned positions, check the scale and the "
            "axes of the stage.",
        ),
    ),
    _metric(
        "brightness",
        "brightness_spread",
        (15.0, 50.0),
        (0.05, 0.2),
        (
            "Holes of unequal brightness",
            "Spread of the light of the holes of a target. Patterns are divided by their light, so dim ones "
            "have more noise.",
            "Light the target more evenly, clean it, and expose for its brightest holes.",
        ),
    ),
    _metric(
        "labels",
        "doubtful",
        (1.0, 5.0),
        (0.6, 1.2),
        (
            "Uncertain labels of points",
            "Fraction of the points of a target whose label or position is uncertain: dim, doubled, or off "
            "the lattice.",
            "Look at the frames with these holes. Clean the target, or leave these holes out with absent=.",
        ),
        verdict_detail=True,
    ),
)
