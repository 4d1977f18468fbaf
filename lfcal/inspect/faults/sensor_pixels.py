"""Pixels of the sensor that are dead or hot, a colour mosaic left in, values that are not linear."""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, median_filter

from lfcal.inspect.evidence import Evidence
from lfcal.inspect.faults.sensor_lines import BRIGHT
from lfcal.inspect.faults.series import SURE
from lfcal.inspect.finding import Fault, Finding, Picture, PutIn, Repair
from lfcal.inspect.modelled import correlation
from lfcal.inspect.sensor_map import SensorMap, sensor_map

__all__ = ["FAULTS", "BadPixels", "Mosaic", "NotLinear"]

F4 = NDArray[np.float32]
F8 = NDArray[np.float64]

DEAD, DUSTY = 0.3, 0.2
"""Share of the light that a single pixel must lack, and that each of several together must."""

MOST = 0.02
"""Share of the sensor's pixels that may be bad: more of them are none of single ones."""

TOGETHER = 4
"""Pixels of three by three that make a spot of dust."""

UNEVEN = 0.04
"""Share by which the four pixels of a colour mosaic differ at least."""

CURVED = 0.02
"""Difference of an exponent from 1 that is worth a word."""

STRONG = 0.1
"""The same from which on exponents are tried: a derivative tells no more of it."""

EXPONENTS = np.geomspace(0.3, 3.0, 41)
"""Exponents that are tried."""

LIKE, GAINED = 0.99, 4.0
"""Correlation with the camera below which they are, and times as near to 1 that the best of them must bring it."""

LITTLE = 1e-4
"""Share of the light that pixels must add or take away."""

WIDE = 9
"""Pixels about one, each way, that it is held against: spots of dust are a few pixels wide."""

SEEN = 0.05
"""Share of the light of the best lit pixel that one must have had to be called dead."""

AXES = ("row of the sensor (px)", "column of the sensor (px)")


class BadPixels(Fault):
    """Single pixels that lack light or add counts."""

    name = "bad_pixels"
    rank = 20
    title = "bad pixels of the sensor"
    advice = "Add them to the sensor's defect map, and assemble H again; nothing need be recorded anew."
    settles: ClassVar[tuple[str, ...]] = ("hot_pixels", "truncation", "misplaced", "seam", "step", "leak")

    def found(self, evidence: Evidence) -> Iterable[Finding]:
        """Yield the pixels that stand out of their neighbours and of their row and column."""
        total = sensor_map(evidence)
        each = total.pixels()
        peak = float(evidence.light.max())
        hot, hot_told = _apart(each.offset, each.offset_sigma)
        # at the edges of the scanned part a few patterns' tails tell little
        lit = total.light > SEEN * float(total.light.max())
        dim, dim_told = _apart(each.gain, each.gain_sigma, lit)
        dark = (dim_told < -SURE) & (dim < -DUSTY) & lit
        spots = convolve(dark.astype(np.intp), np.ones((3, 3), np.intp), mode="constant") >= TOGETHER
        bad = ((hot_told > SURE) & (hot > 10 * BRIGHT * peak)) | (dark & ((dim < -DEAD) | spots))
        # a line has a fault of its own
        for axis in (0, 1):
            many = bad.sum(1 - axis) > 0.2 * bad.shape[1 - axis]
            bad &= ~(many[:, None] if axis == 0 else many[None, :])
        if not bad.any() or bad.mean() > MOST:
            return
        bad = _in_most(evidence, bad, np.where(hot_told > SURE, hot, 0.0), dim)
        if not bad.any():
            return
        pixels = np.argwhere(bad)
        worst = float(np.maximum(np.abs(hot_told), np.abs(dim_told))[bad].max())
        more = " and more" if len(pixels) > 3 else ""
        some = ", ".join(f"({r}, {c})" for r, c in pixels[:3].tolist())
        lost = np.sqrt(total.light) * np.clip(-dim, 0, 1) / max(float(np.sqrt(total.light).sum()), 1e-300)
        counts = float(np.maximum(evidence.light, 0).sum((1, 2)).mean())
        share = float(np.abs(hot[bad]).sum()) / max(counts, 1e-300) + float(lost[bad].sum())
        if share < LITTLE:
            return
        yield Finding(
            self,
            f"{'1 pixel' if len(pixels) == 1 else f'{len(pixels)} pixels'}: {some}{more}",
            worst,
            share,
            pixels=pixels.astype(np.intp),
            picture=Picture(hot, "counts", "counts beside those of the neighbours", AXES),
            repair=_bridged(bad),
            blinds=True,
            put_in=_put_in(bad, hot, hot_told, dim),
        )


