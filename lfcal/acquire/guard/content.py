"""Check the content of a frame before it is accepted.

A frame may contain an earlier exposure, completely or in part (`Repeats`). Its light, the position of the light, dark
level and clipping may differ from those of neighbouring frames (`Neighbours`). `ContentGuard` makes all checks.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.guard._kernels import COLUMNS, count_lit, expect, learn, measure, same_rows
from lfcal.acquire.guard.doubts import NO_DOUBT, Doubt
from lfcal.acquire.recording import Kind, Suspicion, frame_crc
from lfcal.frames import Position

__all__ = [
    "CheckedFrame",
    "Content",
    "ContentGuard",
    "FramePlace",
    "MeasuredFrame",
    "SensorLimits",
    "measured",
    "same_place",
]

SAMPLES = 1 << 14
"""Number of samples of a frame that are compared, in whole rows; noise never repeats in that many."""
BUFFERS = 8
"""Number of earlier exposures with which torn frames are compared: as many as drivers have buffers."""
FEW = 16
"""Smallest number of equal lit samples; dark areas of frames without noise may be equal by chance."""


class FramePlace(NamedTuple):
    """Planned position of a frame, and the number of periods (y, x) by which the source is displaced from it."""

    position: Position
    periods: tuple[int, int] = (0, 0)


class RowSample(NamedTuple):
    """Sample of an exposure: its position, some of its rows, their CRC-32, and the bytes of the first and last row."""

    place: FramePlace
    rows: NDArray[Any]
    crc: int
    edges: tuple[bytes, bytes]


class Repeats:
    """Detector of repeated content; compares some rows of each exposure with those of earlier exposures.

    All earlier exposures are compared by the checksums of these rows, and the latest `BUFFERS` also row by row.

    Content is compared in sensor coordinates, and only between different positions. Images of a displaced source differ
    even without noise, while images at the same position may be equal.

    Parameters
    ----------
    ceiling
        Sample value of a saturated pixel.
    recorded
        Maps the CRC-32 of each frame stored by earlier runs of the session to its position. None: no such frames.
    """

    def __init__(self, ceiling: float, recorded: Mapping[int, Position] | None = None) -> None:
        self._ceiling = ceiling
        self._seen: dict[int, FramePlace] = {}
        self._recorded = recorded or {}
        self._latest: deque[RowSample] = deque(maxlen=BUFFERS)

    def look(
        self, place: FramePlace, raws: Iterable[NDArray[Any]], floor: float
    ) -> tuple[Doubt, tuple[RowSample, ...]]:
        """Check the exposures ``raws`` of ``place``; return the findings, and the samples to pass to `remember`.

        Parameters
        ----------
        place
            Position of the exposures.
        raws
            Exposures ``(rows, columns)``, of the same region of the sensor in all frames.
        floor
            Sample value above which a sample counts as light (counts).
        """
        doubt, samples = NO_DOUBT, []
        for raw in raws:
            # make it contiguous: its rows may be part of a larger region
            rows = np.ascontiguousarray(raw[:: math.ceil(raw.size / SAMPLES)])
            sample = RowSample(place, rows, frame_crc(rows.data), (rows[0].tobytes(), rows[-1].tobytes()))
            samples.append(sample)
            if not doubt:
                doubt = self._whole(sample, floor) or self._part(sample, floor) or NO_DOUBT
        return doubt, tuple(samples)

    def remember(self, samples: Iterable[RowSample]) -> None:
        """Keep samples for comparison with later exposures; do not pass samples of exposures at a wrong position."""
        for sample in samples:
            self._seen.setdefault(sample.crc, sample.place)
            self._latest.append(sample)

    def kept(self, position: Position, frame: NDArray[Any], noise: float, floor: float) -> Doubt:
        """Compare a frame with the frames stored by earlier runs of the session, and return the findings.

        Only the checksums of these frames are known. Their cutouts move with the source, so that noise-free frames of
        different positions may be equal. A frame is therefore compared only if ``noise``, the standard deviation of a
        pixel (counts), is above 0, and at least `FEW` samples are lit. Lit samples are above ``floor`` (counts) and not
        saturated.
        """
        if not self._recorded or noise <= 0:
            return NO_DOUBT
        other = self._recorded.get(frame_crc(frame.data), position)
        if other == position or count_lit(frame, floor, self._ceiling) < FEW:
            return NO_DOUBT
        return _repeated(other)

    def _whole(self, sample: RowSample, floor: float) -> Doubt | None:
        other = self._seen.get(sample.crc, sample.place)
        if other == sample.place or count_lit(sample.rows, floor, self._ceiling) < FEW:
            return None
        return _repeated(other.position)

    def _part(self, sample: RowSample, floor: float) -> Doubt | None:
        rows, n = sample.rows, len(sample.rows)
        for place, earlier, _, edges in self._latest:
            # with noise, the outermost rows hardly ever agree, so this test is quick
            if edges[0] != sample.edges[0] and edges[1] != sample.edges[1]:
                continue
            if place == sample.place or earlier.shape != rows.shape or earlier.dtype != rows.dtype:
                continue
            top, bottom = same_rows(rows, earlier)
            for count, part in ((top, rows[:top]), (bottom, rows[n - bottom :])):
                if count and count_lit(part, floor, self._ceiling) >= FEW:
                    got = (
                        f"{100 * count / n:.0f} % of its rows identical to those at (z, y, x) = {tuple(place.position)}"
                    )
                    why = f"frame: expected one exposure, got {got}; the camera mixes its buffers"
                    return Doubt.of(Suspicion.TORN, why)
        return None


def _repeated(position: Position) -> Doubt:
    got = f"the content of (z, y, x) = {tuple(position)}"
    return Doubt.of(Suspicion.REPEATED, f"frame: expected new content, got {got}; the camera repeats a buffer")


LEVEL, ENERGY, ROW, COLUMN, PEAK = range(5)
UNUSUAL = 8.0
"""A frame is unusual if its deviation from the prediction exceeds the typical deviation by this factor."""
SIGMAS = 8.0
"""Required significance, in standard deviations of the frame's own noise."""
GAINS = (1.3, 2.0, 2.5, 1.5)
"""Noise of a difference from the prediction, relative to that of one frame, for each method of `expect`."""
FIRST = (0.001, 0.03, 0.15, 0.15)
"""Initial typical differences: level (fraction of the range), light (relative), row and column (pixels)."""
LEAST = (0.003, 0.2, 0.5, 0.5)
"""Differences that are always tolerated, in the units of `FIRST`."""
ELSEWHERE = (0.01, 0.5, 1.5, 1.5)
"""Differences tolerated in a frame without neighbours, which is compared with the latest accepted frame."""
MANY = (0.01, 0.5, math.inf, math.inf)
"""Differences tolerated in whole frames of many points, in which the light moves from one offset to the next."""
AGAIN = (0.003, 0.15, 0.5, 0.5)
"""Differences tolerated between two frames of one position."""
REFERENCES = (0.01, 0.25, 1.0, 1.0)
"""Differences tolerated between two reference frames, because lamp and stage may drift."""
DARK = 0.1
"""Fraction of the expected light below which a frame is blank."""
FAR_FROM_FULL, FEW_CLIPPED = 0.7, 4


