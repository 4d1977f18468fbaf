"""Measure the cost of accuracy: time and error of every level and sampling, on one scene."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.base import Clock, InputError, LfcalError, Progress, Work, drained
from lfcal.camera import ScanPlan
from lfcal.simulate.accuracy.forecast import CostScaling, computed_share, cost_scaling
from lfcal.simulate.accuracy.probe import LARGEST_GRID
from lfcal.simulate.accuracy.sampling import LevelSampling, steps_for
from lfcal.simulate.engines import EnergyError, PlaneEngine, Sampling, engine_for
from lfcal.simulate.plane_task import EffectsLike, budgeted
from lfcal.simulate.scene import Scene
from lfcal.simulate.staging import lattice_scene_for, resolve_level

__all__ = [
    "Ladder",
    "LadderProgress",
    "LadderRung",
    "draw_ladder",
    "iter_ladder",
    "ladder",
    "quick_steps",
    "rung_label",
]

REFERENCE_SAMPLES = (12, 10, 8, 6, 4)
"""Numbers of samples per pixel of the reference; the largest one that fits into its grid is used."""

DEBYE_SHOWN, WIDEST_SHOWN = 6, 40
"""Largest number of nodes per pixel and largest margin (px) that are measured; larger ones take a very long time."""


@dataclass(frozen=True, slots=True)
class LadderRung:
    """One level and sampling, with its error and CPU time.

    Attributes
    ----------
    level, sampling
        Level of the engine and its sampling; None for the geometric level, which has none.
    label
        Display name.
    error
        Relative L1 error with respect to the reference, averaged over the compared positions.
    setup_seconds
        CPU time for the tables of a plane (s).
    position_seconds
        CPU time for one source position (s).
    whole_seconds
        Predicted CPU time for all of H: all planes, positions, source points and wavelengths (s).
    efficient
        Whether no other sampling is both faster and more accurate.
    """

    level: str
    sampling: Sampling | None
    label: str
    error: float
    setup_seconds: float
    position_seconds: float
    whole_seconds: float
    efficient: bool = False


@dataclass(frozen=True, slots=True)
class Ladder:
    """Error and CPU time of several levels and samplings for one scene, and the one that a tolerance selects.

    Attributes
    ----------
    rungs
        Measured levels and samplings whose energy balance is correct, fastest first.
    refused
        Labels of samplings that are too coarse for this scene: a response contains more light than its input.
    tolerance
        Requested relative L1 error of H.
    reference
        Label of the reference sampling, with which the others are compared.
    reference_seconds
        Predicted CPU time for all of H with the reference sampling (s).
    virtual_depth
        Virtual depth of the measured plane: distance of the main image behind the lenslets divided by the gap.
    positions
        Number of source positions at which the samplings are compared.
    """

    rungs: tuple[LadderRung, ...]
    refused: tuple[str, ...]
    tolerance: float
    reference: str
    reference_seconds: float
    virtual_depth: float
    positions: int

    @property
    def chosen(self) -> LadderRung | None:
        """The fastest sampling within the tolerance, or the most accurate one if none is; None if there are none."""
        good = [rung for rung in self.rungs if rung.error <= self.tolerance]
        if good:
            return min(good, key=lambda rung: rung.whole_seconds)
        return min(self.rungs, key=lambda rung: rung.error, default=None)


@dataclass(frozen=True, slots=True)
class LadderProgress(Progress):
    """Progress of the measurement, with the samplings measured so far in the attribute ``ladder``."""

    ladder: Ladder = field(kw_only=True)


def iter_ladder(
    plan: ScanPlan,
    tolerance: float | None = None,
    *,
    effects: EffectsLike = "auto",
    z: int | None = None,
    positions: int = 3,
    samplings: Iterable[Sampling | LevelSampling] | None = None,
    reference: Sampling | None = None,
) -> Work[Ladder]:
    """Measure the CPU time and the error of several levels and samplings in one plane, and return them.

    Parameters
    ----------
    plan
        Scan plan for which H is simulated.
    tolerance
        Relative L1 error for which a sampling is selected. None: as in `simulate_psf`.
    effects
        As in `simulate_psf`; the same effects are simulated with every sampling.
    z
        Index of the plane in ``plan.depths_um``. None: the middle one.
    positions
        Number of source positions to compare, spread over the period.
    samplings
        What to measure: each `Sampling` is used with the wave level that the scene requires, each `LevelSampling` with
        its own level. None: a default series from coarse to fine.
    reference
        Sampling of the reference. None: the finest grid that fits into the size limit of grids.

    Yields
    ------
    Progress
        Counted in samplings; a `LadderProgress` after the first one.

    Raises
    ------
    InputError
        If the plan has no such plane, or no grid is large enough for the reference.

    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import LadderProgress, iter_ladder
    >>> from lfcal.simulate.effects import LensTypeDefocus
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> work = iter_ladder(plan, effects=[LensTypeDefocus()], positions=1, samplings=())
    >>> step: LadderProgress = next(work)
    >>> print(step.stage, step.count, step.note, sep="; ")
    accuracy as a function of time; 0 of 2; reference
    >>> work.close()  # cancel the measurement
    """
    z = len(plan.depths_um) // 2 if z is None else z
    if not 0 <= z < len(plan.depths_um):
        raise InputError.expected("plane", f"0 to {len(plan.depths_um) - 1}", z, "choose a plane of the plan")
    budget = budgeted(effects, plan, tolerance)
    chosen, _ = budget.at(plan.depths_um[z])
    scene, level = _with_waves(lattice_scene_for(plan, z, chosen))
    places = _places(scene.period, positions)
    asked = quick_steps(scene, level) if samplings is None else samplings
    steps = [(s.level, s.sampling) if isinstance(s, LevelSampling) else (level, s) for s in asked]
    tasks: list[tuple[str, Sampling | None]] = [("geometric", None), *steps]
    clock = Clock("accuracy as a function of time", len(tasks) + 1)
    yield clock.at(0, "reference")
    # one scene for all rungs: they differ only in how it is computed
    truth, per_px, each = _reference(scene, places, reference)
    shares = cost_scaling(plan, z, budget, level)
    whole = each * scene.period[0] * scene.period[1] * shares.runs * shares.planes
    v = plan.camera.virtual_depth(plan.depths_um[z])
    found = Ladder((), (), budget.tolerance, f"reference, {per_px} samples/px", whole, v, len(places))
    for done, (kind, sampling) in enumerate(tasks, 1):
        label = rung_label(kind, sampling)
        yield _with_ladder(clock.at(done, label), found)
        try:
            rung = _measure(scene, kind, sampling, places, truth, shares)
            found = replace(found, rungs=_marked((*found.rungs, rung)))
        except EnergyError:
            found = replace(found, refused=(*found.refused, label))
    yield _with_ladder(clock.at(len(tasks) + 1), found)
    return found


ladder = drained(
    iter_ladder,
    """
    Examples
    --------
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import Ladder, Sampling, ladder
    >>> from lfcal.simulate.effects import LensTypeDefocus
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> found: Ladder = ladder(plan, effects=[LensTypeDefocus()], positions=1, samplings=[Sampling()])
    >>> for rung in found.rungs:
    ...     print(f"{rung.label}: off by {rung.error:.0%} at v = {found.virtual_depth:.0f}")
    geometric: off by 52% at v = 2
    wave, 4 nodes/px, +5 px: off by 2% at v = 2
    """,
)


def _with_ladder(record: Progress, found: Ladder) -> LadderProgress:
    return LadderProgress(record.done, record.total, record.stage, record.seconds, record.note, ladder=found)


# -- measuring -------------------------------------------------------------------------------------------


def _with_waves(scene: Scene) -> tuple[Scene, str]:
    """Return the scene with diffraction, on which levels are compared, and its wave level."""
    return resolve_level(replace(scene, lenslet_diffraction=True, main_diffraction=True))


def _places(period: tuple[int, int], count: int) -> list[tuple[int, int]]:
    """Return positions spread over the period: an additive sequence of the plastic number."""
    ny, nx = period
    steps = (0.7548776662466927, 0.5698402909980532)
    return [(int(ny * ((0.1 + k * steps[0]) % 1)), int(nx * ((0.2 + k * steps[1]) % 1))) for k in range(max(1, count))]


def quick_steps(scene: Scene, level: str) -> list[LevelSampling]:
    """Return the steps of a wave level that are fast enough to be measured, fastest first."""

    def quick(step: LevelSampling) -> bool:
        if step.level == "debye":
            return step.sampling.nodes_per_px <= DEBYE_SHOWN
        return step.level != "wave" or step.sampling.margin_px <= WIDEST_SHOWN

    return [step for step in steps_for(scene, level) if quick(step)]


def rung_label(level: str, sampling: Sampling | None) -> str:
    """Return a label for a level and its sampling."""
    if sampling is None:
        return level
    if level == "debye":
        return f"{level}, {sampling.nodes_per_px} nodes/px"
    if level == "reference":
        return f"{level}, {sampling.samples_per_px or 8:g} samples/px"
    if level == "grid":
        return f"{level}, {sampling.samples_per_px or 4:g} samples/px, +{sampling.margin_px} px"
    how = {None: "", True: ", coherent", False: ", incoherent"}[sampling.coherent]
    return f"{level}, {sampling.nodes_per_px} nodes/px, +{sampling.margin_px} px{how}"


def _respond(engine: PlaneEngine, places: Sequence[tuple[int, int]]) -> NDArray[np.float32]:
    return np.stack([engine.rows([y], [x], workers=1)[0, 0] for y, x in places])


def _reference(
    scene: Scene, places: Sequence[tuple[int, int]], sampling: Sampling | None
) -> tuple[NDArray[np.float32], float, float]:
    """Return the reference's responses, its samples per pixel and its CPU-seconds per position."""
    choices = [sampling] if sampling is not None else [Sampling(samples_per_px=n) for n in REFERENCE_SAMPLES]
    reach = 2 * scene.shadow_radius_um / scene.reduced_pixel_um + 4 * scene.lattice.pitch_um / scene.reduced_pixel_um
    if sampling is None:
        # the finest grid that is still fast; the coarsest one if none is
        choices = [c for c in choices if reach * (c.samples_per_px or 8) <= LARGEST_GRID] or choices[-1:]
    engine = engine_for(scene, "reference", choices[0])
    start = time.process_time()
    values = _respond(engine, places)
    return values, choices[0].samples_per_px or 8, (time.process_time() - start) / len(places)


