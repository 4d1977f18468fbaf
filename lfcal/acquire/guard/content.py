"""All that the content of one frame is checked for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from numpy.typing import NDArray

from lfcal.acquire.guard.doubts import NO_DOUBT, Doubt
from lfcal.acquire.guard.neighbours import MeasuredFrame, Neighbours, SensorLimits, measured, same_place
from lfcal.acquire.guard.repeats import FramePlace, Repeats, RowSample
from lfcal.acquire.recording import Kind, Suspicion
from lfcal.frames import Position

__all__ = ["CheckedFrame", "Content", "ContentGuard"]

EXPOSURE_SHARE, EXPOSURE_STEP_S = 0.1, 50e-6
"""Exposures come in steps: a tenth, or 50 µs, are the camera's own."""
LIT_SIGMAS, LIT_COUNTS = 5.0, 3.0


class Content(NamedTuple):
    """A frame for the guard.

    ``frame`` ``(rows, columns)`` as it is kept, ``now`` the same in numbers; ``raws`` the exposures it was made of, the
    same region of the sensor for every frame of a kind; ``asked_s`` and ``actual_s`` all exposures that were asked for
    and that the camera took (s), the frame's own first.
    """

    kind: Kind
    place: FramePlace
    frame: NDArray[Any]
    now: MeasuredFrame
    raws: Sequence[NDArray[Any]]
    asked_s: float
    actual_s: Sequence[float]


class CheckedFrame(NamedTuple):
    """A frame in numbers, the doubt about it, and what is remembered of it if it is to be trusted."""

    now: MeasuredFrame
    doubt: Doubt
    samples: tuple[RowSample, ...] = ()


class ContentGuard:
    """Judge frames in the order of recording.

    Parameters
    ----------
    shape
        ``(nz, ny, nx)`` positions of the plan.
    sensor
        The camera's.
    coarse
        Whether coarse grids come first, so that neighbours lie farther away.
    recorded
        See `Repeats`.
    whole
        Frames are whole ones of many points: each has its own places of light, and about as much of it as the others.
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
        """Return what is seen of a frame; nothing of it is trusted before `accept`."""
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
                doubt |= Doubt(Suspicion.BLANK, ("light: expected some in the first frame, got none; check the lamp",))
        elif content.kind is Kind.REFERENCE and self._reference is not None:
            doubt |= same_place(now, self._reference, self.sensor, references=True)
        return CheckedFrame(now, doubt, samples)

    def know(self, position: Position, frame: NDArray[Any], saturated: int, exposure_s: float) -> MeasuredFrame:
        """Trust a frame that an earlier run of the session recorded, and return it in numbers."""
        now = measured(frame, saturated, self.sensor)
        self._neighbours.accept(position, now, exposure_s, self._pitch(position))
        self._any = True
        return now

    def accept(self, content: Content, seen: CheckedFrame) -> None:
        """Trust a frame: later ones are held against it."""
        self._repeats.remember(seen.samples)
        if content.kind is Kind.POSITION:
            position = content.place.position
            self._neighbours.accept(position, seen.now, content.actual_s[0], self._pitch(position))
            self._any = True
        elif content.kind is Kind.REFERENCE:
            self._reference = seen.now

    def _pitch(self, position: Position) -> int:
        """Return how far away the grids recorded so far have neighbours."""
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
    return Doubt(Suspicion.EXPOSURE, (f"{why}; plan an exposure that the camera takes",))
