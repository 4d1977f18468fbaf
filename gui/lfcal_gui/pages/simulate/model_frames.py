"""Sensor frames of the simulated camera: one of a chosen position, or those of a whole session. No Qt."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, centre, format_length
from lfcal.camera import ScanPlan
from lfcal_gui.pages.simulate.model_effects import EffectsVerdict

if TYPE_CHECKING:
    from lfcal.simulate import SimulatedCamera
    from lfcal.simulate.effects import Effect


@dataclass(frozen=True)
class FrameQuestion:
    """Request for the frame of one position (z, y, x) with effects, including those of stage and sensor.

    ``tolerance`` is the computation's share; ``peak`` and ``seed`` are as in `lfcal.tasks.SimulateFrames`.
    """

    plan: ScanPlan
    position: tuple[int, int, int]
    effects: tuple[Effect, ...]
    level: str
    tolerance: float
    peak: float
    seed: int

    def place(self) -> str:
        """Return plane and position in words."""
        z, y, x = self.position
        return f"z = {format_length(self.plan.depths_um[z])}, position ({y}, {x})"


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """A simulated sensor frame.

    Attributes
    ----------
    samples
        Sample values ``(rows, columns)``.
    question
        What was asked.
    """

    samples: NDArray[Any]
    question: FrameQuestion

    def window(self) -> tuple[int, int]:
        """Return the first pixel (row, column) of the position's cutout; it may lie off the sensor."""
        from lfcal.simulate import origin_of

        plan = self.question.plan
        row, column, _, _ = origin_of(plan)
        _, y, x = self.question.position
        fy, fx = plan.resample_factors
        middle = row + round(y / fy), column + round(x / fx)
        return middle[0] - centre(plan.cutout[0]), middle[1] - centre(plan.cutout[1])

    def cutout(self) -> tuple[NDArray[np.float32], tuple[int, int]]:
        """Return the samples of the cutout that lie on the sensor, and their first pixel (row, column)."""
        top, left = self.window()
        nt, ns = self.question.plan.cutout
        r0, c0 = max(0, top), max(0, left)
        part = self.samples[r0 : max(r0, top + nt), c0 : max(c0, left + ns)]
        if part.size == 0:
            raise InputError.expected(
                "position", "one whose cutout is on the sensor", self.question.place(), "choose another"
            )
        return part.astype(np.float32), (r0, c0)

    def words(self) -> str:
        """Return the caption of the frame, one line of text."""
        sensor = self.question.plan.camera.sensor
        rows, columns = self.samples.shape
        top = float(self.samples.max())
        full = int(np.count_nonzero(self.samples >= sensor.saturated_from))
        kind = "whole numbers" if self.samples.dtype.kind == "u" else "not rounded"
        return (
            f"{self.question.place()}: {rows} × {columns} px, {kind}, highest {top:.0f} of {sensor.max_value:.0f} "
            f"counts, {full} px saturated"
        )


def frame_question(verdict: EffectsVerdict, position: tuple[int, int, int]) -> FrameQuestion:
    """Return the question for the frame of a position with everything that the planner has on for frames."""
    from lfcal.simulate import budgeted

    depth, settings = verdict.plan.depths_um[position[0]], verdict.settings
    effects, share = budgeted(verdict.frames, verdict.plan, settings.tolerance).at(depth)
    return FrameQuestion(verdict.plan, position, effects, settings.level, share, settings.peak, settings.seed)


class FrameBench:
    """Simulator of frames of single positions. The light of the last one is kept and reused for new sensor effects.

    A frame is scaled as in a session of its plane alone, whose brightest pixel reaches the peak.
    """

    def __init__(self) -> None:
        self._light: tuple[object, SimulatedCamera, int, NDArray[np.float32]] | None = None
        self._lock = threading.Lock()

    def frame(self, asked: FrameQuestion, stopped: Callable[[], bool] = lambda: False) -> SimulatedFrame | None:
        """Return the frame, None where ``stopped()`` said so before it was there.

        Raises
        ------
        InputError
            If plan and effects do not fit.
        """
        from lfcal.simulate import expose
        from lfcal.simulate.effects import FrameEffect

        with self._lock:
            camera, index, light = self._lit(asked)
        if stopped():
            return None
        on_sensor = [effect for effect in asked.effects if isinstance(effect, FrameEffect)]
        samples = expose(
            light, camera.camera, on_sensor, exposure_s=camera.exposure_s(index), seed=camera.seed, index=index
        )
        return None if stopped() else SimulatedFrame(samples, asked)

    def _lit(self, asked: FrameQuestion) -> tuple[SimulatedCamera, int, NDArray[np.float32]]:
        from lfcal.simulate import SimulatedCamera
        from lfcal.simulate.effects import FrameEffect

        before = tuple(effect for effect in asked.effects if not isinstance(effect, FrameEffect))
        key = (replace(asked, effects=before), asked.plan.camera)
        if self._light is None or self._light[0] != key:
            z, y, x = asked.position
            one = replace(asked.plan, depths_um=(asked.plan.depths_um[z],), exposure_s=asked.plan.exposures[z])
            how: dict[str, Any] = {"tolerance": asked.tolerance, "peak": asked.peak, "seed": asked.seed}
            camera = SimulatedCamera(one, before, level=asked.level, **how)
            index = int(np.flatnonzero((one.order_indices() == (0, y, x)).all(axis=1))[0])
            self._light = key, camera, index, camera.light(index)
        return self._light[1:]


def write_frame(frame: SimulatedFrame, path: Path, part: Path) -> None:
    """Write the samples to ``part``, as the name ``path`` asks: TIFF of any samples, PNG of whole numbers.

    Raises
    ------
    InputError
        For another kind of file, or PNG of samples that are not rounded.
    """
    if path.suffix.lower() in (".tif", ".tiff"):
        from lfcal.base import write_tiff

        write_tiff(part, frame.samples)
        return
    if path.suffix.lower() != ".png":
        raise InputError.expected(path.name, "a name that ends with .tif or .png", path.suffix or "none", "change it")
    if frame.samples.dtype != np.uint16:
        raise InputError.expected(path.name, "whole numbers", "others", "switch quantisation on, or save as TIFF")
    import cv2

    ok, encoded = cv2.imencode(".png", frame.samples)
    if not ok:
        raise InputError.expected(path.name, "a picture that PNG can hold", "another", "save it as TIFF")
    part.write_bytes(encoded.tobytes())


@dataclass(frozen=True)
class KeptFrames:
    """The frames of a session that was stopped; see `lfcal_gui.models.job.Keeping`."""

    out: str

    def look(self) -> str:
        """Return how many frames are written; where none is, nothing stays."""
        from lfcal.simulate.sensor import unfinished

        found = unfinished(self.out)
        if found is None:
            return ""
        if found[0]:
            return f"{found[0]} of {found[1]} frames"
        self.discard()
        return ""

    def discard(self) -> None:
        """Remove the frames."""
        from lfcal.simulate.sensor import discard_unfinished

        discard_unfinished(self.out)
