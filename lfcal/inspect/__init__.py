"""Inspection by model: patterns beside those that their camera should give, and the faults that differences name.

- ``evidence``: patterns beside their camera, each with its light, its source and its depth; ``compared``: which of them
- ``faults``: what may have gone wrong, one family a module, found by name
- ``cost``: what each adds to the error of a reconstruction, on a patch of H
- ``search``: one fault after the other; ``inspection``: what was found beside the metrics that need no model
"""

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
