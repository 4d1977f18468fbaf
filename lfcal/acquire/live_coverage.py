"""Tracking of the positions that the frames of a target have shown so far, and of faults of the frames."""

from __future__ import annotations

import math
import threading
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire.live_quality import alarm
from lfcal.acquire.recording import Kind, Note, TargetRecording, sampled_references
from lfcal.acquire.schedule import ScheduledFrame
from lfcal.base import Finding, LfcalError

if TYPE_CHECKING:
    from lfcal.targets import TargetPlan

__all__ = ["CoverageState", "LiveCoverage"]

SAMPLE = 1 << 16
"""Number of pixels for the dark level, which is the median of a mostly dark frame."""
FEW = 3


@dataclass(frozen=True, slots=True, eq=False)
class CoverageState:
    """Snapshot of the coverage of a running session.

    Attributes
    ----------
    done, total
        Number of frames recorded so far, and of all frames in the plan.
    shown
        Number of recorded frames that show each position within the plan's tolerance, ``(nz, ny, nx)``. The target is
        assumed to be at its planned pose.
    light
        Sum over each frame of the samples minus the frame's median (counts), ``(frames,)`` in the plan's order. NaN for
        frames that are not recorded or whose light is unknown.
    saturated
        Number of saturated pixels in each frame, ``(frames,)`` in the plan's order.
    lamp
        Time since the start of the recording without pauses (s), and light (counts), of each reference frame,
        ``(n, 2)``.
    alarms
        Findings on recorded frames that may require a stop, as in `lfcal.acquire.live_quality`.
    """

    done: int
    total: int
    shown: NDArray[np.intp]
    light: NDArray[np.float64]
    saturated: NDArray[np.int64]
    lamp: NDArray[np.float64]
    alarms: tuple[Finding, ...]

    @property
    def coverage(self) -> float:
        """Fraction of the scan's positions shown so far, in [0, 1]."""
        return float((self.shown > 0).mean())

    def to_dict(self) -> dict[str, Any]:
        """Return the snapshot's totals as plain JSON types.

        The keys are ``"frames"`` (number recorded), ``"coverage"`` and ``"coverage_of_planes"`` (fractions in [0, 1]),
        and ``"mean_repeats"`` (frames per position).
        """
        return {
            "frames": self.done,
            "coverage": self.coverage,
            "coverage_of_planes": [float((plane > 0).mean()) for plane in self.shown],
            "mean_repeats": float(self.shown.mean()),
        }