def _measure(
    scene: Scene,
    level: str,
    sampling: Sampling | None,
    places: Sequence[tuple[int, int]],
    truth: NDArray[np.float32],
    shares: CostScaling,
) -> LadderRung:
    start = time.process_time()
    engine = engine_for(scene, level, sampling)
    setup = time.process_time() - start
    error = np.abs(_respond(engine, places).astype(np.float64) - truth).sum() / truth.sum(dtype=np.float64)
    positions = scene.period[0] * scene.period[1]
    plane = engine.predicted_seconds(positions) * computed_share(engine)
    label, whole = rung_label(level, sampling), shares.seconds(setup, plane)
    return LadderRung(level, sampling, label, float(error), setup, plane / positions, whole)


def _marked(rungs: Sequence[LadderRung]) -> tuple[LadderRung, ...]:
    """Return the samplings by time, marked as efficient if no other is both faster and more accurate."""
    best = math.inf
    out = []
    for rung in sorted(rungs, key=lambda r: (r.whole_seconds, r.error)):
        out.append(replace(rung, efficient=rung.error < best))
        best = min(best, rung.error)
    return tuple(out)


# -- picture ---------------------------------------------------------------------------------------------


def draw_ladder(found: Ladder, path: str | os.PathLike[str], title: str = "") -> None:
    """Write a PNG plot of the error as a function of the predicted CPU time for all of H.

    Raises
    ------
    StorageError
        If the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lfcal.camera import ScanPlan, preset
    >>> from lfcal.simulate import draw_ladder, ladder
    >>> from lfcal.simulate.effects import LensTypeDefocus
    >>> camera = preset("bench")
    >>> plan = ScanPlan(camera, (3, 5), cutout=(41, 41), depths_um=(camera.depth_of(2.0),), anchor=(160, 160))
    >>> found = ladder(plan, effects=[LensTypeDefocus()], positions=1, samplings=())
    >>> draw_ladder(found, "ladder.png", title="bench")
    >>> Path("ladder.png").read_bytes()[1:4]
    b'PNG'
    """
    from lfcal.base import COLOURS, LINES, figure, save_figure

    if not found.rungs:
        raise LfcalError("accuracy and time: no sampling conserved the energy; measure finer samplings (samplings=)")
    with figure(6.4, 4.2) as fig:
        axes = fig.add_subplot()
        for k, kind in enumerate(dict.fromkeys(_family(r) for r in found.rungs)):
            rungs = [r for r in found.rungs if _family(r) == kind]
            axes.plot([r.whole_seconds for r in rungs], [100 * r.error for r in rungs], "o", color=LINES[k], label=kind)
        best = [r for r in found.rungs if r.efficient]
        axes.plot(
            [r.whole_seconds for r in best],
            [100 * r.error for r in best],
            "-",
            color=COLOURS["muted"],
            lw=1,
            label="efficient",
        )
        axes.axhline(100 * found.tolerance, color=COLOURS["fair"], ls="--", lw=1, label="tolerance")
        if found.chosen is not None:
            at = found.chosen.whole_seconds, 100 * found.chosen.error
            axes.plot(*at, "*", ms=15, mfc="none", mec=COLOURS["good"], mew=1.5, label="picked")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("processor time for H (s)")
        axes.set_ylabel(f"L1 error relative to {found.reference} (%)")
        axes.set_title(title or f"Accuracy and processor time, v = {found.virtual_depth:.3g}")
        axes.legend()
        save_figure(fig, path)


def _family(rung: LadderRung) -> str:
    if rung.sampling is None or rung.level != "wave":
        return rung.level
    return f"{rung.level}, coherent" if rung.sampling.coherent else rung.level
