"""Light that depends on each pattern's brightness, as with a camera that sets its exposure automatically."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.judge._patch import Patch
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FaultPicture, FoundFault, PutIn, adding
from lfcal.judge.faults._series import BETTER, FEW, SURE, robust, usual

__all__ = ["FAULTS", "AutoExposure"]

F4 = NDArray[np.float32]

WORTH = 0.02
"""Scatter of the light above which it is reported."""

FOLLOWS = 0.1
"""Smallest exponent with which the light must depend on the patterns' brightness."""


class AutoExposure(Fault):
    """Patterns with brighter peaks have less light: the camera changed its exposure or gain automatically."""

    name = "auto_exposure"
    title = "exposure that depends on the pattern"
    subject = "light"
    rank = 39
    advice = "Switch off automatic exposure and gain, and record again; or divide each frame by its exposure time."
    settles: ClassVar[tuple[str, ...]] = ("flicker", "lamp", "plane_energy")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if the light of patterns depends on their peak; it states the exponent of a power law."""
        values, sigmas = evidence.column("gain")
        tops = evidence.model.max((1, 2)).astype(np.float64)
        seen = np.isfinite(sigmas) & (values > 0) & (tops > 0)
        z = evidence.index[:, 0]
        planes = np.stack([np.where(z == plane, 1.0, 0.0) for plane in np.unique(z)], 1)
        if (planes[seen].sum(0) < FEW).any():
            return
        light, peaks = (np.log(np.where(seen, part, 1.0)) for part in (values, tops))
        errors = np.where(seen, sigmas / np.where(seen, values, 1.0), np.inf)
        # within planes: a plane that is dimmer as a whole has another fault
        found, reported, left = robust(np.concatenate([planes, peaks[:, None]], 1), light, errors)
        _, _, flat = robust(planes, light, errors)
        power, error = float(found[-1]), float(reported[-1])
        after, before = usual(left, errors), usual(flat, errors)
        if before is None or after is None or before.scatter < WORTH or after.scatter > BETTER * before.scatter:
            return
        if abs(power) < max(FOLLOWS, SURE * error):
            return
        alike = float(np.ptp(found[:-1])) < WORTH + FOLLOWS * abs(power)  # the same law in all planes
        law = np.exp(power * peaks)
        if not alike:
            law /= planes @ np.array([np.median(law[own > 0]) for own in planes.T])
        law = np.where(seen, law / np.median(law[seen]), 1.0)
        order = np.argsort(peaks)
        yield FoundFault(
            self,
            f"the light of patterns is proportional to their peak to the power of {power:+.2f} ± {error:.2f}",
            abs(power) / error,
            before.scatter,
            picture=FaultPicture(
                100 * (values / np.median(values[seen]) - 1)[order],
                "%",
                "light of patterns relative to the median",
                ("peak of the pattern relative to the largest",),
                tops[order] / tops.max(),
            ),
            repair=adding(evidence.index, evidence.data * (1 / law - 1)[:, None, None]),
            put_in=_exposed(power, alike=alike),
        )


def _exposed(power: float, *, alike: bool) -> PutIn:
    """Return a function that applies the power law to patterns, for all planes together (``alike``) or for each."""

    def put_in(patch: Patch) -> F4:
        tops = np.maximum(patch.light.max((1, 2)).astype(np.float64), 1e-300)
        z = patch.index[:, 0]
        for plane in np.unique(z):
            own = np.ones(len(z), np.bool_) if alike else z == plane
            tops[own] /= np.median(tops[own])
        found: F4 = (patch.light * (tops**power)[:, None, None]).astype(np.float32)
        return found

    return put_in


FAULTS = (AutoExposure(),)
