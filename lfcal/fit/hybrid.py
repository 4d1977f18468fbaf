"""Model H with what was measured beyond it: less noise than the recorded patterns, nearer to them than the model.

Of every recorded pattern what belongs to it alone, the lamp's brightness and the source beside its place, is taken out
first where it matters, for H has neither. Where residuals are noise the hybrid is the model.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Work
from lfcal.fit._fitted import Fitted
from lfcal.fit._hybrid_patterns import RecordedPatterns, iter_plane_data, model_uncertainty
from lfcal.fit._leftover import Leftover, iter_leftover
from lfcal.fit._leftover_size import PlaneResiduals
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness
from lfcal.fit.problem import ERRORS
from lfcal.psf import Facts, Header, Origin, Plane, PlaneSource, PSFMatrix, Stored, Zeros

__all__ = [
    "HybridPlanes",
    "HybridSummary",
    "hybrid_note",
]

F4 = NDArray[np.float32]


TOLD = 0.95
"""Share of the variance that must be left at most for a position to follow its neighbours."""


@dataclass(frozen=True, slots=True)
class HybridSummary:
    """What a hybrid H is made of.

    Attributes
    ----------
    hybrid, model, outliers
        Positions of each `Origin`.
    between
        Positions among ``hybrid`` that were not recorded: their neighbours tell.
    change, largest
        Rms over the changed positions of how far they are from the model, and the largest (relative L2).
    """

    hybrid: int
    model: int
    outliers: int
    between: int
    change: float
    largest: float

    def __str__(self) -> str:
        """Return it in a line."""
        if not self.hybrid:
            return "hybrid H: no position shows more than noise beyond the model, which it is"
        said = f"{self.hybrid} positions changed by {100 * self.change:.2g} % (at most {100 * self.largest:.2g} %)"
        between = f", {self.between} of them between recorded ones" if self.between else ""
        outliers = f", {self.outliers} outliers left to it" if self.outliers else ""
        return f"hybrid H: {said}{between}; {self.model} are the model alone{outliers}"

    @classmethod
    def of(cls, planes: Sequence[tuple[Facts, NDArray[np.float64]]]) -> HybridSummary:
        """Return the summary of the facts and changes of all planes."""
        origin = np.stack([facts.origin for facts, _ in planes if facts.origin is not None])
        recorded = np.stack([facts.recorded for facts, _ in planes if facts.recorded is not None])
        changed = np.stack([change for _, change in planes])[origin == Origin.HYBRID]
        count = [int((origin == one).sum()) for one in (Origin.HYBRID, Origin.MODEL, Origin.OUTLIER)]
        between = int(((origin == Origin.HYBRID) & (recorded == 0)).sum())
        size = math.sqrt(float(np.square(changed).mean())) if changed.size else 0.0
        return cls(count[0], count[1], count[2], between, size, float(changed.max(initial=0.0)))


class HybridPlanes(PlaneSource):
    """The planes of the hybrid H of a fit and recorded patterns.

    Parameters
    ----------
    header
        What H is, besides its values.
    fit
        The fit whose model is the base.
    source
        Recorded patterns of the same scan, those that were not fitted among them.
    noise
        Constant and slope of a sample's variance; None takes what the source states.

    Raises
    ------
    InputError
        If the patterns are of another scan, or their noise is not known.
    """

    def __init__(
        self, header: Header, fit: Fitted, source: PSFMatrix | Measured, noise: tuple[float, float] | None = None
    ) -> None:
        self.header, self._fit, self._model = header, fit, fit.planes()
        self._recorded = RecordedPatterns.of(source, fit.planned, noise)
        self._made: dict[int, tuple[Facts, NDArray[np.float64]]] = {}

    def iter_plane(self, z: int, zeros: Zeros, workers: int | None, *, alone: bool = False) -> Work[Plane]:
        """Compute plane ``z``; progress counts rows of the model, then patterns and tiles."""
        model = yield from self._model.iter_plane(z, zeros, workers, alone=alone)
        data, facts = yield from iter_plane_data(self._fit, self._recorded, z, model.values, workers)
        left = yield from iter_leftover(data, f"beyond the model, plane {z}", seed=z, workers=workers)
        plane, changed = _joined(self._fit, data, facts, left)
        self._made[z] = plane.facts, changed
        return plane

    def reopening(self, z: int, stored: Stored) -> None:
        """Return nothing: every plane is made here, for the summary is of all."""
        return

    @property
    def summary(self) -> HybridSummary:
        """What the planes that were made consist of."""
        return HybridSummary.of([self._made[z] for z in sorted(self._made)])

    def late_provenance(self) -> dict[str, Any]:
        """Return the summary for provenance."""
        return hybrid_note(self.summary)


def hybrid_note(summary: HybridSummary) -> dict[str, Any]:
    """Return what a hybrid H says of itself in its provenance, beside what the fit says."""
    return {"hybrid": asdict(summary)}


def _joined(fit: Fitted, data: PlaneResiduals, facts: Facts, left: Leftover) -> tuple[Plane, NDArray[np.float64]]:
    """Return the plane of model and estimate, where the estimate is better than none, and how far it is changed.

    The latter of each position's pattern ``(ny, nx)``, as rms over rms of its light.
    """
    assert facts.origin is not None
    own = data.recorded & (not left.kind.empty)
    changed = own | ((facts.origin != Origin.OUTLIER) & left.kind.supported)
    changed |= left.kind.supported & (facts.origin == Origin.OUTLIER)
    value = np.where(changed[:, :, None, None], left.value, np.float32(0.0))
    power = np.square(data.model).sum((2, 3), dtype=np.float64)
    size = np.sqrt(np.square(value).sum((2, 3), dtype=np.float64) / np.maximum(power, 1e-30))
    # where no recorded pattern is near, what is estimated is nothing
    told = left.variance.sum((2, 3), dtype=np.float64) < TOLD * left.prior.sum((2, 3), dtype=np.float64)
    changed &= own | told
    origin = np.where(changed & (facts.origin != Origin.OUTLIER), Origin.HYBRID, facts.origin)
    value *= changed[:, :, None, None]
    error = fit.left_out_error
    share = error.value if left.kind.empty else error.statistical
    base = model_uncertainty(data.model, math.hypot(share, ERRORS[Fineness.finest]))
    beyond = np.where(changed[:, :, None, None], left.variance, left.prior)
    known = replace(facts, origin=origin.astype(np.uint8))
    return Plane(data.model + value, known, np.sqrt(np.square(base) + beyond)), np.where(changed, size, 0.0)
