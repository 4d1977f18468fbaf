"""How good a PSF matrix is.

- ``inspect``: reads every plane once and returns a `QualityReport`; ``report`` is what that is
- ``metric``: what a metric is; ``metrics`` holds them, ``catalogue`` finds them
- ``measure``: what metrics share of one plane, from ``dark``, ``pattern_table``, ``sums``, ``positions``, ``turned``,
  ``steps``
- ``across``: what they share of all planes
- ``field``, ``lattice``, ``kernels``: parts, phases and compiled passes that these are made of
- ``periodicity``: how true the tiling is, from control frames over the field
"""

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
