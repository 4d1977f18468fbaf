"""Model H with what was measured beyond it: less noise than the recorded patterns, nearer to them than the model.

Of every recorded pattern what belongs to it alone, the lamp's brightness and the source beside its place, is taken out
first where it matters, for H has neither. Where residuals are noise the hybrid is the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
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
from lfcal.psf import Facts, Origin, PSFMatrix, stacked

__all__ = [
    "HybridPlane",
    "HybridSummary",
    "hybrid_note",
    "iter_hybrid",
    "iter_hybrid_planes",
]

F4 = NDArray[np.float32]


TOLD = 0.95
"""Share of the variance that must be left at most for a position to follow its neighbours."""


@dataclass(frozen=True, eq=False)
class HybridPlane:
    """One plane of the hybrid H.

    Attributes
    ----------
    values, uncertainty
        Every entry ``(ny, nx, nt, ns)`` and its standard deviation.
    facts
        Which positions were recorded, and where each pattern comes from.
    changed
        How far each position's pattern is from the model's ``(ny, nx)``, as rms over rms of its light.
    supported
        Whether positions between recorded ones follow them.
    """

    values: F4
    uncertainty: F4
    facts: Facts
    changed: NDArray[np.float64]
    supported: bool


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


def iter_hybrid_planes(
    fit: Fitted,
    source: PSFMatrix | Measured,
    take: Callable[[int, HybridPlane], object],
    *,
    noise: tuple[float, float] | None = None,
    workers: int | None = None,
) -> Work[HybridSummary]:
    """Compute the hybrid H one plane after the other; yields progress in rows and tiles.

    Parameters
    ----------
    fit
        The fit whose model is the base.
    source
        Recorded patterns of the same scan, those that were not fitted among them.
    take
        Is handed the number of each plane and the plane.
    noise
        Constant and slope of a sample's variance; None takes what the source states.
    workers
        Threads; None takes every processor.

    Raises
    ------
    InputError
        If the patterns are of another scan, or their noise is not known.
    """
    recorded = RecordedPatterns.of(source, fit.planned, noise)
    found: list[tuple[Facts, NDArray[np.float64]]] = []
    for z in range(fit.planned.shape[0]):
        model = yield from fit.iter_plane(z, workers)
        data, facts = yield from iter_plane_data(fit, recorded, z, model, workers)
        left = yield from iter_leftover(data, f"beyond the model, plane {z}", seed=z, workers=workers)
        plane = _joined(fit, data, facts, left)
        assert plane.facts.origin is not None
        found.append((plane.facts, plane.changed))
        take(z, plane)
    return HybridSummary.of(found)


def iter_hybrid(
    fit: Fitted,
    source: PSFMatrix | Measured,
    *,
    noise: tuple[float, float] | None = None,
    workers: int | None = None,
) -> Work[PSFMatrix]:
    """Compute the hybrid H in memory; see `iter_hybrid_planes`."""
    shape = fit.planned.shape
    values, spread = np.empty(shape, np.float32), np.empty(shape, np.float32)
    facts: list[Facts] = []

    def take(z: int, plane: HybridPlane) -> None:
        values[z], spread[z] = plane.values, plane.uncertainty
        facts.append(plane.facts)

    summary = yield from iter_hybrid_planes(fit, source, take, noise=noise, workers=workers)
    return PSFMatrix(
        values,
        depths=fit.planned.depths_um,
        camera=fit.camera,
        anchor=fit.planned.anchor,
        facts=stacked(facts),
        uncertainty=spread,
        provenance=fit.provenance | hybrid_note(summary),
    )


def hybrid_note(summary: HybridSummary) -> dict[str, Any]:
    """Return what a hybrid H says of itself in its provenance, beside what the fit says."""
    return {"hybrid": asdict(summary)}


def _joined(fit: Fitted, data: PlaneResiduals, facts: Facts, left: Leftover) -> HybridPlane:
    """Return the plane of model and estimate, where the estimate is better than none."""
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
    return HybridPlane(
        data.model + value,
        np.sqrt(np.square(base) + beyond),
        replace(facts, origin=origin.astype(np.uint8)),
        np.where(changed, size, 0.0),
        left.kind.supported,
    )
