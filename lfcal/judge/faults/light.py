"""Light of the source over the scan: drift of the lamp, exposure, flicker, and drift of the focus."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan
from lfcal.judge._patch import Patch
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FaultPicture, FoundFault, PutIn
from lfcal.judge.faults._series import ENOUGH, SURE, robust, scan_order, sharpest_step, usual
from lfcal.judge.faults.places import late, only_recorded, place_map, share_of

__all__ = ["FAULTS", "ExposureFault", "Flicker", "FocusDrift", "Lamp"]

F8 = NDArray[np.float64]

WORTH = 0.02
"""Change of the light above which it is reported."""

STEEP = 4.0
"""Multiple of the typical change of the light at which single changes are limited."""

ODD = 0.25
"""Difference of a frame's light from its neighbours above which it is unusual."""


def _gains(evidence: Evidence) -> tuple[F8, F8]:
    """Return the light of each pattern relative to the light of its plane, minus 1, and its standard deviation."""
    values, sigmas = evidence.column("gain")
    out, errors = np.zeros(len(values)), np.full(len(values), np.inf)
    for z in np.unique(evidence.index[:, 0]):
        own = (evidence.index[:, 0] == z) & np.isfinite(sigmas)
        middle = float(np.median(values[own])) if own.any() else 0.0
        if middle > 0:
            out[own], errors[own] = values[own] / middle - 1, sigmas[own] / middle
    return out, errors


def _amid(evidence: Evidence) -> tuple[F8, F8]:
    """Return the light of each pattern relative to the middle of its plane's range, minus 1, and its sigma.

    Where light jumps in all planes, the median of a plane follows the side on which more patterns were compared.
    """
    gains, sigmas = _gains(evidence)
    for z in np.unique(evidence.index[:, 0]):
        own = (evidence.index[:, 0] == z) & np.isfinite(sigmas)
        even = own & ~evidence.asked
        if own.any():
            middle = 1 + float(np.quantile(gains[even if even.any() else own], (0.2, 0.8)).mean())
            gains[own], sigmas[own] = (1 + gains[own]) / middle - 1, sigmas[own] / middle
    return gains, sigmas


def _within(plan: ScanPlan, index: NDArray[np.intp]) -> F8:
    """Return the time of each pattern within the scan of its plane, from -0.5 to 0.5 ``(n,)``."""
    ny, nx = plan.period
    _, y, x = index.T
    found: F8 = (y * nx + np.where(y % 2, nx - 1 - x, x) + 0.5) / (ny * nx) - 0.5
    return found


class ExposureFault(Fault):
    """Single frames with a different exposure."""

    name = "exposure"
    title = "single frames with another exposure"
    subject = "light"
    rank = 40
    advice = "Switch off automatic exposure, and record these positions again."
    settles: ClassVar[tuple[str, ...]] = ("flicker",)

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault with the frames whose light differs strongly from the median of their plane.

        Nothing is yielded if more than 20 % of all frames are estimated to differ.
        """
        gains, sigmas = _gains(evidence)
        most = usual(gains, sigmas)
        if most is None:
            return
        scatter = max(1e-4, most.scatter)
        bad = np.flatnonzero(most.good & (np.abs(gains) > max(ODD, 10 * scatter)) & (np.abs(gains) > SURE * sigmas))
        if not bad.size or evidence.extent(bad) > 0.2:
            return
        worst = bad[np.argmax(np.abs(gains[bad]))]
        place = tuple(int(v) for v in evidence.index[worst])
        many = "1 frame" if bad.size == 1 else f"{bad.size} frames"
        ratio = f"{1 + gains[worst]:.2f}"
        light = "no light" if ratio in ("0.00", "-0.00") else f"{ratio} times the expected light"
        yield FoundFault(
            self,
            f"{many} of {len(evidence)} compared; the worst, at {place}, has {light}",
            float(abs(gains[worst]) / max(scatter, float(sigmas[worst]))),
            float(np.abs(gains[bad]).mean()) * evidence.extent(bad),
            positions=evidence.index[bad],
            picture=place_map(evidence, 1 + gains, "ratio", "light relative to that of the plane"),
            redo=True,
            put_in=only_recorded(evidence.index[bad]),
            extent=evidence.likely_extent(bad),
        )


class Lamp(Fault):
    """Light that rises or falls during the scan, or jumps."""

    name = "lamp"
    title = "lamp drift during the scan"
    subject = "light"
    rank = 41
    advice = "Let the lamp warm up, or record reference frames to correct its drift."
    settles: ClassVar[tuple[str, ...]] = ("lamp", "plane_energy")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault for the sharpest jump of the light, or else for its trend over the scan of a plane."""
        gains, sigmas = _gains(evidence)
        z = evidence.index[:, 0]
        rows = [np.where(z == plane, 1.0, 0.0) for plane in np.unique(z)]
        time = _within(evidence.plan, evidence.index)
        found, errors, _ = robust(np.stack([*rows, time], 1), gains, sigmas)
        trend, error = float(found[-1]), float(errors[-1])
        step = sharpest_step(scan_order(evidence.index), gains, sigmas)
        each = None
        if len(rows) > 1:
            each = sharpest_step(np.argsort(time, kind="stable"), *_amid(evidence))
        if step is None or (each is not None and each.sigmas > step.sigmas):
            step = each
        if step is not None and step.sigmas > SURE and abs(step.size) > WORTH:
            first = tuple(int(v) for v in evidence.index[step.after[0]])
            where = f"{first[1:]} onwards in every plane" if step is each else f"{first} onwards"
            detail, reported, size = f"{100 * step.size:+.1f} % from {where}", step.sigmas, abs(step.size)
        elif abs(trend) > SURE * error and abs(trend) > WORTH:
            detail, reported, size = f"{100 * trend:+.1f} % over the scan of a plane", abs(trend) / error, abs(trend)
        else:
            return

        def light(index: NDArray[np.intp]) -> F8:
            if step is not None and abs(step.size) == size:
                if step is each:
                    after = _within(evidence.plan, index) >= time[step.after[0]]
                else:
                    after = late(evidence.plan, index, evidence.index[step.after[0]])
                return np.where(after, 1 + step.size / 2, 1 - step.size / 2)[:, None, None]
            return (1 + trend * _within(evidence.plan, index))[:, None, None]

        order = scan_order(evidence.index)
        yield FoundFault(
            self,
            detail,
            float(reported),
            size / 4,
            picture=FaultPicture(100 * gains[order], "%", "light relative to the plane", ("pattern in scan order",)),
            repair=lambda index, patterns: (patterns / light(index)).astype(np.float32),
            put_in=lambda patch: (patch.light * light(patch.index)).astype(np.float32),
        )


