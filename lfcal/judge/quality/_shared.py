"""Names of `lfcal.judge.quality` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge.quality._inspect import Controls, iter_inspect_plane, judged, straight
from lfcal.judge.quality.measure import PASSES
from lfcal.judge.quality.metric import RANK, Merit
from lfcal.judge.quality.pattern_table import NOISELESS
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
    "Controls",
    "Merit",
    "counted",
    "counted_words",
    "iter_inspect_plane",
    "judged",
    "listed",
    "merit_of",
    "merit_word",
    "problems_of",
    "straight",
    "where",
]
