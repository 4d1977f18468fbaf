"""Light, place, level and clipping of a frame, held against those of the positions around it."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.guard._kernels import COLUMNS, expect, learn, measure
from lfcal.acquire.guard.doubts import NO_DOUBT, Doubt
from lfcal.acquire.recording import Suspicion
from lfcal.frames import Position

__all__ = ["MeasuredFrame", "Neighbours", "SensorLimits", "measured", "same_place"]

LEVEL, ENERGY, ROW, COLUMN, PEAK = range(5)
UNUSUAL = 8.0
"""A frame is unusual that differs so many times as much from what its neighbours lead to as frames mostly do."""
SIGMAS = 8.0
"""And by so many standard deviations of its own noise."""
GAINS = (1.3, 2.0, 2.5, 1.5)
"""Noise of a difference from what is expected, over that of one frame, for each way of `expect`."""
FIRST = (0.001, 0.03, 0.15, 0.15)
"""What differences mostly are until they are known: level (of the range), light (of all), row and column (pixels)."""
LEAST = (0.003, 0.2, 0.5, 0.5)
"""Smaller differences are no fault of the rig, in the same units."""
ELSEWHERE = (0.01, 0.5, 1.5, 1.5)
"""The same for a frame without neighbours, held against the latest one of another plane."""
MANY = (0.01, 0.5, math.inf, math.inf)
"""The same for whole frames of many points, held against the latest one: at another offset light is elsewhere."""
AGAIN = (0.003, 0.15, 0.5, 0.5)
"""The same for two frames of one place."""
REFERENCES = (0.01, 0.25, 1.0, 1.0)
"""The same for two reference frames, between which lamp and stage may drift."""
DARK = 0.1
"""A frame with less than this of the light it should have is blank."""
FAR_FROM_FULL, FEW_CLIPPED = 0.7, 4


class SensorLimits(NamedTuple):
    """Saturated sample value, and electrons per count."""

    ceiling: float
    gain: float


class MeasuredFrame(NamedTuple):
    """A frame in numbers: see `COLUMNS`; standard deviations of level, energy and centroid; saturated pixels."""

    values: NDArray[np.float64]
    level_sigma: float
    energy_sigma: float
    place_sigma: float
    saturated: int

    @property
    def total(self) -> float:
        """Sum of all samples (counts)."""
        return float(self.values[6])

    @property
    def peak(self) -> float:
        """Highest sample (counts)."""
        return float(self.values[PEAK])

    @property
    def noise(self) -> float:
        """Noise of a pixel without light (counts)."""
        return float(self.values[5])

    @property
    def lit(self) -> bool:
        """Whether light stands out."""
        return bool(self.values[ENERGY] > SIGMAS * self.energy_sigma)


def measured(frame: NDArray[Any], saturated: int, sensor: SensorLimits) -> MeasuredFrame:
    """Return the numbers of ``frame`` ``(rows, columns)``."""
    values = np.empty(len(COLUMNS))
    measure(frame, values)
    rows, columns = frame.shape
    # 0.3 counts: what rounding to integers hides
    noise = max(float(values[5]), 0.3)
    level = noise / max(2, min(rows, columns) // 6)
    light = max(float(values[ENERGY]), 0.0)
    energy = math.sqrt(frame.size * noise**2 + (frame.size * level) ** 2 + light / sensor.gain)
    # the wings of a pattern are a quarter of the frame away, those of the noise are everywhere
    moment = math.sqrt(frame.size * noise**2 / 12 * max(rows, columns) ** 2 + light / sensor.gain * (rows / 4) ** 2)
    return MeasuredFrame(values, level, energy, moment / max(light, energy), saturated)


class Neighbours:
    """What was accepted so far, by position, and how much frames mostly differ from what is expected of them.

    Parameters
    ----------
    shape
        ``(nz, ny, nx)`` positions of the plan.
    sensor
        The camera's.
    whole
        Frames are whole ones of many points: only the latest one is near.
    """

    def __init__(self, shape: tuple[int, int, int], sensor: SensorLimits, *, whole: bool = False) -> None:
        self._sensor, self._whole = sensor, whole
        self._table = np.full((*shape, 5), np.nan)
        self._mostly = np.tile(np.array(FIRST), (len(GAINS), 1))
        self._expected = np.empty(5)
        self._asked: tuple[Position, int, int] | None = None
        self._latest: tuple[float, MeasuredFrame] | None = None

    def look(self, position: Position, now: MeasuredFrame, exposure_s: float, pitch: int) -> Doubt:
        """Return the doubt about a frame of ``position``; neighbours are ``pitch`` positions away."""
        way = self._expect(position, pitch)
        if way < 0:
            return self._elsewhere(now, exposure_s)
        mostly = self._mostly[way]
        limits = tuple(max(least, UNUSUAL * usual) for least, usual in zip(LEAST, mostly.tolist(), strict=True))
        doubt = _compare(now, self._expected, limits, GAINS[way], self._sensor)
        full = self._sensor.ceiling
        if now.saturated >= FEW_CLIPPED and self._expected[PEAK] < FAR_FROM_FULL * full:
            why = f"peak: expected about {self._expected[PEAK]:.4g} counts as around it, got {now.saturated} saturated"
            doubt |= Doubt(Suspicion.CLIPPED, (f"{why} pixels; check lamp and exposure",))
        return doubt

    def accept(self, position: Position, now: MeasuredFrame, exposure_s: float, pitch: int) -> None:
        """Remember a frame that is to be trusted."""
        way = self._expect(position, pitch)
        if way >= 0 and now.lit:
            learn(now.values, self._expected, self._sensor.ceiling, self._mostly[way])
        self._table[position] = now.values[:5]
        self._latest = exposure_s, now
        self._asked = None

    def _expect(self, position: Position, pitch: int) -> int:
        """Fill in what is expected at ``position``, unless it was asked for last; return how, see `expect`."""
        if self._whole:
            return -1
        if self._asked is None or self._asked[:2] != (position, pitch):
            way = int(expect(self._table[position.z], position.y, position.x, pitch, self._expected))
            self._asked = position, pitch, way
        return self._asked[2]

    def _elsewhere(self, now: MeasuredFrame, exposure_s: float) -> Doubt:
        if self._latest is None:
            return NO_DOUBT
        exposure, before = self._latest
        expected = before.values[:5].copy()
        expected[ENERGY] *= exposure_s / exposure
        return _compare(now, expected, MANY if self._whole else ELSEWHERE, 2.0, self._sensor)


def same_place(now: MeasuredFrame, before: MeasuredFrame, sensor: SensorLimits, *, references: bool = False) -> Doubt:
    """Return the doubt about a frame of a place that was recorded before, with the same exposure."""
    return _compare(now, before.values, REFERENCES if references else AGAIN, 1.5, sensor)


def _compare(
    now: MeasuredFrame, expected: NDArray[np.float64], limits: tuple[float, ...], gain: float, sensor: SensorLimits
) -> Doubt:
    """Return the doubt where ``now`` differs from ``expected`` ``(5,)`` by more than ``limits`` and its noise."""
    sigmas = gain * SIGMAS
    level, light, row, column = expected[:4].tolist()
    got_level, got, got_row, got_column = now.values[:4].tolist()
    # the shot noise of what should be there counts where nothing is
    noise = sigmas * math.sqrt(now.energy_sigma**2 + max(light, 0.0) / sensor.gain)
    doubt = NO_DOUBT
    if abs(got_level - level) > max(limits[LEVEL] * sensor.ceiling, sigmas * now.level_sigma):
        why = f"dark level: expected about {level:.4g} counts, got {got_level:.4g}"
        doubt |= Doubt(Suspicion.DARK_LEVEL, (f"{why}; check the camera's temperature, offset and stray light",))
    if abs(got - light) > max(limits[ENERGY] * abs(light), noise):
        what = Suspicion.BLANK if got < DARK * light else Suspicion.LIGHT
        why = f"light: expected about {light:.4g} counts, got {got:.4g}"
        doubt |= Doubt(what, (f"{why}; check lamp, shutter and exposure",))
    if now.lit and not doubt.what & Suspicion.BLANK:
        down, right = got_row - row, got_column - column
        noise = sigmas * now.place_sigma
        if abs(down) > max(limits[ROW], noise) or abs(right) > max(limits[COLUMN], noise):
            why = f"image: expected within {max(limits[ROW], limits[COLUMN], noise):.2g} px of its place, got "
            why += f"({down:.2f}, {right:.2f}) px (row, column) off it"
            doubt |= Doubt(Suspicion.DISPLACED, (f"{why}; check the stage's steps and the camera's region",))
    return doubt
