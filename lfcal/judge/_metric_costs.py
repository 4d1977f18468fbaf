"""Measure the costs of model-free metrics on this H, for faults whose effect on patterns is known."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.judge._cost import Costs
from lfcal.judge._patch import Patch
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FoundFault, PutIn
from lfcal.judge.faults import only_recorded
from lfcal.judge.quality import Metric, QualityReport

__all__ = ["FRAMES", "as_faults", "with_costs"]

FRAMES = ("missing", "duplicates", "suspect", "misplaced")
"""Keys of metrics that report single frames, whose errors are in H itself."""

NOISY = ("snr", "noise")
"""Keys of metrics of noise; their cost is the cost of the noise of H."""

IN_PATTERNS = frozenset(
    {
        "background",
        "flicker",
        "hot_pixels",
        "jitter",
        "lamp",
        "leak",
        "position",
        "scan_order",
        "seam",
        "stage_gain",
        "step",
    }
)
"""Keys of metrics of any difference from the camera's patterns; they cost at most what these differences cost."""

CAPPED = 64
"""Number of saturated patterns from which the upper end of the range of the sensor is estimated."""

WIDER = 1.5
"""Factor by which cutouts are enlarged to show the light outside them."""


@dataclass(frozen=True, eq=False)
class _Told(Fault):
    """A fault detected by a metric."""

    key: str

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield nothing, because the fault has already been found."""
        del evidence
        return ()


def as_faults(metrics: Iterable[Metric], evidence: Evidence) -> Iterator[tuple[str, FoundFault]]:
    """Yield the key and the fault of each metric whose cost can be measured.

    If the effect of the fault on patterns is known, the fault contains a function that adds it to clean patterns.
    """
    for one in metrics:
        found = FoundFault(_Told(one.key), "", 0.0, 0.0)
        if one.key in FRAMES and len(one.positions):
            share = len(one.positions) / int(np.prod(evidence.plan.shape[:3]))
            put_in = only_recorded(one.positions)
            yield one.key, replace(found, share=share, positions=one.positions, put_in=put_in, extent=share)
        elif one.key == "saturation" and len(one.positions):
            yield one.key, replace(found, put_in=_capped(one.positions, evidence))
        elif one.key == "clipped":
            yield one.key, replace(found, put_in=_clipped)
        elif one.key == "truncation" and one.merit == "bad":  # patterns of larger cutouts take a long time
            yield one.key, replace(found, put_in=_cut_to(evidence.plan.cutout), wider=WIDER)
        elif one.key in NOISY or one.key in IN_PATTERNS:
            yield one.key, found


def _capped(positions: NDArray[np.intp], evidence: Evidence) -> PutIn:
    """Return a function that clips the predicted light at the highest values of patterns that were saturated."""
    some = positions[np.linspace(0, len(positions) - 1, min(CAPPED, len(positions))).astype(int)]
    tops = [float(np.nanmax(np.asarray(evidence.matrix[z, y, x]))) for z, y, x in some.tolist()]
    top = np.float32(np.median(tops))
    return lambda patch: np.minimum(patch.light, top)


def _clipped(patch: Patch) -> NDArray[np.float32]:
    # when the noise of H is added again, there must be no negative values
    found: NDArray[np.float32] = np.maximum(patch.light + patch.noise, np.float32(0)) - patch.noise
    return found


def _cut_to(cutout: tuple[int, int]) -> PutIn:
    """Return a function that removes light and noise outside the middle ``cutout`` of larger cutouts."""

    def put_in(patch: Patch) -> NDArray[np.float32]:
        t, s = (max(0, n - m) // 2 for n, m in zip(patch.light.shape[1:], cutout, strict=True))
        rows, columns = (slice(k, n - k) for k, n in zip((t, s), patch.light.shape[1:], strict=True))
        found = -patch.noise
        found[:, rows, columns] = patch.light[:, rows, columns]
        return found

    return put_in


def with_costs(
    quality: QualityReport, keys: Sequence[str], costs: Costs, faults: Sequence[float | None]
) -> QualityReport:
    """Return the metrics with measured costs.

    Parameters
    ----------
    quality
        The metrics.
    keys
        Keys of the metrics whose costs were measured.
    costs
        Measured costs, first of ``faults``, then of the metrics ``keys``.
    faults
        Costs of the named faults. None: not measured.
    """
    own = dict(zip(keys, costs.costs[len(faults) :], strict=True))
    rest = _unnamed(costs, faults)
    metrics = []
    for one in quality.metrics:
        cost = own.get(one.key)
        if one.key in own and one.key in NOISY:
            cost = costs.clean
        elif one.key in own and one.key in IN_PATTERNS and rest is not None:
            cost = min(one.cost, rest)
        metrics.append(one if cost is None else replace(one, cost=cost, measured=True))
    return replace(quality, metrics=tuple(metrics))


def _unnamed(costs: Costs, faults: Sequence[float | None]) -> float | None:
    """Return the cost of H beyond its noise and its named faults; None if this is unknown."""
    if costs.clean is None or costs.as_it_is is None or not costs.whole or None in faults:
        return None
    named = sum(cost**2 for cost in faults if cost is not None)
    return math.sqrt(max(0.0, costs.as_it_is**2 - costs.clean**2 - named))
