"""Rows and columns of the sensor that are dead, dim or hot, and different offsets of all rows or columns."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from lfcal.judge._sensor_map import Lines, SensorMap, sensor_map
from lfcal.judge.evidence import Evidence
from lfcal.judge.fault import Fault, FaultPicture, FoundFault, PutIn, Repair
from lfcal.judge.faults._series import SURE

__all__ = ["FAULTS", "DeadLine", "HotLine", "LineOffsets"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

AXES = ("row", "column")

DIM = 0.08
"""Smallest fraction of the light that a line must lack, because pixels differ by one or two percent."""

NEAR = 9
"""Number of neighbouring lines for comparison, because errors of the model change slowly from line to line."""

LITTLE = 0.002
"""Fraction of the light that lines must lack; at the patterns' edges, the model's error is tens of percent."""

SEEN = 0.3
"""Fraction of the light of neighbouring lines that a line must receive to be called dead. Between small lenslets, and
at the edges of the scanned part, the error of the model exceeds the light."""

USUAL, PART = 0.02, 0.3
"""Fraction of the light by which a camera may be wrong, and the fraction of any larger error that lines must
explain."""

BRIGHT = 2e-4
"""Offset of a line, relative to the brightest light, above which it is reported."""


def standing_out(values: F8, sigmas: F8) -> tuple[F8, F8]:
    """Return the values of lines minus the median of their neighbours, and this difference in standard deviations.

    ``sigmas`` are the standard errors of ``values``. A value is unknown if its error is not finite. Its difference in
    standard deviations is then 0. The scatter of lines among themselves counts as noise.
    """
    known = np.where(np.isfinite(sigmas), values, np.nan)
    filled = np.where(np.isnan(known), np.nanmedian(known) if np.isfinite(known).any() else 0.0, known)
    off = filled - median_filter(filled, size=NEAR, mode="nearest")
    good = np.isfinite(sigmas)
    common = 1.4826 * float(np.median(np.abs(off[good]))) if good.any() else 0.0
    reported = np.where(good, off / np.hypot(np.where(good, sigmas, 1.0), common), 0.0)
    return off, reported


def bridged(axis: int, lines: NDArray[np.intp]) -> Repair:
    """Return a function that replaces lines of the sensor by the mean of the nearest good line on each side.

    ``axis`` is 0 for rows and 1 for columns; ``lines`` are their indices in the scanned part of the sensor. Good lines
    outside a pattern are not used; without one inside, the line is not replaced.
    """
    bad = set(lines.tolist())

    def repair(index: NDArray[np.intp], patterns: F4) -> F4:
        out = patterns.copy()
        size = patterns.shape[1 + axis]
        for line in sorted(bad):
            beside = [
                next(k for k in range(line + way, line + way * (len(bad) + 2), way) if k not in bad) for way in (-1, 1)
            ]
            for n in np.flatnonzero((index[:, 1 + axis] <= line) & (line < index[:, 1 + axis] + size)).tolist():
                first = int(index[n, 1 + axis])
                sound = [np.take(patterns[n], k - first, axis=axis) for k in beside if 0 <= k - first < size]
                if sound:
                    place = (line - first, slice(None)) if axis == 0 else (slice(None), line - first)
                    out[n][place] = np.mean(sound, axis=0)
        return out

    return repair


def shifted(axis: int, offsets: F8) -> Repair:
    """Return a function that subtracts the offsets of sensor rows (``axis`` 0) or columns (1) from patterns.

    ``offsets`` contains one value for each line of the scanned part of the sensor.
    """

    def repair(index: NDArray[np.intp], patterns: F4) -> F4:
        size = patterns.shape[1 + axis]
        own = offsets[index[:, 1 + axis, None] + np.arange(size)].astype(np.float32)
        found: F4 = patterns - (own[:, :, None] if axis == 0 else own[:, None, :])
        return found

    return repair


def lit(axis: int, gains: F8, shape: tuple[int, ...]) -> PutIn:
    """Return a function that multiplies the light on each sensor row (``axis`` 0) or column (1) by its gain.

    ``gains`` contains one value for each line of the scanned part of the sensor, which has the ``shape`` (rows,
    columns).
    """
    image = np.ones(shape) * (gains[:, None] if axis == 0 else gains)
    return lambda patch: patch.light * patch.seen(image)


def added(image: F8) -> PutIn:
    """Return a function that adds to each pattern the part of ``image`` that the cutout of the pattern covers.

    ``image`` shows the scanned part of the sensor.
    """
    return lambda patch: patch.light + patch.seen(image)


def _pixels(axis: int, lines: NDArray[np.intp], shape: tuple[int, ...]) -> NDArray[np.intp]:
    along_it = np.arange(shape[1 - axis])
    pairs = [np.stack([np.full_like(along_it, line), along_it], 1)[:, :: 1 if axis == 0 else -1] for line in lines]
    return np.concatenate(pairs).astype(np.intp) if pairs else np.empty((0, 2), np.intp)


def _named(axis: int, lines: NDArray[np.intp]) -> str:
    word = AXES[axis] + ("s" if len(lines) > 1 else "")
    shown = ", ".join(str(int(k)) for k in lines[:4])
    return f"{word} {shown}" + (f" and {len(lines) - 4} more" if len(lines) > 4 else "")


def _curve(values: F8, unit: str, title: str, axis: int) -> FaultPicture:
    return FaultPicture(
        np.where(np.isfinite(values), values, np.nan), unit, title, (f"{AXES[axis]} of the sensor (px)",)
    )


class DeadLine(Fault):
    """Lines whose pixels receive less light than their neighbours."""

    name = "dead_line"
    title = "dead or dim line of the sensor"
    subject = "sensor"
    rank = 10
    advice = "Add the line to the defect map of the sensor and assemble H again. No new recording is needed."
    settles: ClassVar[tuple[str, ...]] = (
        "stage_gain",
        "jitter",
        "flicker",
        "snr",
        "misplaced",
        "hot_pixels",
    )

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield one fault for the rows with significantly less light than their neighbours, and one for such columns.

        Nothing is yielded for a computed H.
        """
        if evidence.computed:
            return
        total = sensor_map(evidence)
        for axis in (0, 1):
            lines = total.lines(axis)
            off, reported = standing_out(lines.gain, lines.gain_sigma)
            bad = np.flatnonzero((reported < -SURE) & (off < -DIM))
            each = total.pixels()
            bad = bad[_whole(axis, bad, -each.gain, each.gain_sigma, -off)]
            light = np.sqrt(total.light).sum(1 - axis)
            bad = bad[(light > SEEN * median_filter(light, size=NEAR, mode="nearest"))[bad]]
            if not bad.size or bad.size > 0.1 * reported.size:
                continue
            share = _share(total, axis, bad, np.abs(off[bad]))
            if share < LITTLE or not _explain(evidence, axis, bad):
                continue
            worst = int(bad[np.argmin(off[bad])])
            lost = -float(off[worst])
            gains = np.where(np.isin(np.arange(off.size), bad), np.maximum(1 + off, 0), 1.0)
            yield FoundFault(
                self,
                f"{_named(axis, bad)} of the scanned region: {100 * min(lost, 1):.0f} % of the light is missing",
                float(-reported[worst]),
                share,
                pixels=_pixels(axis, bad, total.weight.shape),
                picture=_curve(100 * off, "%", "light relative to the neighbours", axis),
                repair=bridged(axis, bad),
                blinds=True,
                put_in=lit(axis, gains, each.gain.shape),
            )


