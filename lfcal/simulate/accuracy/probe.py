"""Search for the sampling that a plane needs, by computing a few of its positions more finely."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import InputError
from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate.accuracy.cost import efficient_steps, step_for
from lfcal.simulate.accuracy.sampling import (
    DEBYE_GAIN,
    GRID_REFERENCE,
    WIDEST,
    LevelSampling,
    comparison,
    finer,
    steps_for,
)
from lfcal.simulate.engines import SWITCH, EnergyError, PlaneEngine, Sampling, engine_for
from lfcal.simulate.scene import Scene

__all__ = ["LARGEST_GRID", "RETRIES", "Settled", "balanced", "places", "settle"]

RETRIES = 4
"""Largest number of refinements until the energy balances."""

MARGIN = 1.1
"""Factor by which the error of a plane may exceed that of a few positions."""

VISIBLE_COHERENT, VISIBLE_SUMMED = 0.65, 0.5
"""Fraction of a sampling's error that a comparison with a window twice as wide shows (measured)."""

VISIBLE_BY_GRID = 0.9
"""Fraction of the error of windows that a comparison with a grid shows, which has no error of this kind."""

VISIBLE_NODES = {1: 0.9, 2: 0.8, 3: 0.6, 4: 0.6}
"""Fraction of the error of up to four nodes per pixel on the Debye path that one node more shows (measured: at least
0.87, 0.79, 0.6 and 0.6)."""

VISIBLE_MORE_NODES = 0.4
"""Fraction of the error of more nodes that one node more shows (measured: at least 0.45). An odd number of
nodes and one more have similar errors."""

OF_WINDOWS = 1.5
"""Factor by which the error of windows may exceed the expected one."""

STAGNATION = 0.8
"""Ratio to the previous sampling's error above which the error comes from the engine, and finer sampling is useless."""

WIDER = (1.9, 1.4, 1.1)
"""Margin of the sampling used for comparison, relative to the sampling's own. Tails decrease with the window's width or
faster. The first margin that fits into memory is used."""

LARGEST_GRID = 3200
"""Side of the reference's grid up to which it is fast enough for a few positions."""

Responses = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Settled:
    """A sampling, its engine, and its error.

    Attributes
    ----------
    engine
        The engine for the undisplaced source.
    level, sampling
        Level and sampling of the engine.
    error
        Relative L1 error of the sampling, estimated from its difference from a finer computation at the probed
        positions. If no finer computation is possible, the expected error.
    """

    engine: PlaneEngine
    level: str
    sampling: Sampling
    error: float


def settle(scene: AnyScene, level: str, share: float, *, escalate: bool = False) -> Settled:
    """Return the fastest sampling of a level with an error of at most ``share``, or else that with the smallest error.

    Samplings are tried from the fastest that is expected to suffice; those that are slower than a finer one are
    skipped. Each is compared with one that is finer in all respects. Windows are compared with the whole array on one
    grid, and a grid with a finer grid. If no grid is large enough for the scene, windows are compared with wider ones
    whose fields are added. Windows follow exact angles only to first order. With exact angles, they are therefore
    compared with the reference instead if its grid is small enough. A smaller ``share`` never leads to a coarser
    sampling.

    Parameters
    ----------
    scene
        Scene of the depth plane.
    level
        ``"wave"``, ``"grid"``, ``"debye"``, ``"reference"`` or ``"geometric"`` (rays, which have no sampling).
    share
        Relative L1 error allowed for the computation.
    escalate
        Whether the reference may be used if the error of the wave level exceeds ``share``.

    Raises
    ------
    EnergyError
        If the energy does not balance at any sampling.
    """
    if isinstance(scene, PupilScene):  # the error of its engine is known before (see tests of the engine)
        step = step_for(scene, level, share)
        return Settled(engine_for(scene, level, step.sampling), level, step.sampling, step.expected)
    if level == "geometric":
        return Settled(engine_for(scene, level), level, Sampling(), 0.0)
    probe = _ErrorProbe(scene, level)
    steps = list(efficient_steps(scene, level))
    if escalate and probe.by_reference:
        steps += steps_for(scene, "reference")
    first = next((k for k, step in enumerate(steps) if step.expected <= share), len(steps) - 1)
    settled: Settled | None = None
    stuck = summed = False
    for step in steps[first:]:
        if (stuck and step.level == level) or (summed and step in probe.summed):
            continue
        try:
            found = probe.measured(step, settled, share)
        except (InputError, EnergyError):
            if settled is None:
                raise
            break  # the grid is too large: keep what was reached before
        stuck = probe.by_reference and settled is not None and found.error > STAGNATION * settled.error
        summed = summed or probe.is_summing(step, found.error, share)
        if settled is None or found.error < settled.error:
            settled = found
        del found  # free its tables for the next one
        if settled.error <= share:
            break
    assert settled is not None  # there is at least one sampling
    return settled