class LiveCoverage:
    """Observer of a `Runner` that counts the positions shown by a target; `state` may be called from any thread.

    Parameters
    ----------
    plan
        Plan of the session.
    folder
        Folder of a session to resume. Its recorded frames are counted if it has the same plan. None: a new session.

    Examples
    --------
    >>> from lfcal.acquire import CoverageState, LiveCoverage
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.targets import Wishes, parse_target, plan_target
    >>> scan = ScanPlan.for_camera(preset("bench"), virtual_depths=(4.0,), cutout=31)
    >>> plan = plan_target(scan, parse_target("array:3x3@2mm"), Wishes(most_frames=3, level="geometric"))
    >>> watch = LiveCoverage(plan)  # passed to record as an observer, it counts every frame automatically
    >>> watch.know(0, 0)  # a frame of an earlier run
    >>> state: CoverageState = watch.state()
    >>> print(state.done, "of", state.total, "frames,", f"{state.coverage:.0%} of the positions shown")
    1 of 3 frames, 1% of the positions shown
    """

    def __init__(self, plan: TargetPlan, folder: Path | None = None) -> None:
        from lfcal.targets import Phases  # here: acquisition loads no simulator

        scan = plan.scan
        self._plan, self._phases = plan, Phases.of(scan)
        self._images = [plan.images(z) for z in range(len(scan.depths_um))]
        self._number = {frame: k for k, frame in enumerate(plan.frames)}
        self._frames: set[tuple[int, int]] = set()
        self._shown = np.zeros((len(scan.depths_um), self._phases.count), np.intp)
        self._light = np.full(len(self._number), np.nan)
        self._saturated = np.zeros(len(self._number), np.int64)
        self._lamp: list[tuple[float, float]] = []
        self._lock = threading.Lock()
        if folder is not None:
            # a session that was stopped before its first frame cannot be opened
            with suppress(LfcalError), TargetRecording(folder, skip_damaged=True) as source:
                for z, k in source.frames if source.target == plan else ():
                    self.know(z, k)

    def __call__(self, step: ScheduledFrame, note: Note, frame: NDArray[Any]) -> None:
        """Take an acknowledged frame into account."""
        if step.kind is Kind.DARK:
            return
        light = _light(note.energy, frame)
        if step.kind is Kind.REFERENCE:
            with self._lock:
                self._lamp.append((note.elapsed_s, light))
            return
        self.know(step.z, step.flat - step.z * self._most, light, note.saturated)

    @property
    def _most(self) -> int:
        return max(map(len, self._plan.offsets_px))

    def know(self, z: int, k: int, light: float = math.nan, saturated: int = 0) -> None:
        """Mark frame ``k`` of plane ``z`` as recorded.

        ``light`` is the sum of its samples minus their median (counts). Its number of saturated pixels, ``saturated``,
        is ignored if ``light`` is NaN (unknown). A frame is counted only once.
        """
        from lfcal.targets import covered_by

        number = self._number[z, k]
        if not math.isnan(light):
            with self._lock:
                self._light[number], self._saturated[number] = light, saturated
        if (z, k) in self._frames:
            return
        offset = np.array(self._plan.offsets_px[z][k])
        found = covered_by(self._phases, self._images[z], offset, self._plan.tolerance_px)
        with self._lock:
            self._frames.add((z, k))
            self._shown[z, found] += 1

    def remember(self, folder: Path) -> None:
        """Read the reference frames of the session in ``folder``, for comparison with those of the next run.

        Files that cannot be read are ignored.
        """
        with suppress(LfcalError, OSError), self._lock:
            for check in sampled_references(folder):
                self._lamp.append((check.elapsed_s, _light(check.energy, check.frame)))

    def state(self) -> CoverageState:
        """Return a snapshot of the coverage."""
        with self._lock:
            lamp = np.array(self._lamp).reshape(-1, 2)
            shown = self._shown.reshape(-1, *self._plan.scan.period).copy()
            light, saturated = self._light.copy(), self._saturated.copy()
            done = len(self._frames)
        return CoverageState(
            done, len(self._number), shown, light, saturated, lamp, tuple(_alarms(light, saturated, lamp))
        )


def _light(energy: float, frame: NDArray[Any]) -> float:
    """Return the sum of a frame's samples minus their median (counts)."""
    stride = max(1, int(np.sqrt(frame.size / SAMPLE)))
    return energy - float(np.median(frame[::stride, ::stride])) * frame.size


def _alarms(light: NDArray[np.float64], saturated: NDArray[np.int64], lamp: NDArray[np.float64]) -> list[Finding]:
    found: list[Finding] = []

    def look(kind: str, size: float, words: str) -> None:
        found.extend(alarm(kind, size, words))

    look("saturated", float((saturated > 0).sum()), "saturated pixels: shorten the exposure, or bracket")
    seen = light[np.isfinite(light)]
    if len(seen) >= FEW:
        dim = float((seen < 0.5 * np.median(seen)).mean())
        look("dim", dim, "some frames are much darker than the others: check lamp, shutter and the edge of the target")
    if len(lamp) > 1 and lamp[0, 1] > 0:
        look("lamp", float(np.abs(lamp[:, 1] / lamp[0, 1] - 1).max()), "the lamp drifts: let it warm up")
    return found
