"""Names of `lfcal.judge.report` for other packages of lfcal only: they may change without notice."""

from __future__ import annotations

from lfcal.judge.report.page import limits
from lfcal.judge.report.two import (
    COLUMNS,
    compared_report_files,
    compared_words,
    figure_rows,
    iter_compared_report,
    map_levels,
    verdict,
)

__all__ = [
    "COLUMNS",
    "compared_report_files",
    "compared_words",
    "figure_rows",
    "iter_compared_report",
    "limits",
    "map_levels",
    "verdict",
]
