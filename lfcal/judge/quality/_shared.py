"""Names of `lfcal.judge.quality` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge.quality._inspect import Controls
from lfcal.judge.quality._units import control_frames, iter_inspect_units
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
    "Controls",
    "control_frames",
    "counted_words",
    "findings_of",
    "iter_inspect_units",
    "merit_of",
    "merit_word",
    "where",
]
