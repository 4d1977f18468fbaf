"""Pixels of the sensor that are dead or hot, and a colour mosaic that was not separated."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, median_filter

from lfcal.judge._patch import Patch
from lfcal.judge._sensor_map import SensorMap, sensor_map
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FaultPicture, FoundFault, PutIn, Repair
from lfcal.judge.faults._series import SURE
from lfcal.judge.faults.sensor_lines import BRIGHT

__all__ = ["FAULTS", "BadPixels", "MosaicFault"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

DEAD, DUSTY = 0.3, 0.2
"""Fraction of the light that a single pixel must lack, and that each of several adjacent ones must lack."""

MOST = 0.02
"""Largest fraction of bad pixels on the sensor; more of them are not a fault of single pixels."""

TOGETHER = 4
"""Number of pixels, of three by three, that make a spot of dust."""

UNEVEN = 0.04
"""Smallest relative difference between the four pixels of a colour mosaic."""

LITTLE = 1e-4
"""Fraction of the light that pixels must add or remove."""

WIDE = 9
"""Side of the square with which a pixel is compared (pixels); spots of dust are a few pixels wide."""

SEEN = 0.05
"""Fraction of the brightest pixel's light that a pixel should receive to be called dead."""

AXES = ("row of the sensor (px)", "column of the sensor (px)")


