"""``python -m benchmarks effects``: estimates of effects and errors, compared with finer simulations."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import typer

from lfcal.cli._console import print_json, print_table
from lfcal.cli._options import JsonOption

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from lfcal.camera import ScanPlan
    from lfcal.simulate import EffectSelection
    from lfcal.simulate.effects import Effect

__all__ = ["Judged", "difference", "finest", "judge", "other_positions", "register"]

FINEST = 0.003
"""Expected error of the computation with which estimates are compared."""

REFERENCE = 0.002
"""Expected error of the coherent reference with which simulations are compared."""

JUDGE = 2
"""Index of the grid that is the reference for microscopes with exact angles; finer than those usually chosen."""

SMALLEST = 0.002
"""Estimates are judged if they or the true value exceed this fraction of the image."""

MOST_RUNS = 24
"""Largest number of samples of the light; effects that need more are left out of a scene."""


@dataclass(frozen=True, slots=True)
class Judged:
    """Results for one scene.

    Attributes
    ----------
    scene
        Number and description of the random scene.
    pairs
        Name of each effect, its estimate, whether the estimate was measured, and the true value.
    tolerance, error
        Requested and true relative L1 error.
    stated
        Error that the plane states.
    seconds
        Processor time of the plan, including measurements of effects (s).
    """

    scene: str
    pairs: tuple[tuple[str, float, bool, float], ...]
    tolerance: float
    error: float
    stated: float
    seconds: float

    @property
    def telling(self) -> list[tuple[str, float, bool, float]]:
        """The pairs that are large enough to matter."""
        return [pair for pair in self.pairs if max(pair[1], pair[3]) > SMALLEST]


def register(bench: typer.Typer) -> None:
    """Add ``effects`` to the benchmarks."""
    bench.command("effects")(command)


def command(
    scenes: int = typer.Option(60, min=1, help="Number of random cameras and depths."),
    tolerance: float = typer.Option(0.03, help="Requested relative L1 error."),
    *,
    first: int = typer.Option(0, min=0, help="Number of the first scene."),
    json: JsonOption = False,
) -> None:
    """Compare estimates of effects and the stated errors of simulations with the truth, for random cameras.

    Example: `python -m benchmarks effects --scenes 20`
    """
    found = []
    for number in range(first, first + scenes):
        judged = judge(number, tolerance)
        found.append(judged)
        if not json:
            off = [f"{name} {e / max(t, 1e-9):.2g}" for name, e, _, t in judged.telling if not within(e, t)]
            typer.echo(
                f"{judged.scene}: error {100 * judged.error:.2g} % (stated {100 * judged.stated:.2g} %), "
                f"{len(judged.telling) - len(off)} of {len(judged.telling)} estimates within a factor of 2"
                + (f"; {', '.join(off)}" if off else "")
            )
    _report(found, tolerance, json)


def within(estimate: float, truth: float, factor: float = 2.0) -> bool:
    """Return whether an estimate is right within a factor."""
    return truth / factor <= estimate <= truth * factor


def _report(found: Sequence[Judged], tolerance: float, json: bool) -> None:
    pairs = [pair for judged in found for pair in judged.telling]
    good = sum(within(e, t) for _, e, _, t in pairs)
    kept = sum(judged.error <= tolerance for judged in found)
    if json:
        print_json({"scenes": found, "within_2": good, "estimates": len(pairs), "within_tolerance": kept})
        return
    rows = []
    for name in sorted({pair[0] for pair in pairs}):
        own = [pair for pair in pairs if pair[0] == name]
        right = sum(within(e, t) for _, e, _, t in own)
        rows.append([name, str(len(own)), str(sum(m for _, _, m, _ in own)), f"{100 * right / len(own):.0f} %"])
    print_table(["effect", "scenes", "measured", "within a factor of 2"], rows)
    typer.echo(f"estimates within a factor of 2: {good} of {len(pairs)} ({100 * good / max(1, len(pairs)):.1f} %)")
    typer.echo(f"simulated within {100 * tolerance:g} %: {kept} of {len(found)} ({100 * kept / len(found):.1f} %)")


def judge(number: int, tolerance: float) -> Judged:
    """Return the stated and the true values of a random scene."""
    from benchmarks._effect_scenes import random_plan
    from lfcal.simulate import plan_effects
    from lfcal.simulate.plane_task import budgeted
    from lfcal.simulate.response import PlaneResponse
    from lfcal.simulate.staging import outlook_of

    plan, known = random_plan(number)
    outlook = outlook_of(plan, 0)
    known = tuple(e for e in known if e.runs(outlook) <= MOST_RUNS)
    start = time.process_time()
    selection = plan_effects(plan, tolerance, effects=known)
    seconds = time.process_time() - start
    counting = _counting(selection, known)
    pairs = tuple(_pairs(plan, selection, counting))
    chosen, share = budgeted(selection, plan, tolerance).at(plan.depths_um[0])
    ys, xs = other_positions(plan)
    response = PlaneResponse(plan, 0, chosen, tolerance=share)
    some = (ys[:2], xs[:4]) if len(xs) > 3 else (ys[:1], xs[:2])
    error = difference(response.rows(*some), finest(plan, counting, *some))
    kind = f"v {outlook.virtual_depth:.2g}" if outlook.has_lens else f"z {outlook.z_um:.2g} µm"
    name = f"scene {number}, {plan.camera.name} f/{outlook.f_number:.3g}, {kind}"
    return Judged(name, pairs, tolerance, error, response.reached + selection.left_out[0], seconds)


def _counting(selection: EffectSelection, known: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return the effects on H of this camera: those that are not errors of construction, and the known errors."""
    names = {effect.name for effect in known}
    rows = (row.effect for row in selection.rows)
    return tuple(e for e in rows if e.acts_on.enters_h and (not e.deviation or e.name in names))


