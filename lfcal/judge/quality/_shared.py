"""Names of `lfcal.judge.quality` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge.quality._inspect import Controls, iter_inspect_plane, judged, straight
from lfcal.judge.quality.measure import PASSES
from lfcal.judge.quality.pattern_table import NOISELESS
from lfcal.judge.quality.verdict import (
    BAD,
    FAIR,
    counted_words,
    findings_of,
    merit_of,
    merit_word,
    where,
)

__all__ = [
    "BAD",
    "FAIR",
    "NOISELESS",
    "PASSES",
    "Controls",
    "counted_words",
    "findings_of",
    "iter_inspect_plane",
    "judged",
    "merit_of",
    "merit_word",
    "straight",
    "where",
]