def balanced(scene: AnyScene, level: str, sampling: Sampling) -> tuple[PlaneEngine, Responses, Sampling]:
    """Return an engine whose energy balances, its responses at the positions of `places`, and its sampling.

    The sampling is refined up to `RETRIES` times. If the energy still does not balance, raise `EnergyError`.
    """
    ys, xs = places(scene)
    for attempt in range(RETRIES + 1):
        engine = engine_for(scene, level, sampling)
        try:
            found = engine.rows(ys, xs, workers=1)  # every response is certified again later
        except EnergyError:
            if attempt == RETRIES:
                raise
            if level in ("reference", "grid"):
                sampling = replace(sampling, samples_per_px=(sampling.samples_per_px or 8) + 1)
            else:
                sampling = finer(sampling)
        else:
            break
    return engine, found.astype(np.float64), sampling


def places(scene: AnyScene) -> tuple[list[int], list[int]]:
    """Return the rows and columns of source positions that represent all others.

    There are two rows and two columns, and more near the native plane, where one lenslet or the gap between two
    receives all the light.
    """
    near = isinstance(scene, Scene) and scene.objective is None and scene.fresnel_number < SWITCH
    shares = ((0.0, 0.2, 0.5), (0.07, 0.25, 0.41, 0.75)) if near else ((0.0, 0.5), (0.25, 0.75))
    rows, columns = (sorted({int(s * n) for s in some}) for some, n in zip(shares, scene.period, strict=True))
    return rows, columns


DARK = 1e-3
"""Smallest light to which errors are related, as a fraction of the iris's light: a cutout may receive hardly any."""


