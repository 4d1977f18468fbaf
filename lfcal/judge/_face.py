"""The public names of `lfcal.judge`: each is loaded on first use."""

from __future__ import annotations

from lfcal.base import Finding, Judgement
from lfcal.judge.checking import Check, check
from lfcal.judge.comparison import Comparison, compare, iter_compare
from lfcal.judge.evidence import Evidence, Unlike, iter_evidence
from lfcal.judge.explained import Disagreement, Explanation
from lfcal.judge.fault import FAULTS, Fault, FaultPicture, FoundFault
from lfcal.judge.inspection import Inspection, iter_inspection
from lfcal.judge.quality import QualityReport, inspect, iter_inspect
from lfcal.judge.report import iter_report, report
from lfcal.judge.results import StoredResult, find_results, iter_find_results, picture_of, read_result
from lfcal.judge.search import iter_search
from lfcal.judge.source import FINDING_SOURCES, FindingSource, judgement_of

__all__ = [
    "FAULTS",
    "FINDING_SOURCES",
    "Check",
    "Comparison",
    "Disagreement",
    "Evidence",
    "Explanation",
    "Fault",
    "FaultPicture",
    "Finding",
    "FindingSource",
    "FoundFault",
    "Inspection",
    "Judgement",
    "QualityReport",
    "StoredResult",
    "Unlike",
    "check",
    "compare",
    "find_results",
    "inspect",
    "iter_compare",
    "iter_evidence",
    "iter_find_results",
    "iter_inspect",
    "iter_inspection",
    "iter_report",
    "iter_search",
    "judgement_of",
    "picture_of",
    "read_result",
    "report",
]