class SensorLimits(NamedTuple):
    """Sample value of a saturated pixel (counts), and gain (electrons per count)."""

    ceiling: float
    gain: float


class MeasuredFrame(NamedTuple):
    """Measurements of a frame.

    ``values`` contains the measurements in the order of `COLUMNS`. ``level_sigma`` and ``energy_sigma`` are the
    standard deviations of background and energy (counts), and ``place_sigma`` is the standard deviation of the centroid
    (px). ``saturated`` is the number of saturated pixels.
    """

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
        """Standard deviation of a pixel without light (counts)."""
        return float(self.values[5])

    @property
    def lit(self) -> bool:
        """Whether the frame shows significant light."""
        return bool(self.values[ENERGY] > SIGMAS * self.energy_sigma)


def measured(frame: NDArray[Any], saturated: int, sensor: SensorLimits) -> MeasuredFrame:
    """Return the measurements of ``frame`` ``(rows, columns)``, which has ``saturated`` saturated pixels."""
    values = np.empty(len(COLUMNS))
    measure(frame, values)
    rows, columns = frame.shape
    # 0.3 counts: noise of rounding to integers
    noise = max(float(values[5]), 0.3)
    level = noise / max(2, min(rows, columns) // 6)
    light = max(float(values[ENERGY]), 0.0)
    energy = math.sqrt(frame.size * noise**2 + (frame.size * level) ** 2 + light / sensor.gain)
    # a pattern extends over about a quarter of the frame, noise over all of it
    moment = math.sqrt(frame.size * noise**2 / 12 * max(rows, columns) ** 2 + light / sensor.gain * (rows / 4) ** 2)
    return MeasuredFrame(values, level, energy, moment / max(light, energy), saturated)


class Neighbours:
    """Measurements of accepted frames by position, and their typical deviations from predictions.

    Parameters
    ----------
    shape
        Number of positions of the plan, ``(nz, ny, nx)``.
    sensor
        Limits of the sensor.
    whole
        Whether frames cover the whole sensor and show many points; each is then compared only with the latest accepted
        one.
    """

    def __init__(self, shape: tuple[int, int, int], sensor: SensorLimits, *, whole: bool = False) -> None:
        self._sensor, self._whole = sensor, whole
        self._table = np.full((*shape, 5), np.nan)
        self._mostly = np.tile(np.array(FIRST), (len(GAINS), 1))
        self._expected = np.empty(5)
        self._asked: tuple[Position, int, int] | None = None
        self._latest: tuple[float, MeasuredFrame] | None = None

    def look(self, position: Position, now: MeasuredFrame, exposure_s: float, pitch: int) -> Doubt:
        """Compare a frame with its neighbours, ``pitch`` positions away, and return the findings.

        If no neighbours were accepted, the frame is compared with the latest accepted frame. The light of that frame is
        scaled to ``exposure_s``, the exposure time of the new frame (s).
        """
        way = self._expect(position, pitch)
        if way < 0:
            return self._elsewhere(now, exposure_s)
        mostly = self._mostly[way]
        limits = tuple(max(least, UNUSUAL * usual) for least, usual in zip(LEAST, mostly.tolist(), strict=True))
        doubt = _compare(now, self._expected, limits, GAINS[way], self._sensor)
        full = self._sensor.ceiling
        if now.saturated >= FEW_CLIPPED and self._expected[PEAK] < FAR_FROM_FULL * full:
            why = (
                f"peak: expected about {self._expected[PEAK]:.4g} counts as at neighbouring positions, got "
                f"{now.saturated} saturated"
            )
            doubt |= Doubt.of(Suspicion.CLIPPED, f"{why} pixels; check lamp and exposure")
        return doubt

    def accept(self, position: Position, now: MeasuredFrame, exposure_s: float, pitch: int) -> None:
        """Store the measurements ``now`` of a trusted frame, for comparison with later frames.

        ``exposure_s`` is its exposure time (s), and ``pitch`` the distance of its neighbours as in `look`.
        """
        way = self._expect(position, pitch)
        if way >= 0 and now.lit:
            learn(now.values, self._expected, self._sensor.ceiling, self._mostly[way])
        self._table[position] = now.values[:5]
        self._latest = exposure_s, now
        self._asked = None

    def _expect(self, position: Position, pitch: int) -> int:
        """Predict the measurements at ``position``, unless already predicted; return the method (see `expect`)."""
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
    """Compare a frame with an earlier one of the same position and exposure, and return the findings.

    Reference frames (``references``) may differ more, because the lamp and the stage may have drifted between them.
    """
    return _compare(now, before.values, REFERENCES if references else AGAIN, 1.5, sensor)


def _compare(
    now: MeasuredFrame, expected: NDArray[np.float64], limits: tuple[float, ...], gain: float, sensor: SensorLimits
) -> Doubt:
    """Return the findings where ``now`` differs from ``expected`` ``(5,)`` by more than ``limits`` and the noise."""
    sigmas = gain * SIGMAS
    level, light, row, column = expected[:4].tolist()
    got_level, got, got_row, got_column = now.values[:4].tolist()
    # the shot noise of what should be there counts where nothing is
    noise = sigmas * math.sqrt(now.energy_sigma**2 + max(light, 0.0) / sensor.gain)
    doubt = NO_DOUBT
    if abs(got_level - level) > max(limits[LEVEL] * sensor.ceiling, sigmas * now.level_sigma):
        why = f"dark level: expected about {level:.4g} counts, got {got_level:.4g}"
        doubt |= Doubt.of(Suspicion.DARK_LEVEL, f"{why}; check the camera's temperature, offset and stray light")
    if abs(got - light) > max(limits[ENERGY] * abs(light), noise):
        what = Suspicion.BLANK if got < DARK * light else Suspicion.LIGHT
        why = f"light: expected about {light:.4g} counts, got {got:.4g}"
        doubt |= Doubt.of(what, f"{why}; check lamp, shutter and exposure")
    if now.lit and not doubt.what & Suspicion.BLANK:
        down, right = got_row - row, got_column - column
        noise = sigmas * now.place_sigma
        if abs(down) > max(limits[ROW], noise) or abs(right) > max(limits[COLUMN], noise):
            why = f"image: expected a displacement below {max(limits[ROW], limits[COLUMN], noise):.2g} px, got "
            why += f"({down:.2f}, {right:.2f}) px (row, column)"
            doubt |= Doubt.of(Suspicion.DISPLACED, f"{why}; check the stage's steps and the camera's region")
    return doubt


EXPOSURE_SHARE, EXPOSURE_STEP_S = 0.1, 50e-6
"""Tolerated deviation of the exposure, relative and in seconds, because cameras set exposures in steps."""
LIT_SIGMAS, LIT_COUNTS = 5.0, 3.0


class Content(NamedTuple):
    """A recorded frame, with the measurements by which its content is checked.

    ``frame`` contains the samples ``(rows, columns)`` to be stored, and ``now`` their measurements. ``raws`` are the
    exposures from which the frame was computed, in the same region of the sensor for every frame of a kind. ``asked_s``
    is the requested exposure time, and ``actual_s`` the actual times (s), of which the first is used for the frame.
    """

    kind: Kind
    place: FramePlace
    frame: NDArray[Any]
    now: MeasuredFrame
    raws: Sequence[NDArray[Any]]
    asked_s: float
    actual_s: Sequence[float]


class CheckedFrame(NamedTuple):
    """Measurements of a frame, the findings on it, and the samples to remember if it is accepted."""

    now: MeasuredFrame
    doubt: Doubt
    samples: tuple[RowSample, ...] = ()


class ContentGuard:
    """Guard that checks the content of frames in the order of recording.

    Parameters
    ----------
    shape
        Number of positions of the plan, ``(nz, ny, nx)``.
    sensor
        Limits of the sensor.
    coarse
        Whether coarse grids are recorded first, so that neighbours are farther away.
    recorded
        Positions of the frames stored by earlier runs, by CRC-32; see `Repeats`.
    whole
        Whether frames cover the whole sensor and show many points; such frames differ in the positions of the light but
        have similar sums.
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        sensor: SensorLimits,
        *,
        coarse: bool = False,
        recorded: Mapping[int, Position] | None = None,
        whole: bool = False,
    ) -> None:
        self.sensor = sensor
        self._coarse = coarse
        self._neighbours = Neighbours(shape, sensor, whole=whole)
        self._repeats = Repeats(sensor.ceiling, recorded)
        self._reference: MeasuredFrame | None = None
        self._any = False

    def look(self, content: Content) -> CheckedFrame:
        """Check a frame and return its measurements with the findings.

        Later frames are compared with it only after `accept`. Of a dark frame, only the exposure time is checked.
        """
        now = content.now
        doubt = _exposure(content)
        if content.kind is Kind.DARK:
            return CheckedFrame(now, doubt)
        floor = float(now.values[0]) + max(LIT_SIGMAS * now.noise, LIT_COUNTS)
        repeated, samples = self._repeats.look(content.place, content.raws, floor)
        doubt |= repeated
        position = content.place.position
        if content.kind is Kind.POSITION:
            doubt |= self._repeats.kept(position, content.frame, now.noise, floor)
            doubt |= self._neighbours.look(position, now, content.actual_s[0], self._pitch(position))
            if not self._any and not now.lit:
                doubt |= Doubt.of(
                    Suspicion.BLANK, ("light: expected a signal in the first frame, got none; check the lamp")
                )
        elif content.kind is Kind.REFERENCE and self._reference is not None:
            doubt |= same_place(now, self._reference, self.sensor, references=True)
        return CheckedFrame(now, doubt, samples)

    def know(self, position: Position, frame: NDArray[Any], saturated: int, exposure_s: float) -> MeasuredFrame:
        """Accept a frame that an earlier run of the session recorded, and return its measurements.

        ``saturated`` is its number of saturated pixels, and ``exposure_s`` its exposure time (s).
        """
        now = measured(frame, saturated, self.sensor)
        self._neighbours.accept(position, now, exposure_s, self._pitch(position))
        self._any = True
        return now

    def accept(self, content: Content, seen: CheckedFrame) -> None:
        """Accept a checked frame, so that later frames are compared with it."""
        self._repeats.remember(seen.samples)
        if content.kind is Kind.POSITION:
            position = content.place.position
            self._neighbours.accept(position, seen.now, content.actual_s[0], self._pitch(position))
            self._any = True
        elif content.kind is Kind.REFERENCE:
            self._reference = seen.now

    def _pitch(self, position: Position) -> int:
        """Return the distance to neighbours on the grids recorded so far (number of positions)."""
        if not self._coarse:
            return 1
        both = position.y | position.x
        return min(16, both & -both) if both else 16


def _exposure(content: Content) -> Doubt:
    asked = content.asked_s
    allowed = EXPOSURE_SHARE * asked + EXPOSURE_STEP_S
    worst = max(content.actual_s, key=lambda actual: abs(actual - asked))
    if abs(worst - asked) <= allowed:
        return NO_DOUBT
    why = f"exposure: expected {1e3 * asked:.4g} ms as planned, got {1e3 * worst:.4g} ms"
    return Doubt.of(Suspicion.EXPOSURE, f"{why}; plan an exposure that the camera supports")