class _ErrorProbe:
    """Measures samplings of one scene and stores the responses that it computed."""

    def __init__(self, scene: Scene, level: str) -> None:
        self.scene, self.level = scene, level
        self.steps = steps_for(scene, level)
        self._on_grid = tuple(step for step in self.steps if step.level == "grid")
        small = self._reference_side() <= LARGEST_GRID
        self.by_reference = level == "wave" and not self._on_grid and scene.exact_rays and small
        self._computed: dict[tuple[str, Sampling], Responses] = {}
        self._last: tuple[tuple[str, Sampling], PlaneEngine, Sampling] | None = None

    @property
    def summed(self) -> tuple[LevelSampling, ...]:
        """The samplings that add intensities of neighbouring lenslets, if a grid can add their fields."""
        return tuple(s for s in self.steps if s.level == "wave" and not s.sampling.coherent) if self._on_grid else ()

    def is_summing(self, step: LevelSampling, error: float, share: float) -> bool:
        """Return whether adding intensities prevents a sampling from reaching ``share``."""
        if step not in self.summed:
            return False
        windows = OF_WINDOWS * (step.expected - self.summed[-1].expected)
        return error - windows > share

    def _reference_side(self) -> float:
        """Return the approximate side of the reference's coarsest grid."""
        scene = self.scene
        samples = steps_for(scene, "reference")[0].sampling.samples_per_px or 8
        across = 2 * scene.shadow_radius_um + 4 * scene.lattice.pitch_um
        return samples * max(across / scene.reduced_pixel_um, max(scene.cutout))

    def measured(self, step: LevelSampling, before: Settled | None = None, share: float = 0.0) -> Settled:
        """Return a sampling with its error.

        The error is predicted if nothing finer can be computed. It is that of the sampling ``before`` less the
        difference of the two if this is at most ``share``.
        """
        engine, found, sampling = self._balanced(step)
        if before is not None and (error := self._remaining(step, before)) <= share:
            return Settled(engine, step.level, sampling, error)
        for level, finer_sampling, visible in self._references(step, sampling, engine.level):
            try:
                truth = self._responses(level, finer_sampling)
            except (InputError, EnergyError):  # for example, the grid is too large
                continue
            ny, nx = truth.shape[:2]
            light = max(float(truth.sum()), DARK * ny * nx)
            error = float(np.abs(found - truth).sum()) / light
            return Settled(engine, step.level, sampling, MARGIN * error / visible)
        return Settled(engine, step.level, sampling, self._improved(step, before))

    def _balanced(self, step: LevelSampling) -> tuple[PlaneEngine, Responses, Sampling]:
        """Return the result of `balanced` for a step; the engine of the last comparison is reused."""
        if self._last is not None and self._last[0] == (step.level, step.sampling):
            _, engine, sampling = self._last
            return engine, self._computed[step.level, sampling], sampling
        engine, found, sampling = balanced(self.scene, step.level, step.sampling)
        self._computed[step.level, sampling] = found
        return engine, found, sampling

    def _remaining(self, step: LevelSampling, before: Settled) -> float:
        """Return the error of a step with which the sampling ``before`` was compared; infinite for others."""
        for other in self._on_grid:
            against = comparison(self._on_grid, other)
            if (other.level, other.sampling) == (before.level, before.sampling) and against and against[0] == step:
                return before.error * (1 - against[1])
        return math.inf

    def _improved(self, step: LevelSampling, before: Settled | None) -> float:
        """Return the error of a sampling without comparison: better than the one before by the expected factor."""
        known = [s.expected for s in self.steps if before and (s.level, s.sampling) == (before.level, before.sampling)]
        if before is None or not known:
            return step.expected
        return max(step.expected, before.error * step.expected / known[0])

    def _responses(self, level: str, sampling: Sampling) -> Responses:
        if (level, sampling) not in self._computed:
            self._last = None  # free its tables first
            engine, self._computed[level, sampling], used = balanced(self.scene, level, sampling)
            if used == sampling:
                self._last = (level, sampling), engine, sampling
        return self._computed[level, sampling]

    def _references(self, step: LevelSampling, sampling: Sampling, level: str) -> Iterator[tuple[str, Sampling, float]]:
        """Yield samplings to compare one with, the best first, and the fraction of its error that each shows.

        The difference between a step and a finer one is the error of the step minus that of the finer one. ``level`` is
        the engine's level.
        """
        if step.level == "debye":
            visible = VISIBLE_NODES.get(sampling.nodes_per_px, VISIBLE_MORE_NODES)
            yield step.level, finer(sampling), visible if level == "debye" else 1 - 1 / DEBYE_GAIN
        elif step.level == "reference":
            for more in (3, 1):
                yield step.level, replace(sampling, samples_per_px=(sampling.samples_per_px or 8) + more), 1.0
        elif step.level == "grid":
            if (other := comparison(self._on_grid, step)) is not None:
                yield "grid", other[0].sampling, other[1]
        else:
            for grid in self._on_grid[GRID_REFERENCE:]:
                yield "grid", grid.sampling, VISIBLE_BY_GRID
            if self.by_reference:
                yield "reference", steps_for(self.scene, "reference")[1].sampling, 1.0
            for wider in WIDER:
                yield (
                    step.level,
                    self._wider(sampling, wider),
                    VISIBLE_COHERENT if sampling.coherent else VISIBLE_SUMMED,
                )

    def _wider(self, sampling: Sampling, by: float) -> Sampling:
        """Return the coherent sampling with a window wider by the factor ``by``; beyond the last one, a new one."""
        wanted = min(WIDEST, by * sampling.margin_px)
        for step in self.steps:
            if step.sampling.coherent and step.sampling.margin_px >= wanted:
                return replace(step.sampling, nodes_per_px=max(step.sampling.nodes_per_px, sampling.nodes_per_px + 1))
        last = self.steps[-1].sampling
        return replace(
            last,
            nodes_per_px=max(last.nodes_per_px, sampling.nodes_per_px) + 1,
            margin_px=round(wanted),
            energy_floor=min(last.energy_floor, sampling.energy_floor / 2),
        )