class Flicker(Fault):
    """Light that differs from frame to frame."""

    name = "flicker"
    title = "flickering lamp"
    subject = "light"
    rank = 42
    advice = "Stabilise the current of the lamp, or expose for a whole number of mains periods."
    settles: ClassVar[tuple[str, ...]] = ("flicker",)

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if the light differs from pattern to pattern by more than its standard errors explain."""
        gains, sigmas = _gains(evidence)
        most = usual(gains, sigmas)
        if most is None:
            return
        order = scan_order(evidence.index)
        # suspect patterns are the most unusual of all
        order = order[(most.good & ~evidence.asked)[order]]
        if len(order) < ENOUGH:
            return
        # between neighbours in time, because slow changes are drift of the lamp
        steps = np.abs(np.diff(gains[order])) / np.sqrt(2)
        scatter = 1.4826 * float(np.median(steps))
        chance = float(np.median(sigmas[order]))
        # medians detect flicker without the influence of single frames; the mean square measures its size better
        mean = float(np.square(np.minimum(steps, STEEP * scatter)).mean())
        rms = float(np.sqrt(max(0.0, mean - chance**2)))
        if rms < WORTH or (scatter / chance - 1) * np.sqrt(len(order)) < SURE:
            return
        yield FoundFault(
            self,
            f"{100 * rms:.1f} % (rms) from frame to frame",
            float((scatter / chance - 1) * np.sqrt(len(order))),
            rms,
            picture=FaultPicture(100 * gains[order], "%", "light relative to the plane", ("pattern in scan order",)),
            put_in=lambda patch: patch.light * _scattered(len(patch.index), 1.0, rms).astype(np.float32)[:, None, None],
            scatters=True,
        )


def _scattered(count: int, mean: float, rms: float) -> F8:
    """Return values that scatter like those of a lamp, identical in every run."""
    return np.maximum(0.0, mean + rms * np.random.default_rng(0).standard_normal(count))


class FocusDrift(Fault):
    """Depth that changes during the scan of a plane."""

    name = "focus_drift"
    title = "focus drift during the scan"
    subject = "light"
    rank = 52
    advice = "Let camera and stage warm up, check that the focus is stable, and record the plane again."

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault for each plane whose depth changes during its scan."""
        values, sigmas = evidence.column("depth")
        z = evidence.index[:, 0]
        for plane in np.unique(z).tolist():
            own = np.flatnonzero(z == plane)
            design = np.stack([np.ones(len(own)), _within(evidence.plan, evidence.index[own])], 1)
            found, errors, _ = robust(design, values[own], np.hypot(sigmas[own], 2e-4))
            if abs(found[1]) > SURE * errors[1] and abs(found[1]) > 0.005:
                yield FoundFault(
                    self,
                    f"plane {plane}: virtual depth changes by {100 * found[1]:+.2f} % over the scan",
                    float(abs(found[1]) / errors[1]),
                    share_of(evidence, abs(float(found[1])) / 4, ("depth",)),
                    positions=evidence.index[own],
                    picture=place_map(evidence, 100 * values, "%", "virtual depth relative to the plan"),
                    redo=True,
                    put_in=_drifting(plane, float(found[1])),
                )


def _drifting(plane: int, change: float) -> PutIn:
    def put_in(patch: Patch) -> NDArray[np.float32]:
        own = patch.index[:, 0] == plane
        return patch.moved(depth=np.where(own, change * _within(patch.evidence.plan, patch.index), 0.0))

    return put_in


FAULTS = (ExposureFault(), Lamp(), Flicker(), FocusDrift())
