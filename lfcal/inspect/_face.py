"""The public names of `lfcal.inspect`, loaded when the first of them is asked for."""

from __future__ import annotations

from lfcal.inspect.compared import iter_evidence
from lfcal.inspect.evidence import Evidence, Unlike
from lfcal.inspect.finding import FAULTS, Fault, Finding, Picture
from lfcal.inspect.inspection import Inspection, iter_inspection
from lfcal.inspect.search import iter_search

__all__ = [
    "FAULTS",
    "Evidence",
    "Fault",
    "Finding",
    "Inspection",
    "Picture",
    "Unlike",
    "iter_evidence",
    "iter_inspection",
    "iter_search",
]
