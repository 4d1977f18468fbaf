"""The public names of `lfcal.judge`: each is loaded when it is asked for."""

from __future__ import annotations

from lfcal.judge.compared import iter_evidence
from lfcal.judge.evidence import Evidence, Unlike
from lfcal.judge.explained import Disagreement, Explanation
from lfcal.judge.finding import FAULTS, Fault, Finding, Picture
from lfcal.judge.inspection import Inspection, iter_inspection
from lfcal.judge.search import iter_search

__all__ = [
    "FAULTS",
    "Disagreement",
    "Evidence",
    "Explanation",
    "Fault",
    "Finding",
    "Inspection",
    "Picture",
    "Unlike",
    "iter_evidence",
    "iter_inspection",
    "iter_search",
]