def _in_most(evidence: Evidence, bad: NDArray[np.bool_], hot: F8, dim: F8) -> NDArray[np.bool_]:
    """Return which of the bad pixels are so in most patterns, by their weights: one of another place makes spots too.

    Parameters
    ----------
    evidence
        What was compared.
    bad
        Pixels of the sensor ``(rows, columns)``.
    hot, dim
        Counts that they add, 0 of those that lack light; by what share they lack it, less than 0.
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


def _put_in(bad: NDArray[np.bool_], hot: F8, hot_told: F8, dim: F8) -> PutIn:
    lit = np.where(bad & (hot_told > SURE), hot, 0.0)
    gains = np.where(bad & (lit == 0), np.maximum(1 + dim, 0), 1.0)
    return lambda patch: patch.light * patch.seen(gains) + patch.seen(lit)


def _apart(values: F8, sigmas: F8, usual: NDArray[np.bool_] | None = None) -> tuple[F8, F8]:
    """Return pixels less the median of those about them, and by how many standard deviations they differ from it.

    The scatter of pixels among themselves, of those that are ``usual`` of all, counts as noise.
    """
    good = np.isfinite(sigmas)
    filled = np.where(good, values, 0.0)
    off = filled - median_filter(filled, size=WIDE, mode="nearest")
    own = good if usual is None or not (good & usual).any() else good & usual
    common = 1.4826 * float(np.median(np.abs(off[own]))) if own.any() else 0.0
    return off, np.where(good, off / np.hypot(np.where(good, sigmas, 1.0), common), 0.0)


def _bridged(bad: NDArray[np.bool_]) -> Repair:
    """Return what replaces pixels of the sensor by the mean of their sound neighbours."""

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


class Mosaic(Fault):
    """The filters of a colour sensor, left in."""

    name = "mosaic"
    rank = 14
    title = "colour mosaic left in"
    advice = "Take one channel, or develop the frames: import them anew with the sensor's pattern."
    settles: ClassVar[tuple[str, ...]] = ("lamp", "flicker", "jitter", "stage_gain", "drift", "misplaced")

    def found(self, evidence: Evidence) -> Iterable[Finding]:
        """Yield how much the four pixels of two by two differ."""
        total = sensor_map(evidence)
        four = total.classes(2, 2)
        # by the median over lines: a single one that is dead makes no mosaic
        gains = _by_lines(total)
        sigmas = four.gain_sigma
        told = float((np.abs(gains) / sigmas).max())
        if told < SURE or float(np.ptp(gains)) < UNEVEN:
            return
        ratios = 1 + gains
        words = ", ".join(f"{v:.2f}" for v in (ratios / ratios.max()).ravel())

        def repair(index: NDArray[np.intp], patterns: F4) -> F4:
            rows, columns = (index[:, 1 + k, None] + np.arange(patterns.shape[1 + k]) for k in (0, 1))
            seen = ratios[rows[:, :, None] % 2, columns[:, None, :] % 2]
            found: F4 = (patterns / np.maximum(seen, 0.05)).astype(np.float32)
            return found

        yield Finding(
            self,
            f"pixels of two by two see {words} of the light",
            told,
            float(np.abs(gains).mean()),
            picture=Picture(ratios, "", "light of the pixels of two by two", ("row modulo 2", "column modulo 2")),
            repair=repair,
            put_in=lambda patch: patch.light * patch.seen(_tiled(ratios / ratios.mean(), total.weight.shape)),
        )


def _tiled(four: F8, shape: tuple[int, ...]) -> F8:
    rows, columns = shape
    return np.tile(four, (rows // 2 + 1, columns // 2 + 1))[:rows, :columns]


def _by_lines(total: SensorMap) -> F8:
    """Return the gains of the pixels of two by two, less their mean, by medians over single pixels."""
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


class NotLinear(Fault):
    """Values that are not proportional to the light."""

    name = "not_linear"
    # before lines and pixels: of bent values the model is off everywhere, and any line of them may stand out
    strong_rank = 8
    rank = 9
    title = "values not proportional to the light"
    advice = "Switch the camera's gamma and contrast off, or linearise the frames, and import them anew."
    settles: ClassVar[tuple[str, ...]] = ("background", "leak")

    def found(self, evidence: Evidence) -> Iterable[Finding]:
        """Yield the exponent of the light that values follow."""
        found, sigma = _bend(evidence)
        strong = _likeliest(evidence)
        if strong is None and abs(found) < max(CURVED, SURE * sigma):
            return
        peak = float(np.abs(evidence.data).max()) or 1.0
        exponent, told = (1 + found, abs(found) / sigma) if strong is None else strong
        now = evidence
        for _ in range(2):  # the derivative is that at an exponent of 1
            straight = _bent(evidence.data, 1 / exponent, peak)
            now = evidence.with_data(straight, evidence.valid)
            more, sigma = _bend(now)
            exponent *= 1 + more
        light = np.maximum(now.light, 0)

        def repair(index: NDArray[np.intp], patterns: F4) -> F4:
            del index
            return _bent(patterns, 1 / max(exponent, 0.1), peak)

        yield Finding(
            self,
            f"values follow the light to the power of {exponent:.3f} ± {sigma:.3f}",
            told,
            float(abs(exponent - 1) * np.abs(_curve(light)).sum() / max(float(light.sum()), 1e-300)),
            picture=_tone(evidence, light, peak),
            repair=repair,
            put_in=lambda patch: _bent(patch.light, exponent, peak),
        )


def _likeliest(evidence: Evidence) -> tuple[float, float] | None:
    """Return the exponent without which patterns are most like those of the camera, and by how much for the least sure.

    None where they are like them as they are, or not much more so without: a small bend is told by its derivative.
    """
    peak = float(np.abs(evidence.data).max()) or 1.0
    model = _without_mean(evidence.model, evidence.valid)
    alike = correlation(model, _without_mean(evidence.data, evidence.valid))
    if float(np.median(alike)) > LIKE:
        return None
    bent = (_bent(evidence.data, 1 / float(exponent), peak) for exponent in EXPONENTS)
    tried = [correlation(model, _without_mean(one, evidence.valid)) for one in bent]
    best = int(np.argmax([np.median(one) for one in tried]))
    gained = (1 - alike) / np.maximum(1 - tried[best], 1e-9)
    if abs(EXPONENTS[best] - 1) < STRONG or float(np.median(gained)) < GAINED:
        return None
    return float(EXPONENTS[best]), float(np.median(gained) * np.sqrt(len(gained)))


def _without_mean(patterns: F4, valid: NDArray[np.bool_]) -> F4:
    """Return patterns ``(n, nt, ns)`` less the mean of what is valid of each: a background is no bend."""
    mean = np.where(valid, patterns, 0).sum((1, 2)) / np.maximum(valid.sum((1, 2)), 1)
    found: F4 = np.where(valid, patterns - mean[:, None, None], 0).astype(np.float32)
    return found


def _bent(light: F4, exponent: float, peak: float) -> F4:
    found: F4 = (np.sign(light) * peak * (np.abs(light) / peak) ** np.float32(exponent)).astype(np.float32)
    return found


def _curve(light: F4) -> F4:
    """Return the derivative of light to a power by the exponent, at 1."""
    peak = float(light.max())
    found: F4 = np.where(light > 1e-4 * peak, light * np.log(np.maximum(light, 1e-30) / peak), 0.0).astype(np.float32)
    return found


def _bend(evidence: Evidence) -> tuple[float, float]:
    """Return by how much the exponent differs from 1, and its standard deviation."""
    values, sigmas = evidence.beyond(_curve(np.maximum(evidence.light, 0)))
    return _mean(values, sigmas) if np.isfinite(sigmas).any() else (0.0, np.inf)


def _mean(values: F8, sigmas: F8) -> tuple[float, float]:
    """Return the weighted mean and its standard deviation, by the scatter where that is larger."""
    good = np.isfinite(sigmas)
    weight = 1 / np.square(sigmas[good])
    mean = float((weight * values[good]).sum() / weight.sum())
    scatter = float(np.sqrt((weight**2 * np.square(values[good] - mean)).sum()) / weight.sum())
    return mean, max(scatter, float(1 / np.sqrt(weight.sum())))


def _tone(evidence: Evidence, light: F4, peak: float) -> Picture:
    edges = np.linspace(0.0, 1.0, 25) * peak
    which = np.digitize(light[evidence.valid], edges)
    seen = evidence.data[evidence.valid]
    means = np.array([seen[which == k].mean() if (which == k).any() else np.nan for k in range(1, len(edges))])
    return Picture(means, "counts", "mean value over the light it should be", ("light (counts)",), edges[:-1])


FAULTS = (BadPixels(), Mosaic(), NotLinear())
