"""The public names of `lfcal.judge.report`, each loaded on first use."""

from __future__ import annotations

from lfcal.judge.report.write import iter_report, redo_list, report, report_files

__all__ = ["iter_report", "redo_list", "report", "report_files"]
