"""The public names of `lfcal.psf.quality`, loaded when the first of them is asked for."""

from __future__ import annotations

from lfcal.psf.quality.across import MatrixMeasures
from lfcal.psf.quality.catalogue import METRICS
from lfcal.psf.quality.inspect import inspect, iter_inspect
from lfcal.psf.quality.measure import PlaneMeasures
from lfcal.psf.quality.metric import UNKNOWN, CostModel, Limits, Metric, MetricSpec, Reading
from lfcal.psf.quality.periodicity import Periodicity, periodicity
from lfcal.psf.quality.report import QualityReport

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
    "QualityReport",
    "Reading",
    "inspect",
    "iter_inspect",
    "periodicity",
]