def other_positions(plan: ScanPlan) -> tuple[list[int], list[int]]:
    """Return rows and columns of positions at which the simulator measured nothing."""
    from lfcal.simulate.engines.extent import SWITCH
    from lfcal.simulate.staging import outlook_of

    ny, nx = plan.period
    outlook = outlook_of(plan, 0)
    if outlook.has_lens and outlook.fresnel_main < SWITCH:  # errors differ between positions
        return sorted({(k * ny) // 4 + ny // 7 for k in range(4)}), sorted({(k * nx) // 7 + nx // 9 for k in range(7)})
    return sorted({ny // 3, (6 * ny) // 7}), sorted({nx // 5, (4 * nx) // 7, (9 * nx) // 10})


def _pairs(
    plan: ScanPlan, selection: EffectSelection, counting: tuple[Effect, ...]
) -> Iterator[tuple[str, float, bool, float]]:
    from lfcal.simulate.effects import LensletDiffraction, LightEffect
    from lfcal.simulate.staging import outlook_of

    outlook = outlook_of(plan, 0)
    ys, xs = other_positions(plan)
    still = tuple(e for e in counting if not isinstance(e, LightEffect))
    beside = _wave(plan, still, ys, xs)
    for effect in counting:
        estimate = selection.row(effect.name).estimate
        if effect.runs(outlook) > MOST_RUNS:
            continue
        if isinstance(effect, LightEffect):
            truth = difference(beside, _wave(plan, (*still, effect), ys, xs))
        else:
            # without diffraction, rays are traced, and effects that need waves are not visible
            rays = isinstance(effect, LensletDiffraction)
            others = tuple(e for e in still if e is not effect and not (rays and e.needs_waves))
            truth = difference(_wave(plan, others, ys, xs), beside)
        yield effect.name, estimate.error, estimate.measured, truth


def difference(without: NDArray[np.float32], with_it: NDArray[np.float32]) -> float:
    """Return sum(|without - with|) / sum(|with|)."""
    import numpy as np

    a, b = np.asarray(without, np.float64), np.asarray(with_it, np.float64)
    return float(np.abs(a - b).sum() / np.abs(b).sum())


def _wave(plan: ScanPlan, effects: tuple[Effect, ...], ys: list[int], xs: list[int]) -> NDArray[np.float32]:
    """Return responses computed with finer sampling than all that is judged."""
    from lfcal.simulate.accuracy.sampling import steps_for
    from lfcal.simulate.response import PlaneResponse
    from lfcal.simulate.staging import resolve_level, scene_for

    scene, level = resolve_level(scene_for(plan, 0, effects))
    if level == "geometric":
        return PlaneResponse(plan, 0, effects, level=level).rows(ys, xs)
    steps = [step for step in steps_for(scene, level) if step.level != "wave" or step.sampling.coherent]
    step = next((step for step in steps if step.expected <= FINEST), steps[-1])
    return PlaneResponse(plan, 0, effects, level=step.level, sampling=step.sampling).rows(ys, xs)


def finest(plan: ScanPlan, effects: tuple[Effect, ...], ys: list[int], xs: list[int]) -> NDArray[np.float32]:
    """Return responses of the coherent reference or, for a microscope, of a fine grid or the finest Debye sampling."""
    from lfcal.base.errors import LfcalError
    from lfcal.simulate.accuracy.sampling import steps_for
    from lfcal.simulate.response import PlaneResponse
    from lfcal.simulate.staging import resolve_level, scene_for

    scene, level = resolve_level(scene_for(plan, 0, effects))
    steps = steps_for(scene, level)
    if level == "debye" and steps[0].level == "grid":  # the reference takes minutes for the separate fields
        step = steps[min(JUDGE, len(steps) - 1)]
        return PlaneResponse(plan, 0, effects, level=step.level, sampling=step.sampling).rows(ys, xs)
    if level == "wave":
        finest = next(step.sampling for step in steps_for(scene, "reference") if step.expected <= REFERENCE)
        try:
            return PlaneResponse(plan, 0, effects, level="reference", sampling=finest).rows(ys, xs)
        except LfcalError:  # the grid is too large
            return _wave(plan, effects, ys, xs)
    finest = replace(steps[-1].sampling, nodes_per_px=8)
    return PlaneResponse(plan, 0, effects, sampling=finest).rows(ys, xs)
