"""Assess the quality of a running session, so that faults appear within the first minutes."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfcal.acquire._references import HotPixels, References, light_where
from lfcal.acquire.recording import Kind, Note, sampled_references
from lfcal.acquire.schedule import ScheduledFrame
from lfcal.base import Finding, LfcalError, position_at
from lfcal.camera import ScanPlan

__all__ = ["LIMITS", "LiveQuality", "QualityState", "alarm"]

LIMITS = {
    "position": 0.3,
    "drift": 0.25,
    "scatter": 0.25,
    "lamp": 0.05,
    "dark": 0.005,
    "hot": 0.0,
    "dim": 0.01,
    "saturated": 0.0,
    "follow": 0.5,
}
"""Limits of findings on recorded frames, by kind.

``position`` (px rms), ``drift`` and ``scatter`` (of the light of the reference frames, px and px rms), ``lamp``
(relative change), ``dark`` (change of the dark level, fraction of the range), ``hot`` (pixels that became hot),
``dim`` (fraction of positions), ``saturated`` (positions), ``follow`` (px the image moves in the cutout per step).
"""

SUBJECT = {"lamp": "light", "dim": "light", "dark": "sensor", "hot": "sensor", "saturated": "sensor"}
"""Device to which each kind refers, if it is not the stage."""

FEW = 16
FEW_CENTROIDS = 8
FIRST = 200
UNSURE = 0.25
"""Relative error of a predicted change of light after a move of the source."""


def alarm(kind: str, size: float, words: str) -> list[Finding]:
    """Return a list with one finding if ``size`` exceeds the limit of its ``kind``, else an empty list.

    ``kind`` is a key of `LIMITS`, which also states the unit of ``size``, and ``words`` reads "fault: remedy".
    """
    if not size > LIMITS[kind]:
        return []
    what, _, remedy = words.partition(": ")
    subject = SUBJECT.get(kind, "stage")
    return [Finding(kind=kind, what=what, subject=subject, size=size, limit=LIMITS[kind], remedy=remedy)]


@dataclass(frozen=True, slots=True, eq=False)
class QualityState:
    """Snapshot of the quality of a running session.

    Attributes
    ----------
    done
        Number of positions recorded in this run.
    energy
        Sum of each cutout minus its background (counts), ``(nz, ny, nx)``; NaN for positions that are not recorded.
    residual_px
        Lateral distance between the read-back and the target position of the stage (px in object space), ``(nz, ny,
        nx)``; NaN for positions that are not recorded.
    saturated
        Number of saturated pixels in each cutout, ``(nz, ny, nx)``.
    depth_sums
        Sum of the frames minus their background in each plane, over the positions recorded in this run (counts). The
        shape is ``(nz, rows, columns)``, or ``(1, rows, columns)`` for a single plane.
    lamp
        Time since the start, summed over all recordings without pauses (s), and light (counts) of each reference frame,
        ``(n, 2)``.
    places_px
        Centroid (row, column) of the light in the cutout of each reference frame (px), ``(n, 2)``; NaN if the light is
        too faint.
    follow_px
        Movement of the image within the cutout per step of the scan (px): ``((row per y, row per x), (column per y,
        column per x))``. Ideally, it is 0. A value of -2 on the diagonal means that an axis is reversed.
    alarms
        Findings on recorded frames that may require a stop, by the kinds of `LIMITS`.
    """

    done: int
    energy: NDArray[np.float64]
    residual_px: NDArray[np.float32]
    saturated: NDArray[np.int64]
    depth_sums: NDArray[np.float64]
    lamp: NDArray[np.float64]
    places_px: NDArray[np.float64]
    follow_px: NDArray[np.float64]
    alarms: tuple[Finding, ...]


class LiveQuality:
    """Observer of a `Runner` that measures the recorded frames; `state` may be called from any thread.

    Parameters
    ----------
    plan
        Plan of the session.
    window
        Shape ``(rows, columns)`` of the recorded frames (px).
    stride
        After the first 200 frames, the background and the image's position in the cutout are measured only in every
        ``stride``-th frame.

    Examples
    --------
    >>> from pathlib import Path
    >>> from dataclasses import replace
    >>> from lfcal.camera import ScanPlan, preset
    >>> plan = replace(ScanPlan.for_camera(preset("bench"), virtual_depths=[3.0], cutout=21), period=(2, 3))
    >>> from lfcal.devices import simulated_rig
    >>> from lfcal.acquire import LiveQuality, Options, QualityState, record, window_shape
    >>> watch = LiveQuality(plan, window_shape(plan, Options()))
    >>> _ = record(Path("new"), plan, simulated_rig(plan), observers=(watch,))
    >>> state: QualityState = watch.state()
    >>> print(state.done, "positions,", int(state.saturated.max()), "saturated pixels,", state.alarms)
    6 positions, 0 saturated pixels, ()
    """

    def __init__(self, plan: ScanPlan, window: tuple[int, int], *, stride: int = 4) -> None:
        shape = plan.shape[:3]
        self._shape, self._stride = shape, stride
        self._step = [min(plan.step_um(z)) for z in range(shape[0])]
        self._away = "xyz".index(plan.stage.away[1])
        self._energy = np.full(shape, np.nan)
        self._residual = np.full(shape, np.nan, np.float32)
        self._saturated = np.zeros(shape, np.int64)
        self._window = window
        self._sums: dict[int, NDArray[np.float64]] = {}  # only of planes with a frame
        self._levels = np.zeros(shape[0])
        self._before = self._now = 0.0
        self._range = float(plan.camera.sensor.max_value)
        self._references, self._hot = References(self._range), HotPixels(self._range)
        self._reference, self._met_s = (0, 0, 0), 0.0
        self._normal = np.zeros((3, 3))
        self._right = np.zeros((3, 2))
        self._rows, self._columns = np.arange(window[0]), np.arange(window[1])
        self._border = np.ones(window, np.bool_)
        self._border[1:-1, 1:-1] = False
        self._level = float(plan.camera.sensor.black_level)
        self._brightest = 1.0
        self._done = 0
        self._lock = threading.Lock()

    def __call__(self, step: ScheduledFrame, note: Note, frame: NDArray[Any]) -> None:
        """Take an acknowledged frame into account."""
        self._count(note.elapsed_s)
        if step.kind is Kind.DARK:
            self._hot.learn(note.row, note.column, note.exposure_s, frame)
            return
        place = position_at(step.flat, self._shape[1:])
        if step.kind is not Kind.POSITION:
            with self._lock:
                if step.kind is Kind.REFERENCE:
                    self._references.add(self._before + self._now, frame, self._border)
                    self._reference = place
            return
        hot = self._hot.within(note.row, note.column, note.exposure_s, self._window)
        with self._lock:
            if self._done < FIRST or self._done % self._stride == 0:
                # the border of a cutout shows the background, because the spot is in the middle
                self._level = float(np.median(frame[self._border]))
                self._follow(place, frame)
            self._energy[place] = note.energy - hot - self._level * frame.size
            error = [s - t for s, t in zip(note.stage_um, note.target_um, strict=True)]
            # errors in depth do not move the image sideways
            error[self._away] = 0.0
            self._residual[place] = float(np.hypot.reduce(error)) / self._step[step.z]
            self._saturated[place] = note.saturated
            if place == self._reference:
                self._met_s = self._before + self._now
            if step.z not in self._sums:
                self._sums[step.z] = np.zeros(self._window)
            self._sums[step.z] += frame
            self._levels[step.z] += self._level
            self._done += 1

    def remember(self, folder: Path) -> None:
        """Read the reference frames of the session in ``folder``, for comparison with those of the next run.

        Files that cannot be read, and frames of another shape, are ignored.
        """
        # unreadable files only shorten the comparison
        with suppress(LfcalError, OSError), self._lock:
            for check in sampled_references(folder):
                if check.frame.shape == self._window:
                    self._count(check.elapsed_s)
                    self._references.add(self._before + self._now, check.frame, self._border)

    def _count(self, elapsed_s: float) -> None:
        """Add up the time of recording; each recording of a session counts from 0."""
        self._before += self._now if elapsed_s < self._now else 0.0
        self._now = elapsed_s

    def know(self, records: NDArray[Any], levels: NDArray[np.float64]) -> None:
        """Add the positions of earlier runs from their records, but not to the depth sums, which need the frames.

        Parameters
        ----------
        records
            Structured array ``(n,)`` of type `lfcal.acquire.recording.records.RECORD`, one record for each position.
        levels
            Background of each frame (counts per pixel), ``(n,)``.
        """
        place = np.unravel_index(records["index"], self._shape)
        error = records["stage_um"] - records["target_um"]
        error[:, self._away] = 0.0
        with self._lock:
            self._energy[place] = records["energy"] - levels * math.prod(self._window)
            self._residual[place] = np.linalg.norm(error, axis=1) / np.array(self._step)[place[0]]
            self._saturated[place] = records["saturated"]

    def state(self, plane: int | None = None) -> QualityState:
        """Return a snapshot of the quality; if ``plane`` is given, with only the depth sum of that plane."""
        with self._lock:
            references = np.array(self._references.seen).reshape(-1, 5)
            follow = self._slopes()
            return QualityState(
                self._done,
                self._energy.copy(),
                self._residual.copy(),
                self._saturated.copy(),
                self._depth_sums(range(self._shape[0]) if plane is None else (plane,)),
                references[:, :2],
                references[:, 2:4],
                follow,
                self._alarms(references, follow),
            )

    def _depth_sums(self, planes: Iterable[int]) -> NDArray[np.float64]:
        none = np.zeros(self._window)
        return np.stack([self._sums.get(z, none) - self._levels[z] for z in planes])

    def _follow(self, place: tuple[int, int, int], frame: NDArray[Any]) -> None:
        """Add the centroid of ``frame`` to the fit of its movement over y and x."""
        down, along = frame.sum(axis=1, dtype=np.float64), frame.sum(axis=0, dtype=np.float64)
        light = float(down.sum()) - self._level * frame.size
        self._brightest = max(self._brightest, light)
        if light < 0.5 * self._brightest:  # the source has left the cutout, or the lamp is off
            return
        row = (float(down @ self._rows) - self._level * frame.shape[1] * float(self._rows.sum())) / light
        column = (float(along @ self._columns) - self._level * frame.shape[0] * float(self._columns.sum())) / light
        at = np.array([1.0, place[1], place[2]])
        # add to the normal equations, so that no centroid must be kept
        self._normal += np.outer(at, at)
        self._right += np.outer(at, (row, column))

    def _slopes(self) -> NDArray[np.float64]:
        if self._normal[0, 0] < FEW_CENTROIDS:
            return np.zeros((2, 2))
        solution, *_ = np.linalg.lstsq(self._normal, self._right, rcond=1e-9)
        return np.asarray(solution[1:].T)

    def _alarms(self, references: NDArray[np.float64], follow: NDArray[np.float64]) -> tuple[Finding, ...]:
        # a few frames say nothing: no alarm from noise
        seen = np.isfinite(self._energy)
        if seen.sum() < FEW:
            return ()
        alarms: list[Finding] = []

        def look(kind: str, size: float, words: str) -> None:
            alarms.extend(alarm(kind, size, words))

        rms = float(np.sqrt(np.nanmean(np.square(self._residual))))
        look("position", rms, "the stage misses its targets: check load, speed and tolerance")
        moved, scatter = self._references.moved()
        again = "record the positions since then again"
        if scatter > LIMITS["scatter"]:
            look("scatter", scatter, f"the stage is not repeatable: check coupling, load and encoder; {again}")
        else:
            moved = moved if moved > 3 * scatter else 0.0
            look("drift", moved, f"the reference image moved: stage, mount or camera region drifts; {again}")
        lamp, levels = references[:, 1], references[:, 4]
        if len(lamp) > 1 and lamp[0] > 0:
            change = self._lamp_change(references, moved)
        else:
            change = max(_seam(plane) for plane in self._energy)
        look("lamp", change, "the lamp drifts: let it warm up, or stabilise it")
        if len(levels) > 1:
            off = float(np.abs(levels - levels[0]).max()) / self._range
            look("dark", off, "the dark level drifts: let the camera warm up, or record darks more often")
        look("hot", self._references.hot, "pixels became hot: record darks more often, or cool the camera")
        energy = self._energy[seen]
        dim = float((energy < 0.5 * np.median(energy)).mean())
        look("dim", dim, "some positions are much darker than the others: check lamp, shutter and vignetting")
        look("saturated", float((self._saturated > 0).sum()), "saturated pixels: shorten the exposure, or bracket")
        worst = float(np.abs(follow).max())
        look("follow", worst, "the image does not move with the cutout: check sign and scale of the stage's axes")
        return tuple(alarms)

    def _lamp_change(self, references: NDArray[np.float64], moved_px: float) -> float:
        """Return the largest relative change of the light of the reference frames that is caused by the lamp."""
        change = references[:, 1] / references[0, 1]
        if moved_px <= LIMITS["drift"]:
            return float(np.abs(change - 1).max())
        # a displaced source illuminates another part of the lenslets, and the plane was recorded between the moves
        z, y, x = self._reference
        places, amid = references[:, 2:4], int(np.searchsorted(references[:, 0], self._met_s))
        light = light_where(self._energy[z], y, x, places - places[max(0, amid - 1) : amid + 1].mean(axis=0))
        with np.errstate(invalid="ignore", divide="ignore"):
            moves = light / light[0]
            off = np.abs(change / moves - 1) - UNSURE * np.abs(moves - 1)
        return float(np.nanmax(off, initial=0.0))


def _seam(energy: NDArray[np.float64]) -> float:
    """Return the relative change of light over a plane ``(ny, nx)`` that its period does not explain.

    The pattern repeats after the last row, where the light of the first row is expected again; a difference is caused
    by the lamp. Means of rows are compared, and their slope at the seam is estimated from both sides.
    """
    if len(energy) < 4 or not np.isfinite(energy).all():
        return 0.0
    rows = energy.mean(axis=1)
    slope = 0.5 * (rows[1] - rows[0] + rows[-1] - rows[-2])
    change = float(rows[-1] + slope - rows[0])
    return abs(change) / max(abs(float(rows.mean())), 1e-9)
