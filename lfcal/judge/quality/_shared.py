"""Names of `lfcal.judge.quality` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge.quality._inspect import Controls, iter_inspect_plane, judged, straight
from lfcal.judge.quality.measure import PASSES
from lfcal.judge.quality.metric import RANK, Merit
from lfcal.judge.quality.pattern_table import NOISELESS
from lfcal.judge.quality.sessions import inspections_in, labels_of
from lfcal.judge.quality.trend import (
    SHORTEST_S,
    TOO_SHORT,
    Course,
    Judged,
    QualityTrend,
    Value,
    draw_quality_trend,
    judged_of,
    months_since_first,
    panels_over_time,
    quality_trend,
    read_judged,
)
from lfcal.judge.quality.verdict import (
    BAD,
    FAIR,
    counted,
    counted_words,
    listed,
    merit_of,
    merit_word,
    problems_of,
    where,
)

__all__ = [
    "BAD",
    "FAIR",
    "NOISELESS",
    "PASSES",
    "RANK",
    "SHORTEST_S",
    "TOO_SHORT",
    "Controls",
    "Course",
    "Judged",
    "Merit",
    "QualityTrend",
    "Value",
    "counted",
    "counted_words",
    "draw_quality_trend",
    "inspections_in",
    "iter_inspect_plane",
    "judged",
    "judged_of",
    "labels_of",
    "listed",
    "merit_of",
    "merit_word",
    "months_since_first",
    "panels_over_time",
    "problems_of",
    "quality_trend",
    "read_judged",
    "straight",
    "where",
]
