"""Helpers of faults: the light that a change affects, wrong or late positions, and maps."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan
from lfcal.judge._patch import Patch
from lfcal.judge.evidence import COLUMNS, Evidence
from lfcal.judge.fault import FaultPicture, PutIn

__all__ = ["late", "only_recorded", "place_map", "share_of"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]


def share_of(evidence: Evidence, amount: float, names: tuple[str, ...]) -> float:
    """Return the fraction of the light (relative L1) that changes if a parameter in ``names`` changes by ``amount``.

    The names are names of `COLUMNS` after the first two, and ``amount`` is in their unit. The result is the mean over
    the names.
    """
    light = max(float(np.abs(evidence.model).sum(dtype=np.float64)), 1e-300)
    change = [float(np.abs(evidence.columns[:, COLUMNS.index(n) - 2]).sum(dtype=np.float64)) for n in names]
    return amount * float(np.mean(change)) / light


def late(plan: ScanPlan, index: NDArray[np.intp], first: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return a mask ``(n,)`` of the positions ``index`` ``(n, 3)`` that are ``first`` or later in raster order."""
    shape = plan.shape[:3]
    found: NDArray[np.bool_] = np.ravel_multi_index(tuple(index.T), shape) >= np.ravel_multi_index(tuple(first), shape)
    return found


def only_recorded(positions: NDArray[np.intp]) -> PutIn:
    """Return a function that replaces the predicted patterns at ``positions`` ``(n, 3)`` by the recorded ones."""
    bad = set(map(tuple, positions.tolist()))

    def put_in(patch: Patch) -> F4:
        own = np.array([tuple(place) in bad for place in patch.index.tolist()], np.bool_)
        return np.where(own[:, None, None], patch.recorded, patch.light) if own.any() else patch.light

    return put_in


def place_map(evidence: Evidence, values: F8, unit: str, title: str) -> FaultPicture:
    """Return ``values`` ``(n,)`` of the patterns as a map over the positions of the plane in which they vary most.

    ``unit`` and ``title`` are the unit and the title of the values. Positions without a pattern are NaN.
    """
    z = evidence.index[:, 0]
    worst = max(np.unique(z).tolist(), key=lambda k: float(np.ptp(values[z == k])))
    found = np.full(evidence.plan.period, np.nan)
    own = z == worst
    found[evidence.index[own, 1], evidence.index[own, 2]] = values[own]
    return FaultPicture(found, unit, f"{title}, plane {worst}", ("position y (px)", "position x (px)"))
