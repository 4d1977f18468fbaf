"""The public names of `lfcal.judge.quality`: each is loaded on first use."""

from __future__ import annotations

from lfcal.judge.quality._inspect import inspect, iter_inspect
from lfcal.judge.quality._periodicity import Periodicity, periodicity
from lfcal.judge.quality.across import MatrixMeasures
from lfcal.judge.quality.catalogue import METRICS
from lfcal.judge.quality.measure import PlaneMeasures
from lfcal.judge.quality.metric import UNKNOWN, CostModel, Limits, Metric, MetricSpec, Reading
from lfcal.judge.quality.report import QualityReport

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
