"""Sensor frames of the simulated camera, and the influence of one effect at one position. No Qt."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError, centre, format_length, format_share
from lfcal.camera import ScanPlan
from lfcal_gui.pages.simulate.model_effects import EffectRow, EffectsVerdict

if TYPE_CHECKING:
    from lfcal.simulate import PlaneResponse, SimulatedCamera
    from lfcal.simulate.effects import Effect


@dataclass(frozen=True)
class FrameQuestion:
    """Request for the frame of one position (z, y, x) with effects, including those of stage and sensor.

    ``tolerance`` is that of the computation; ``peak`` and ``seed`` are as in `lfcal.tasks.SimulateFrames`.
    """

    plan: ScanPlan
    position: tuple[int, int, int]
    effects: tuple[Effect, ...]
    level: str
    tolerance: float
    peak: float
    seed: int

    def place(self) -> str:
        """Return plane and position as text."""
        z, y, x = self.position
        depth = self.plan.depths_um[z]
        virtual = f", v = {self.plan.camera.virtual_depth(depth):.2f}" if self.plan.camera.has_lattice else ""
        return f"z = {format_length(depth)}{virtual}, position ({y}, {x})"


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """A simulated sensor frame.

    Attributes
    ----------
    samples
        Sample values ``(rows, columns)``.
    question
        Request for the frame.
    """

    samples: NDArray[Any]
    question: FrameQuestion

    def window(self) -> tuple[int, int]:
        """Return the first pixel (row, column) of the position's cutout; it may be outside the sensor."""
        from lfcal.simulate import origin_of

        plan = self.question.plan
        row, column, _, _ = origin_of(plan)
        _, y, x = self.question.position
        fy, fx = plan.resample_factors
        middle = row + round(y / fy), column + round(x / fx)
        return middle[0] - centre(plan.cutout[0]), middle[1] - centre(plan.cutout[1])

    def cutout(self) -> tuple[NDArray[np.float32], tuple[int, int]]:
        """Return the samples of the cutout that are on the sensor, and their first pixel (row, column)."""
        top, left = self.window()
        nt, ns = self.question.plan.cutout
        r0, c0 = max(0, top), max(0, left)
        part = self.samples[r0 : max(r0, top + nt), c0 : max(c0, left + ns)]
        if part.size == 0:
            raise InputError.expected(
                "position", "a position whose cutout is on the sensor", self.question.place(), "choose another position"
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
    """Return the request for the frame of a position with all effects that the planner has on for frames."""
    from lfcal.simulate import budgeted

    depth, settings = verdict.plan.depths_um[position[0]], verdict.settings
    effects, share = budgeted(verdict.frames, verdict.plan, settings.tolerance).at(depth)
    return FrameQuestion(verdict.plan, position, effects, settings.level, share, settings.peak, settings.seed)


class FrameBench:
    """Simulator of frames of single positions.

    The light of the last frame is kept, and reused if only sensor effects change. A frame is scaled as in a session
    that records only its plane: the brightest pixel of this session reaches the ``peak`` of the request.
    """

    def __init__(self) -> None:
        self._light: tuple[object, SimulatedCamera, int, NDArray[np.float32]] | None = None
        self._lock = threading.Lock()

    def frame(self, asked: FrameQuestion, stopped: Callable[[], bool] = lambda: False) -> SimulatedFrame | None:
        """Return the frame; None if ``stopped()`` returned True before it was complete.

        Raises
        ------
        InputError
            If plan and effects do not match.
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
    """Write the samples to ``part`` in the format given by ``path``: TIFF for any samples, PNG for integers.

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
        raise InputError.expected(
            path.name,
            "a name that ends with .tif or .png",
            path.suffix or "no suffix",
            "end the name with .tif or .png",
        )
    if frame.samples.dtype != np.uint16:
        raise InputError.expected(
            path.name, "whole numbers", "fractional values", "switch quantisation on, or save as TIFF"
        )
    from lfcal.base import cv2

    ok, encoded = cv2.imencode(".png", frame.samples)
    if not ok:
        raise InputError.expected(
            path.name, "an image that PNG can store", f"shape {frame.samples.shape}", "save it as TIFF"
        )
    part.write_bytes(encoded.tobytes())


@dataclass(frozen=True)
class KeptFrames:
    """Frames of a stopped simulation of a session; see `lfcal_gui.models.job.Keeping`."""

    out: str

    def look(self) -> str:
        """Return the number of written frames as text; if there are none, remove all traces."""
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


KEPT = 32
"""Largest number of stored results; the oldest are dropped."""


@dataclass(frozen=True)
class InfluenceQuestion:
    """Request for the influence of one effect at one position, in addition to the others that are on.

    Attributes
    ----------
    without, with_it
        Requests without and with the effect; effects are in the order in which they act on the light.
    enters_h
        Whether the effect acts on H; else it acts only on sensor frames.
    on
        Whether the effect is on at the position's depth.
    """

    without: FrameQuestion
    with_it: FrameQuestion
    enters_h: bool
    on: bool

    @property
    def planned(self) -> FrameQuestion:
        """The request that matches the planner's decision."""
        return self.with_it if self.on else self.without


@dataclass(frozen=True, eq=False)
class InfluencePictures:
    """Two images ``(rows, columns)`` of one position.

    Attributes
    ----------
    without, with_it
        The images.
    origin
        Coordinates (row, column) of their first pixel.
    axes
        Labels of the column and row axes.
    value
        The quantity, with its unit.
    words
        Description of the computation and of the difference.
    """

    without: NDArray[np.float32]
    with_it: NDArray[np.float32]
    origin: tuple[int, int]
    axes: tuple[str, str]
    value: str
    words: str

    @property
    def difference(self) -> NDArray[np.float32]:
        """Image with the effect minus image without it."""
        return self.with_it - self.without


def influence_question(verdict: EffectsVerdict, row: EffectRow, position: tuple[int, int, int]) -> InfluenceQuestion:
    """Return the request for the influence of ``row``'s effect at a position, with the effects the planner chose."""
    from lfcal.simulate import budgeted
    from lfcal.simulate.effects import CATALOGUE

    plan, settings, order = verdict.plan, verdict.settings, list(CATALOGUE.names())
    selection = verdict.found if row.enters_h else verdict.frames
    chosen, share = budgeted(selection, plan, settings.tolerance).at(plan.depths_um[position[0]])
    others = tuple(effect for effect in chosen if effect.name != row.name)

    def asked(*effects: Effect) -> FrameQuestion:
        ordered = tuple(sorted(effects, key=lambda effect: order.index(effect.name)))
        return FrameQuestion(plan, position, ordered, settings.level, share, settings.peak, settings.seed)

    return InfluenceQuestion(asked(*others), asked(*others, row.effect), row.enters_h, len(others) < len(chosen))


class Influences:
    """Compute influences one at a time; store the newest results and the engine of the planned effects."""

    def __init__(self, bench: FrameBench) -> None:
        self._kept: OrderedDict[InfluenceQuestion, InfluencePictures] = OrderedDict()
        self._base: tuple[object, PlaneResponse, str] | None = None
        self._bench = bench
        self._lock = threading.Lock()

    def known(self, question: InfluenceQuestion) -> InfluencePictures | None:
        """Return a stored result; None if there is none."""
        return self._kept.get(question)

    def answer(self, question: InfluenceQuestion, stopped: Callable[[], bool]) -> InfluencePictures | None:
        """Return the two images; None if ``stopped()`` returned True before they were complete."""
        with self._lock:
            if (known := self.known(question)) is not None:
                return known
            made = (self._of_h if question.enters_h else self._of_frame)(question, stopped)
            if made is not None:
                self._kept[question] = made
                while len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            return made

    def _of_h(self, asked: InfluenceQuestion, stopped: Callable[[], bool]) -> InfluencePictures | None:
        planned, level = self._settled(asked.planned)
        other = _response(asked.without if asked.on else asked.with_it)
        if other.level == level:
            # as fine as the planned one: what differs is the effect, not the computation
            other.adopt(planned)
        pictures = {}
        for response, with_it in ((planned, asked.on), (other, not asked.on)):
            picture = _pattern(response, asked.planned, stopped)
            if picture is None:
                return None
            pictures[with_it] = picture
        changed = changed_share(pictures[False], pictures[True])
        energy = float(pictures[True].sum() / max(float(pictures[False].sum()), 1e-30)) - 1
        said = f"{format_share(changed)} of the light differs; energy in the cutout {100 * energy:+.2g} %"
        if changed == 0:
            said = f"nothing differs at level {planned.level}"
        words = f"{asked.planned.place()}: {said}"
        return InfluencePictures(
            pictures[False], pictures[True], (0, 0), ("column s", "row t"), "fraction of the light", words
        )

    def _settled(self, asked: FrameQuestion) -> tuple[PlaneResponse, str]:
        """Return the response of the planned effects with its sampling determined, and its level before that.

        The sampling is determined once per plane.
        """
        key = (asked.plan, asked.position[0], asked.effects, asked.level, asked.tolerance)
        if self._base is None or self._base[0] != key:
            response = _response(asked)
            level = response.level
            response.engine()
            self._base = key, response, level
        return self._base[1], self._base[2]

    def _of_frame(self, asked: InfluenceQuestion, stopped: Callable[[], bool]) -> InfluencePictures | None:
        pictures, origin = [], (0, 0)
        for question in (asked.without, asked.with_it):
            frame = self._bench.frame(question, stopped)
            if frame is None:
                return None
            picture, origin = frame.cutout()
            pictures.append(picture)
        light = float(np.abs(pictures[True] - asked.planned.plan.camera.sensor.black_level).sum())
        changed = float(np.abs(pictures[True] - pictures[False]).sum()) / max(light, 1e-30)
        words = f"{asked.planned.place()}: the samples differ by {format_share(changed)} of the signal"
        axes = ("sensor column", "sensor row")
        return InfluencePictures(pictures[False], pictures[True], origin, axes, "sample value (counts)", words)


def _response(asked: FrameQuestion) -> PlaneResponse:
    from lfcal.simulate import PlaneResponse

    return PlaneResponse(asked.plan, asked.position[0], asked.effects, level=asked.level, tolerance=asked.tolerance)


def _pattern(response: PlaneResponse, asked: FrameQuestion, stopped: Callable[[], bool]) -> NDArray[np.float32] | None:
    """Return the pattern ``(nt, ns)`` of the position; None if stopped between samples of the light."""
    out = np.zeros((1, 1, *asked.plan.cutout), np.float32)
    _, y, x = asked.position
    for _ in response.accumulate(out, np.array([y]), np.array([x]), block=1, workers=1):
        if stopped():
            return None
    pattern: NDArray[np.float32] = out[0, 0]
    return pattern


def changed_share(without: NDArray[np.float32], with_it: NDArray[np.float32]) -> float:
    """Return the relative L1 difference: sum(|with - without|) / sum(|with|)."""
    total = float(np.abs(with_it).sum(dtype=np.float64))
    return float(np.abs(with_it - without).sum(dtype=np.float64)) / max(total, 1e-30)
