"""All metrics by name: the metrics of `lfcal.judge.quality.metrics`, and the metrics of other packages.

Costs are reconstruction errors (NRMSE relative to the ideal H). The costs of scan order, dark planes, missing and
misplaced frames, background, truncation, hot pixels and flicker come from reconstructions with the fault added to a
simulated H. The other costs are estimates that rank their metrics among these.
"""

from __future__ import annotations

from lfcal.base import Registry
from lfcal.judge.quality.metric import MetricSpec

__all__ = ["METRICS"]


def _check(part: MetricSpec) -> None:
    if not isinstance(part, MetricSpec):
        raise TypeError(f"expected a MetricSpec, got {type(part).__name__}")


METRICS: Registry[MetricSpec] = Registry(
    "check of H",
    "lfcal.judge.quality.metrics",
    "METRICS",
    "lfcal.metrics",
    order=lambda spec: (-spec.cost.worst, -spec.cost.at_bad, spec.key),
    check=_check,
)
"""All metrics, those with the worst consequences first."""
