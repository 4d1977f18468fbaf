"""How good a PSF matrix is.

- ``inspect``: reads every plane once and returns a `QualityReport`
- ``catalogue``: every metric with thresholds, cost and advice; ``metric`` is what one is
- ``measure``: what one plane tells, from ``kernels``, ``dark``, ``sums``, ``steps``, ``field`` and ``lattice``
- ``across``: what planes say of each other
- ``periodicity``: how true the tiling is, from control frames over the field
"""

from lfcal.psf.quality.catalogue import SPECS
from lfcal.psf.quality.inspect import inspect, iter_inspect
from lfcal.psf.quality.metric import Metric, Spec
from lfcal.psf.quality.periodicity import Periodicity, periodicity
from lfcal.psf.quality.report import QualityReport

__all__ = ["SPECS", "Metric", "Periodicity", "QualityReport", "Spec", "inspect", "iter_inspect", "periodicity"]
