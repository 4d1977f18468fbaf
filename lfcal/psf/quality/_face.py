"""The public names of `lfcal.psf.quality`: each is loaded when it is asked for."""

from __future__ import annotations

from lfcal.psf.quality._inspect import inspect, iter_inspect
from lfcal.psf.quality._periodicity import Periodicity, periodicity
from lfcal.psf.quality.across import MatrixMeasures
from lfcal.psf.quality.catalogue import METRICS
from lfcal.psf.quality.measure import PlaneMeasures
from lfcal.psf.quality.metric import UNKNOWN, CostModel, Limits, Metric, MetricSpec, Reading
from lfcal.psf.quality.report import QualityReport
from lfcal.psf.quality.verdict import QualityProblem, judged_sentence

__all__ = [
    "METRICS",
    "UNKNOWN",
    "CostModel",
    "Limits",
    "MatrixMeasures",
    "Metric",
    "MetricSpec",
    "Periodicity",
    "PlaneMeasures",
    "QualityProblem",
    "QualityReport",
    "Reading",
    "inspect",
    "iter_inspect",
    "judged_sentence",
    "periodicity",
]