class BadPixels(Fault):
    """Single pixels that lack light or add counts."""

    name = "bad_pixels"
    rank = 20
    title = "bad pixels of the sensor"
    subject = "sensor"
    advice = "Add these pixels to the defect map of the sensor, and assemble H again. No new recording is needed."
    settles: ClassVar[tuple[str, ...]] = ("hot_pixels", "misplaced", "seam", "step", "leak")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault with the pixels that differ from their surroundings, except those of faulty rows and columns.

        Nothing is yielded for a computed H.
        """
        if evidence.computed:
            return
        total = sensor_map(evidence)
        each = total.pixels()
        peak = float(evidence.light.max())
        hot, hot_reported = _apart(each.offset, each.offset_sigma)
        # at the edges of the scanned part, the tails of a few patterns carry little information
        lit = total.light > SEEN * float(total.light.max())
        dim, dim_reported = _apart(each.gain, each.gain_sigma, lit)
        dark = (dim_reported < -SURE) & (dim < -DUSTY) & lit
        spots = convolve(dark.astype(np.intp), np.ones((3, 3), np.intp), mode="constant") >= TOGETHER
        bad = ((hot_reported > SURE) & (hot > 10 * BRIGHT * peak)) | (dark & ((dim < -DEAD) | spots))
        # a line is a separate fault
        for axis in (0, 1):
            many = bad.sum(1 - axis) > 0.2 * bad.shape[1 - axis]
            bad &= ~(many[:, None] if axis == 0 else many[None, :])
        if not bad.any() or bad.mean() > MOST:
            return
        bad = _in_most(evidence, bad, np.where(hot_reported > SURE, hot, 0.0), dim)
        if not bad.any():
            return
        pixels = np.argwhere(bad)
        worst = float(np.maximum(np.abs(hot_reported), np.abs(dim_reported))[bad].max())
        more = " and more" if len(pixels) > 3 else ""
        some = ", ".join(f"({r}, {c})" for r, c in pixels[:3].tolist())
        lost = np.sqrt(total.light) * np.clip(-dim, 0, 1) / max(float(np.sqrt(total.light).sum()), 1e-300)
        counts = float(np.maximum(evidence.light, 0).sum((1, 2)).mean())
        share = float(np.abs(hot[bad]).sum()) / max(counts, 1e-300) + float(lost[bad].sum())
        if share < LITTLE:
            return
        yield FoundFault(
            self,
            f"{'1 pixel' if len(pixels) == 1 else f'{len(pixels)} pixels'}: {some}{more}",
            worst,
            share,
            pixels=pixels.astype(np.intp),
            picture=FaultPicture(hot, "counts", "counts relative to the neighbours", AXES),
            repair=_bridged(bad),
            blinds=True,
            put_in=_recorded_at(bad),
        )


def _in_most(evidence: Evidence, bad: NDArray[np.bool_], hot: F8, dim: F8) -> NDArray[np.bool_]:
    """Return the bad pixels that are bad in most patterns by weight, because an error elsewhere also causes spots.

    Parameters
    ----------
    evidence
        The compared patterns.
    bad
        Pixels of the sensor ``(rows, columns)``.
    hot, dim
        Added counts, 0 for pixels that are not hot; relative change of the light, negative for dim pixels.
    """
    nt, ns = evidence.plan.cutout
    found = np.zeros_like(bad)
    for row, column in np.argwhere(bad).tolist():
        t, s = (np.array([row, column]) - evidence.corners()).T
        own = np.flatnonzero((t >= 0) & (t < nt) & (s >= 0) & (s < ns))
        left, light, weight = (part[own, t[own], s[own]] for part in (evidence.left, evidence.light, evidence.weight))
        if hot[row, column]:
            alike = left > hot[row, column] / 2
        else:
            alike, weight = left < light * dim[row, column] / 2, weight * np.square(light)
        found[row, column] = weight[alike].sum() > weight.sum() / 2
    return found


def _recorded_at(bad: NDArray[np.bool_]) -> PutIn:
    """Return a function that puts the recorded values of pixels into patterns, where they may be only noise."""

    def put_in(patch: Patch) -> F4:
        return np.where(patch.seen(bad.astype(np.float64)) > 0, patch.recorded, patch.light)

    return put_in


def _apart(values: F8, sigmas: F8, usual: NDArray[np.bool_] | None = None) -> tuple[F8, F8]:
    """Return the values of pixels minus the median of their surroundings, and this difference in standard deviations.

    The scatter of the ``usual`` pixels (None: of all) counts as noise.
    """
    good = np.isfinite(sigmas)
    filled = np.where(good, values, 0.0)
    off = filled - median_filter(filled, size=WIDE, mode="nearest")
    own = good if usual is None or not (good & usual).any() else good & usual
    common = 1.4826 * float(np.median(np.abs(off[own]))) if own.any() else 0.0
    return off, np.where(good, off / np.hypot(np.where(good, sigmas, 1.0), common), 0.0)


def _bridged(bad: NDArray[np.bool_]) -> Repair:
    """Return a function that replaces pixels of the sensor by the mean of their good neighbours."""

    def repair(index: NDArray[np.intp], patterns: F4) -> F4:
        out = patterns.copy()
        nt, ns = patterns.shape[1:]
        for row, column in np.argwhere(bad).tolist():
            near = [(row + i, column + j) for i, j in ((-1, 0), (1, 0), (0, -1), (0, 1))]
            near = [(r, c) for r, c in near if 0 <= r < bad.shape[0] and 0 <= c < bad.shape[1] and not bad[r, c]]
            t, s = row - index[:, 1], column - index[:, 2]
            for n in np.flatnonzero((t >= 0) & (t < nt) & (s >= 0) & (s < ns)).tolist():
                y, x = index[n, 1:].tolist()
                sound = [patterns[n, r - y, c - x] for r, c in near if 0 <= r - y < nt and 0 <= c - x < ns]
                if sound:
                    out[n, t[n], s[n]] = np.mean(sound)
        return out

    return repair


class MosaicFault(Fault):
    """The filters of a colour sensor are visible in the patterns."""

    name = "mosaic"
    rank = 14
    title = "colour mosaic not separated"
    subject = "sensor"
    advice = "Assemble one channel, or demosaic the frames with the filter pattern of the sensor."
    settles: ClassVar[tuple[str, ...]] = ("lamp", "flicker", "jitter", "stage_gain", "drift", "misplaced")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a fault if the four pixels of each block of 2 x 2 differ systematically."""
        total = sensor_map(evidence)
        four = total.classes(2, 2)
        # by the median over lines, because a single dead line is not a mosaic
        gains = _by_lines(total)
        sigmas = four.gain_sigma
        reported = float((np.abs(gains) / sigmas).max())
        if reported < SURE or float(np.ptp(gains)) < UNEVEN:
            return
        ratios = 1 + gains
        words = ", ".join(f"{v:.2f}" for v in (ratios / ratios.max()).ravel())

        def repair(index: NDArray[np.intp], patterns: F4) -> F4:
            rows, columns = (index[:, 1 + k, None] + np.arange(patterns.shape[1 + k]) for k in (0, 1))
            seen = ratios[rows[:, :, None] % 2, columns[:, None, :] % 2]
            found: F4 = (patterns / np.maximum(seen, 0.05)).astype(np.float32)
            return found

        yield FoundFault(
            self,
            f"the pixels of a 2 x 2 block receive {words} of the light",
            reported,
            float(np.abs(gains).mean()),
            picture=FaultPicture(
                ratios, "ratio", "light of the pixels of a 2 x 2 block", ("row modulo 2", "column modulo 2")
            ),
            repair=repair,
            put_in=lambda patch: patch.light * patch.seen(_tiled(ratios / ratios.mean(), total.weight.shape)),
        )


def _tiled(four: F8, shape: tuple[int, ...]) -> F8:
    rows, columns = shape
    return np.tile(four, (rows // 2 + 1, columns // 2 + 1))[:rows, :columns]


def _by_lines(total: SensorMap) -> F8:
    """Return the gains of the four pixels of a 2 x 2 block minus their mean, as medians over single pixels."""
    each = total.pixels()
    lit = each.gain_sigma < 4 * np.min(each.gain_sigma)
    four = np.array(
        [
            [np.median(each.gain[i::2, j::2][lit[i::2, j::2]]) if lit[i::2, j::2].any() else 0.0 for j in (0, 1)]
            for i in (0, 1)
        ]
    )
    gains: F8 = four - four.mean()
    return gains


FAULTS = (BadPixels(), MosaicFault())
