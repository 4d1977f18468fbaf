"""What one effect does to one position: H's pattern, or the sensor frame, without it and with it. No Qt."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lfcal.base import format_length, format_share
from lfcal.camera import ScanPlan
from lfcal_gui.pages.simulate.model_effects import EffectRow, EffectsVerdict
from lfcal_gui.pages.simulate.model_frames import FrameBench, FrameQuestion

if TYPE_CHECKING:
    from lfcal.simulate import PlaneResponse
    from lfcal.simulate.effects import Effect

KEPT = 32
"""Answers that are kept, the newest."""


@dataclass(frozen=True)
class InfluenceQuestion:
    """Request for the influence of one effect at one position, in addition to the others that are on.

    Attributes
    ----------
    plan, position
        The plan, and the position (z, y, x).
    effect
        The effect.
    others
        The other effects that are on, in the order in which they act on the light.
    on
        Whether the effect is on at the position's depth.
    level, tolerance, peak, seed
        As in `FrameQuestion`.
    """

    plan: ScanPlan
    position: tuple[int, int, int]
    effect: Effect
    others: tuple[Effect, ...]
    on: bool
    level: str
    tolerance: float
    peak: float
    seed: int

    def effects(self, *, with_it: bool) -> tuple[Effect, ...]:
        """Return the effects of one of the two pictures, in the order of the light's way."""
        from lfcal.simulate.effects import CATALOGUE

        order = list(CATALOGUE.names())
        chosen = (*self.others, self.effect) if with_it else self.others
        return tuple(sorted(chosen, key=lambda effect: order.index(effect.name)))

    def place(self) -> str:
        """Return plane and position in words."""
        z, y, x = self.position
        depth = self.plan.depths_um[z]
        return f"z = {format_length(depth)}, v = {self.plan.camera.virtual_depth(depth):.2f}, position ({y}, {x})"


@dataclass(frozen=True, eq=False)
class InfluencePictures:
    """Two pictures ``(rows, columns)`` of one position.

    Attributes
    ----------
    without, with_it
        The pictures.
    origin
        Coordinates (row, column) of their first pixel.
    axes
        What is counted along columns and rows.
    value
        The quantity, with its unit.
    words
        What was computed and how much differs.
    """

    without: NDArray[np.float32]
    with_it: NDArray[np.float32]
    origin: tuple[int, int]
    axes: tuple[str, str]
    value: str
    words: str

    @property
    def difference(self) -> NDArray[np.float32]:
        """With it minus without it."""
        return self.with_it - self.without


def influence_question(verdict: EffectsVerdict, row: EffectRow, position: tuple[int, int, int]) -> InfluenceQuestion:
    """Return the request for the influence of ``row``'s effect at a position, with the effects the planner chose."""
    from lfcal.simulate import budgeted

    plan, settings = verdict.plan, verdict.settings
    selection = verdict.found if row.enters_h else verdict.frames
    chosen, share = budgeted(selection, plan, settings.tolerance).at(plan.depths_um[position[0]])
    others = tuple(effect for effect in chosen if effect.name != row.name)
    on = len(others) < len(chosen)
    how = (settings.level, share, settings.peak, settings.seed)
    return InfluenceQuestion(plan, position, row.effect, others, on, *how)


class Influences:
    """Answers, one at a time; the newest are kept, and so is the settled engine of what is planned."""

    def __init__(self, bench: FrameBench) -> None:
        self._kept: OrderedDict[InfluenceQuestion, InfluencePictures] = OrderedDict()
        self._base: tuple[object, PlaneResponse, str] | None = None
        self._bench = bench
        self._lock = threading.Lock()

    def known(self, question: InfluenceQuestion) -> InfluencePictures | None:
        """Return an answer that is kept."""
        return self._kept.get(question)

    def answer(self, question: InfluenceQuestion, stopped: Callable[[], bool]) -> InfluencePictures | None:
        """Return the two pictures; None where ``stopped()`` said so before they were there."""
        with self._lock:
            if (known := self.known(question)) is not None:
                return known
            made = (self._of_h if question.effect.acts_on.enters_h else self._of_frame)(question, stopped)
            if made is not None:
                self._kept[question] = made
                while len(self._kept) > KEPT:
                    self._kept.popitem(last=False)
            return made

    def _of_h(self, asked: InfluenceQuestion, stopped: Callable[[], bool]) -> InfluencePictures | None:
        planned, level = self._settled(asked)
        other = self._response(asked, with_it=not asked.on)
        if other.level == level:
            # as fine as the planned one: what differs is the effect, not the computation
            other.adopt(planned)
        pictures = {}
        for response, with_it in ((planned, asked.on), (other, not asked.on)):
            picture = _pattern(response, asked, stopped)
            if picture is None:
                return None
            pictures[with_it] = picture
        changed = changed_share(pictures[False], pictures[True])
        energy = float(pictures[True].sum() / max(float(pictures[False].sum()), 1e-30)) - 1
        said = f"{format_share(changed)} of the light differs, energy in the cutout {100 * energy:+.2g} %"
        if changed == 0:
            said = f"nothing differs at level {planned.level}"
        words = f"{asked.place()}: {said}"
        return InfluencePictures(
            pictures[False], pictures[True], (0, 0), ("column s", "row t"), "share of the light", words
        )

    def _settled(self, asked: InfluenceQuestion) -> tuple[PlaneResponse, str]:
        """Return the response of what is planned, and its level before it was settled; settled once for a plane."""
        key = (asked.plan, asked.position[0], asked.effects(with_it=asked.on), asked.level, asked.tolerance)
        if self._base is None or self._base[0] != key:
            response = self._response(asked, with_it=asked.on)
            level = response.level
            response.engine()
            self._base = key, response, level
        return self._base[1], self._base[2]

    @staticmethod
    def _response(asked: InfluenceQuestion, *, with_it: bool) -> PlaneResponse:
        from lfcal.simulate import PlaneResponse

        z = asked.position[0]
        return PlaneResponse(
            asked.plan, z, asked.effects(with_it=with_it), level=asked.level, tolerance=asked.tolerance
        )

    def _of_frame(self, asked: InfluenceQuestion, stopped: Callable[[], bool]) -> InfluencePictures | None:
        pictures, origin = {}, (0, 0)
        for with_it in (False, True):
            effects = asked.effects(with_it=with_it)
            how = (asked.level, asked.tolerance, asked.peak, asked.seed)
            question = FrameQuestion(asked.plan, asked.position, effects, *how)
            frame = self._bench.frame(question, stopped)
            if frame is None:
                return None
            pictures[with_it], origin = frame.cutout()
        light = float(np.abs(pictures[True] - asked.plan.camera.sensor.black_level).sum())
        changed = float(np.abs(pictures[True] - pictures[False]).sum()) / max(light, 1e-30)
        words = f"{asked.place()}: samples differ by {format_share(changed)} of those above black"
        axes = ("sensor column", "sensor row")
        return InfluencePictures(pictures[False], pictures[True], origin, axes, "sample value (counts)", words)


def _pattern(
    response: PlaneResponse, asked: InfluenceQuestion, stopped: Callable[[], bool]
) -> NDArray[np.float32] | None:
    """Return the pattern ``(nt, ns)`` of the position, None where it was stopped between samples of the light."""
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
