"""Names of `lfcal.psf.quality` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.psf.quality._inspect import Controls, iter_inspect_plane, judged, straight
from lfcal.psf.quality.measure import PASSES
from lfcal.psf.quality.metric import RANK, Merit
from lfcal.psf.quality.pattern_table import NOISELESS
from lfcal.psf.quality.sessions import inspections_in, labels_of
from lfcal.psf.quality.trend import (
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
from lfcal.psf.quality.verdict import (
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