class HotLine(Fault):
    """Lines whose pixels add counts."""

    name = "hot_line"
    title = "hot line of the sensor"
    subject = "sensor"
    rank = 11
    advice = "Subtract a dark frame of the same exposure, or add the line to the defect map. Then assemble H again."
    settles: ClassVar[tuple[str, ...]] = (
        "stage_gain",
        "jitter",
        "flicker",
        "background",
        "hot_pixels",
        "leak",
        "misplaced",
        "truncation",
    )

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield one fault for the rows with significantly more counts than their neighbours, and one for such columns.

        Nothing is yielded for a direction with too many such lines.
        """
        total = sensor_map(evidence)
        peak = float(evidence.light.max())
        for axis in (0, 1):
            lines = total.lines(axis)
            off, reported = standing_out(lines.offset, lines.offset_sigma)
            bad = np.flatnonzero((reported > SURE) & (off > 5 * BRIGHT * peak))
            each = total.pixels()
            bad = bad[_whole(axis, bad, each.offset, each.offset_sigma, off)]
            if not bad.size or bad.size > 0.1 * reported.size or _many(lines, off):
                continue
            worst = int(bad[np.argmax(off[bad])])
            clean = np.where(np.isin(np.arange(off.size), bad), off, 0.0)
            yield FoundFault(
                self,
                f"{_named(axis, bad)} of the scanned region: {off[worst]:.3g} counts too high",
                float(reported[worst]),
                _added(evidence, off[bad]),
                pixels=_pixels(axis, bad, total.weight.shape),
                picture=_curve(off, "counts", "counts relative to the neighbours", axis),
                repair=shifted(axis, clean),
                put_in=added(_along(axis, clean, each.gain.shape)),
            )


class LineOffsets(Fault):
    """Every row or column has a different offset."""

    name = "line_offsets"
    title = "different offsets of sensor rows or columns"
    subject = "sensor"
    rank = 12
    advice = "Subtract a dark frame of the same exposure and temperature, and assemble H again."
    settles: ClassVar[tuple[str, ...]] = ("leak", "background", "flicker", "jitter", "misplaced", "truncation")

    def found(self, evidence: Evidence) -> Iterable[FoundFault]:
        """Yield a single fault if the offsets of rows or of columns scatter significantly."""
        total = sensor_map(evidence)
        peak = float(evidence.light.max())
        both = [one for axis in (0, 1) if (one := _Offsets.of(total.lines(axis), axis, peak)) is not None]
        if not both:
            return
        worst = max(both, key=lambda one: one.rms)
        shape = total.weight.shape
        image = np.sum([_along(one.axis, one.likely, shape) for one in both], axis=0)
        yield FoundFault(
            self,
            "offsets of " + ", of ".join(f"{AXES[one.axis]}s scatter by {one.rms:.3g} counts (rms)" for one in both),
            max(one.sigmas for one in both),
            sum(_added(evidence, np.full(evidence.plan.cutout[one.axis], one.rms)) for one in both),
            picture=_curve(worst.shown, "counts", f"offset of each {AXES[worst.axis]}", worst.axis),
            repair=_all_of([shifted(one.axis, np.nan_to_num(one.shown)) for one in both]),
            put_in=added(image),
            scatters=True,
        )


@dataclass(frozen=True, eq=False)
class _Offsets:
    """Offsets of lines along an axis that scatter more than by chance.

    The value ``shown`` is NaN if no pixel was seen, and ``likely`` is corrected for the likely contribution of errors.
    The scatter of the offsets is ``rms`` (counts), and its significance in standard deviations is ``sigmas``.
    """

    axis: int
    shown: F8
    likely: F8
    rms: float
    sigmas: float

    @classmethod
    def of(cls, lines: Lines, axis: int, peak: float) -> _Offsets | None:
        """Return the offsets; None if they do not scatter significantly."""
        good = np.isfinite(lines.offset_sigma)
        off = lines.offset - np.median(lines.offset[good])
        spread = 1.4826 * float(np.median(np.abs(off[good])))
        chance = float(np.median(lines.offset_sigma[good]))
        own = float(np.sqrt(max(0.0, spread**2 - chance**2)))
        sigmas = float((spread / chance - 1.0) * np.sqrt(2.0 * good.sum()))
        if sigmas < SURE or own < BRIGHT * peak:
            return None
        return cls(axis, np.where(good, off, np.nan), _shrunk(off, lines.offset_sigma, own), own, sigmas)


def _all_of(repairs: Sequence[Repair]) -> Repair:
    """Return a function that applies several repairs, one after the other."""

    def repaired(index: NDArray[np.intp], patterns: F4) -> F4:
        for repair in repairs:
            patterns = repair(index, patterns)
        return patterns

    return repaired


def _along(axis: int, offsets: F8, shape: tuple[int, ...]) -> F8:
    image: F8 = np.zeros(shape) + (offsets[:, None] if axis == 0 else offsets)
    return image


def _shrunk(values: F8, sigmas: F8, spread: float) -> F8:
    """Return values shrunk by the likely contribution of their errors."""
    good = np.isfinite(sigmas)
    found: F8 = np.where(good, values * spread**2 / (spread**2 + np.square(np.where(good, sigmas, 0.0))), 0.0)
    return found


def _whole(axis: int, lines: NDArray[np.intp], pixels: F8, sigmas: F8, off: F8) -> NDArray[np.bool_]:
    """Return a mask of the lines that are faulty along most of their pixels, because a single pixel is not a line."""
    found = np.zeros(len(lines), np.bool_)
    for k, line in enumerate(lines.tolist()):
        own, sigma = (np.take(part, line, axis=axis) for part in (pixels, sigmas))
        seen = sigma < 0.5 * abs(off[line])
        found[k] = bool((own[seen] > 0.4 * off[line]).mean() > 0.5) if seen.any() else False
    return found


def _many(lines: Lines, off: F8) -> bool:
    """Return whether all lines scatter, so that the fault is not one of single lines."""
    good = np.isfinite(lines.offset_sigma)
    return 1.4826 * float(np.median(np.abs(off[good]))) > 3 * float(np.median(lines.offset_sigma[good]))


def _explain(evidence: Evidence, axis: int, lines: NDArray[np.intp]) -> bool:
    """Return whether lines explain their part of the error of the camera, which is smaller without them.

    Their fraction of the light is not a criterion, because a column through the brightest spots dominates the misfit.
    """
    beyond = evidence.misfit - USUAL
    if beyond <= 0:
        return True
    at = evidence.index[:, 1 + axis, None] + np.arange(evidence.data.shape[1 + axis])
    bad = np.isin(at, lines)
    valid = evidence.valid & ~(bad[:, :, None] if axis == 0 else bad[:, None, :])
    without = evidence.with_data(evidence.data, valid).misfit
    return bool(evidence.misfit**2 - without**2 > (PART * beyond) ** 2)


def _share(total: SensorMap, axis: int, bad: NDArray[np.intp], lost: F8) -> float:
    light = np.sqrt(total.light).sum(1 - axis)
    return float((light[bad] * np.minimum(lost, 1.0)).sum() / max(light.sum(), 1e-300))


def _added(evidence: Evidence, offsets: F8) -> float:
    """Return the counts that lines add to a pattern, as a fraction of its light."""
    across = min(evidence.plan.cutout)
    each = float(np.maximum(evidence.light, 0).sum((1, 2)).mean())
    return float(np.abs(offsets).sum()) * across / max(each, 1e-300)


FAULTS = (DeadLine(), HotLine(), LineOffsets())
