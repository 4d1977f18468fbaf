"""What metrics without a model cost on this H, where it is known what their faults do to patterns."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.inspect.evidence import Evidence
from lfcal.inspect.faults.places import only_recorded
from lfcal.inspect.finding import Fault, Finding
from lfcal.inspect.patch import Patch
from lfcal.psf.quality import QualityReport
from lfcal.psf.quality.metric import Metric

__all__ = ["as_findings", "with_costs"]

FRAMES = ("missing", "duplicates", "suspect", "misplaced")
"""Keys of metrics that name single frames: what is wrong with these is in H."""


@dataclass(frozen=True, eq=False)
class _Told(Fault):
    """A fault that a metric tells."""

    key: str

    def found(self, evidence: Evidence) -> Iterable[Finding]:
        """Yield nothing: it has been found."""
        del evidence
        return ()


def as_findings(metrics: Iterable[Metric], evidence: Evidence) -> Iterator[tuple[str, Finding]]:
    """Yield keys of metrics, and what puts their faults into patterns without one."""
    for one in metrics:
        if one.key in FRAMES and len(one.positions):
            share = len(one.positions) / int(np.prod(evidence.plan.shape[:3]))
            put_in = only_recorded(one.positions)
            yield one.key, Finding(_Told(one.key), "", 0.0, share, one.positions, put_in=put_in, extent=share)
        elif one.key == "clipped":
            yield one.key, Finding(_Told(one.key), "", 0.0, 0.0, put_in=_clipped)


def _clipped(patch: Patch) -> NDArray[np.float32]:
    # with the noise of H added again, nothing is negative
    found: NDArray[np.float32] = np.maximum(patch.light + patch.noise, np.float32(0)) - patch.noise
    return found


def with_costs(quality: QualityReport, costs: dict[str, float | None]) -> QualityReport:
    """Return the metrics with the costs that were measured."""
    metrics = []
    for one in quality.metrics:
        cost = costs.get(one.key)
        metrics.append(one if cost is None else replace(one, cost=cost))
    return replace(quality, metrics=tuple(metrics))
