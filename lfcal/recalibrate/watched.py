"""Results of watching a series of frames: drifts, tests, trends, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from lfcal.base import plain
from lfcal.recalibrate.score import Goodness

__all__ = ["DRIFT_NAMES", "DriftTrend", "DriftWatch", "WatchedFrame", "WatchedMean"]

DRIFT_NAMES = {"shift_x_px": "shift x (px)", "shift_y_px": "shift y (px)", "gap_percent": "gap (%)"}
"""Measured drifts of the array, with their titles: all values are in this order."""

UNITS = ("px", "px", "%")

CLEAR = 3.0
"""Standard deviations above which a value or a slope is significant."""

FORMAT, VERSION = "lfcal-watch", 1

Three = tuple[float, float, float]


@dataclass(frozen=True)
class WatchedFrame:
    """Drift of the array in one frame.

    Attributes
    ----------
    name, when
        Label of the frame, and time of its recording; None if unknown.
    values, sigmas
        Shift of the array in x and y (px), change of the gap (%), and their standard deviations; NaN if not measured.
        They are relative to H, or to the mean drift of quiet frames if there are any.
    goodness
        Goodness of fit after this drift is taken into account; None if not measured.
    problem
        Reason why the frame is not used; empty if it is used.
    """

    name: str
    when: datetime | None
    values: Three = (math.nan, math.nan, math.nan)
    sigmas: Three = (math.nan, math.nan, math.nan)
    goodness: Goodness | None = None
    problem: str = ""


@dataclass(frozen=True)
class WatchedMean:
    """Drift in the mean of consecutive frames, and its test.

    Attributes
    ----------
    frames
        Names of the frames.
    values, sigmas
        As in `WatchedFrame`.
    t_squared
        Hotelling's T², the statistic of the test.
    chance
        Probability of a larger statistic while H is valid.
    alarm
        Whether the statistic is above the threshold.
    """

    frames: tuple[str, ...]
    values: Three
    sigmas: Three
    t_squared: float
    chance: float
    alarm: bool


@dataclass(frozen=True)
class DriftTrend:
    """Slope ``slope`` of the drift ``name``, and its standard deviation ``sigma``, per hour, day or frame (``per``).

    ``name`` is ``"shift_x_px"``, ``"shift_y_px"`` or ``"gap_percent"``.

    Examples
    --------
    >>> from lfcal.recalibrate import DriftTrend
    >>> DriftTrend("gap_percent", 0.02, 0.004, "hour").significant
    True
    """

    name: str
    slope: float
    sigma: float
    per: str

    @property
    def significant(self) -> bool:
        """Whether the slope differs from zero by more than `CLEAR` standard deviations."""
        return abs(self.slope) > CLEAR * self.sigma


@dataclass(frozen=True, eq=False)
class DriftWatch:
    """Result of testing whether H is still valid for the frames of a series.

    Attributes
    ----------
    frames, quiet
        The frames of the series, and those directly after the calibration.
    means
        Means of consecutive frames, or single frames, with their tests.
    significant
        Indices of the means that differ significantly from the calibration, corrected for the number of tests.
    moved
        Whether any of the means, or the mean of all frames, differs significantly from the calibration.
    values, sigmas
        Weighted mean drift of all used frames, or of the frames in ``significant`` means if there are any, and its
        standard deviations; units as in `WatchedFrame`.
    trends
        Trends of the three drifts; empty for fewer than three used frames.
    rate
        Probability that a mean is above the threshold while H is valid. The probability of a false verdict from all
        means together is the same.
    threshold
        Threshold of T².
    noise_stated
        Whether the threshold is based on the stated noise, because no quiet frames were given.

    Examples
    --------
    >>> from lfcal.recalibrate import DriftWatch, WatchedFrame, WatchedMean
    >>> shift, sigmas = (0.05, 0.0, 0.01), (0.004, 0.004, 0.03)
    >>> frames = (WatchedFrame("a.tif", None, shift, sigmas),)
    >>> means = (WatchedMean(("a.tif",), shift, sigmas, 160.0, 1e-9, True),)
    >>> found = DriftWatch(frames, (), means, (0,), True, shift, sigmas, (), 0.01, 11.3)
    >>> print(found.verdict)
    H is no longer valid: shift x +0.050 ± 0.004 px in 1 of 1 frames, first in a.tif; recalibrate with lfcal fit frames
    """

    frames: tuple[WatchedFrame, ...]
    quiet: tuple[WatchedFrame, ...]
    means: tuple[WatchedMean, ...]
    significant: tuple[int, ...]
    moved: bool
    values: Three
    sigmas: Three
    trends: tuple[DriftTrend, ...]
    rate: float
    threshold: float
    noise_stated: bool = True

    @property
    def unexplained(self) -> tuple[WatchedFrame, ...]:
        """Frames that were measured but that H does not explain with any drift."""
        return tuple(one for one in self.frames if one.problem and one.goodness is not None)

    @property
    def first_moved(self) -> int | None:
        """Index of the first frame of the series that differs significantly from the calibration; None without a drift.

        If only the mean of all frames differs significantly, this is 0.
        """
        if not self.moved:
            return None
        names = [one.name for one in self.frames]
        return min((names.index(self.means[k].frames[0]) for k in self.significant), default=0)

    @property
    def holds(self) -> bool | None:
        """Whether H is still valid.

        None if no drift is found, but half of the measured frames or more are `unexplained`.
        """
        if self.moved:
            return False
        measured = sum(one.goodness is not None for one in self.frames)
        return None if 2 * len(self.unexplained) >= max(1, measured) else True

    @property
    def verdict(self) -> str:
        """Verdict on H, as one sentence."""
        if self.holds is None:
            worst = max(one.goodness.ratio for one in self.unexplained if one.goodness is not None)
            return (
                f"undecided: H does not explain {_of(len(self.unexplained), len(self.frames))} (goodness of fit up to "
                f"{worst:.2f}); lfcal fit frames looks for the reason"
            )
        if self.holds:
            alarms = sum(one.alarm for one in self.means)
            words = _drift_words(self.values, self.sigmas, every=True)
            return f"H is still valid: {words}; {alarms} of {len(self.means)} above the threshold"
        moved = [self.means[k] for k in self.significant]
        count, every = (sum(len(one.frames) for one in means) for means in (moved, self.means))
        where = f"{_of(count, every)}, first in {moved[0].frames[0]}" if moved else f"the mean of {every} frames"
        drift = _drift_words(self.values, self.sigmas)
        return f"H is no longer valid: {drift} in {where}; recalibrate with lfcal fit frames"

    @property
    def basis(self) -> str:
        """Text that states how the threshold follows from the rate of false alarms."""
        rate = f"false alarms: {100 * self.rate:g} % for each tested value"
        if self.noise_stated:
            return f"{rate}, from a chi² distribution with 3 degrees of freedom and the stated noise"
        n = len([one for one in self.quiet if not one.problem])
        return f"{rate}, from {n} quiet frames and an F distribution with 3 and {n - 3} degrees of freedom"

    def to_dict(self) -> dict[str, Any]:
        """Return verdict, frames, tests, drift and trends as plain JSON types.

        ``alarm`` of a frame is that of the mean which contains it; None if the frame is not used.
        """
        tested = {name: one.alarm for one in self.means for name in one.frames}
        found: dict[str, Any] = plain(
            {
                "format": FORMAT,
                "version": VERSION,
                "holds": self.holds,
                "verdict": self.verdict,
                "rate": self.rate,
                "threshold": self.threshold,
                "basis": self.basis,
                "first_moved": self.first_moved,
                "frames": [_frame_dict(one) | {"alarm": tested.get(one.name)} for one in self.frames],
                "quiet": [_frame_dict(one) for one in self.quiet],
                "means": [
                    {"frames": one.frames, **_named(one.values, one.sigmas)}
                    | {"t_squared": one.t_squared, "chance": one.chance, "alarm": one.alarm}
                    for one in self.means
                ],
                "significant": self.significant,
                "drift": _named(self.values, self.sigmas),
                "trends": self.trends,
            }
        )
        return found


def _of(count: int, every: int) -> str:
    return f"{count} of {every} frames"


def _drift_words(values: Three, sigmas: Three, *, every: bool = False) -> str:
    """Return a drift in words: all values, or those that are significant if there are any."""
    clear = [abs(value) > CLEAR * sigma for value, sigma in zip(values, sigmas, strict=True)]
    shown = [k for k in range(3) if every or clear[k] or not any(clear)]
    titles = [title.split(" (")[0] for title in DRIFT_NAMES.values()]
    return ", ".join(f"{titles[k]} {values[k]:+.3f} ± {sigmas[k]:.3f} {UNITS[k]}" for k in shown)


def _named(values: Three, sigmas: Three) -> Mapping[str, float]:
    names = list(DRIFT_NAMES)
    return dict(zip(names, values, strict=True)) | dict(zip([f"{name}_sigma" for name in names], sigmas, strict=True))


def _frame_dict(one: WatchedFrame) -> dict[str, Any]:
    when = None if one.when is None else one.when.isoformat(timespec="seconds")
    ratio = None if one.goodness is None else one.goodness.ratio
    return {"name": one.name, "when": when, **_named(one.values, one.sigmas), "goodness": ratio, "problem": one.problem}
