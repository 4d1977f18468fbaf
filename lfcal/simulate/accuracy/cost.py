"""Cost of a simulation, predicted from the description, short timings on this machine and earlier simulations.

`lfcal.simulate.accuracy._work` counts the work of each engine, with times of a reference machine. A plane takes the
time of its tables and positions, and that of the probe. The probe computes tables and a few positions of the sampling,
and of the finer one with which it is compared. Forecasts for this machine are corrected by
`lfcal.simulate.accuracy.calibration`. The choice of a sampling uses the times of the reference machine alone. It is
therefore the same on every machine. `lfcal.simulate.predict_seconds` runs the engine briefly instead, and is more
accurate.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import replace

from lfcal.base import kernels_spared
from lfcal.camera import Microscope
from lfcal.simulate._pupil_scene import AnyScene, PupilScene
from lfcal.simulate.accuracy._work import FITTED_RATE, SET_UP, LightSizes, Traits, engine_work
from lfcal.simulate.accuracy.calibration import machine_speed
from lfcal.simulate.accuracy.sampling import LevelSampling, comparison, finer, steps_for
from lfcal.simulate.effects import Outlook, PupilOutlook
from lfcal.simulate.engines import SWITCH, pupil_cost
from lfcal.simulate.scene import Scene

__all__ = [
    "Traits",
    "correct_rate",
    "efficient_steps",
    "engine_seconds",
    "few_seconds",
    "seconds_within",
    "step_for",
    "step_seconds",
]

PROBED, PROBED_NEAR = 4, 12
"""Number of positions that a probe computes: in general, and near the native plane."""

PER_PLANE, PER_VALUE = 4e-3, 4e-9
"""CPU-seconds of a plane besides the engine: to start it, and for each value of its responses."""

RISK = 0.12
"""Largest fraction of a plane's time that may be lost if a coarser sampling turns out to be too coarse."""

WARY = 1.5
"""Largest factor on the expected error of a sampling whose failure would lose a larger fraction than `RISK`."""

REFERENCE_OVER_WAVE, REFERENCE_OVER_GRID = 280.0, 200.0
"""Ratio of the reference's time to that of windows, and of a grid."""

LEAST_RUN_S = 0.3
"""Smallest CPU-time of a plane, forecast or measured, that corrects forecasts; tables dominate shorter ones."""


def correct_rate(
    outlook: Outlook, level: str, tolerance: float, runs: int, took_s: float, traits: Traits | None = None
) -> None:
    """Correct later time forecasts with the measured computing time of one simulated plane.

    Planes for which both the forecast and the measured time are below `LEAST_RUN_S` are ignored, and so are those
    computed without compiled kernels (`kernels_spared`).

    Parameters
    ----------
    outlook, level, tolerance, traits
        As in `engine_seconds`.
    runs
        Number of light samples of the plane; the engine runs once for each.
    took_s
        Measured computing time (CPU-seconds).
    """
    if level in ("wave", "grid"):  # as it was forecast: the probe may have found another engine
        debye = isinstance(outlook.camera.optics, Microscope) and outlook.camera.has_lattice
        level = "debye" if debye else "wave"
    forecast = runs * engine_seconds(outlook, level, tolerance, traits) / _ratio(outlook, level, traits)
    if max(forecast, took_s) >= LEAST_RUN_S and not kernels_spared():
        plane = f"{zlib.crc32(repr((outlook.camera, outlook.z_um)).encode()):08x}"
        machine_speed().correct(_engine(outlook, level, traits), plane, forecast, took_s)


def _slowness() -> float:
    return FITTED_RATE / machine_speed().rate()


def _engine(outlook: Outlook, level: str, traits: Traits | None) -> str:
    """Return the name under which forecasts are corrected.

    Windows and grids have the same name, so that the choice between them is the same on every machine.
    """
    if isinstance(outlook, PupilOutlook):
        return "single lenslets"
    return "wave" if level == "debye" and traits is not None and not traits.separable else level


def _ratio(outlook: Outlook, level: str, traits: Traits | None) -> float:
    return machine_speed().ratio(_engine(outlook, level, traits))


def engine_seconds(outlook: Outlook, level: str, tolerance: float = 0.03, traits: Traits | None = None) -> float:
    """Return the estimated CPU-seconds of one plane at a level on this machine, for one light sample.

    Tables are included, and the probe of levels that have one. The levels are those of
    `lfcal.simulate.engines.base.LEVELS`. ``tolerance`` is the allowed relative L1 error of the computation. ``traits``
    are those of the effects; None: those of an ideal camera.
    """
    if isinstance(outlook, PupilOutlook) or level in ("geometric", "reference"):
        seconds = few_seconds(outlook, level, tolerance, math.prod(outlook.period))
        return _slowness() * _ratio(outlook, level, traits) * seconds
    return seconds_within(step_seconds(outlook, level, traits), tolerance)


def step_seconds(outlook: Outlook, level: str, traits: Traits | None = None) -> tuple[tuple[float, float], ...]:
    """Return a pair for each of the `efficient_steps`: its expected relative L1 error, and the CPU-seconds of a plane.

    The times are those of this machine. The arguments are as in `engine_seconds`.
    """
    factor, steps = _slowness() * _ratio(outlook, level, traits), _steps(outlook, level, traits)
    values = PER_PLANE + PER_VALUE * math.prod(outlook.period) * outlook.pixels
    return tuple(
        (step.expected, factor * (_plane_seconds(outlook, steps, step, traits) + values))
        for step in efficient_steps(outlook, level, traits)
    )


def seconds_within(steps: Sequence[tuple[float, float]], tolerance: float) -> float:
    """Return the time of the first of ``steps`` with an error within ``tolerance``, or else of the last, the finest.

    ``steps`` contains pairs (error, CPU-seconds), as returned by `step_seconds`.
    """
    return next((seconds for error, seconds in steps if error <= tolerance), steps[-1][1])


def few_seconds(outlook: Outlook, level: str, tolerance: float, positions: int) -> float:
    """Return the estimated CPU-seconds of ``positions`` source positions of a plane, including tables.

    The times are those of the reference machine. Decisions based on them are therefore the same on every machine. The
    other arguments are as in `engine_seconds`.
    """
    if isinstance(outlook, PupilOutlook):
        level = "reference" if level == "reference" else "wave"
        sampling = step_for(outlook.scene, level, tolerance).sampling
        return positions * pupil_cost(outlook.scene, level, sampling) / FITTED_RATE
    if level == "geometric":
        light = LightSizes.of(outlook)
        seen = light.lenslets(math.ceil(max(light.spots_px)), 1.0)
        return SET_UP + positions * (4.5e-6 * seen + 1e-9 * outlook.pixels + 5e-6)
    # the reference has no separate sampling here: its cost is a multiple of that of the wave engine
    step = step_for(outlook, "wave" if level == "reference" else level, tolerance)
    work = engine_work(outlook, step)
    if level == "reference":
        return positions * work.each * (REFERENCE_OVER_GRID if step.level == "grid" else REFERENCE_OVER_WAVE)
    return work.tables + work.positions(positions)


def _steps(described: AnyScene | Outlook, level: str, traits: Traits | None) -> tuple[LevelSampling, ...]:
    if traits is None or not isinstance(described, Outlook):
        return steps_for(described, level)
    return steps_for(described, level, exact=traits.exact, separable=traits.separable)


def _probed(described: Scene | Outlook) -> int:
    """Return the number of positions that a probe computes; see `lfcal.simulate.accuracy.probe.places`."""
    if isinstance(described, Outlook):
        near = described.has_lens and described.fresnel_main < SWITCH
    else:
        near = described.objective is None and described.fresnel_number < SWITCH
    return min(PROBED_NEAR if near else PROBED, math.prod(described.period))


def _probe_seconds(
    described: Scene | Outlook, steps: Sequence[LevelSampling], step: LevelSampling, traits: Traits | None
) -> float:
    """Return the CPU-seconds to measure the error of a step, without its own tables, which the plane uses."""
    count, other = _probed(described), comparison(steps, step)
    seconds = engine_work(described, step, traits).positions(count)
    if other is not None:
        finer_work = engine_work(described, other[0], traits)
    elif step.level == "debye" or (step.level == "wave" and step.sampling.coherent):
        finer_work = engine_work(described, LevelSampling(step.level, finer(step.sampling), 0.0), traits)
    else:
        return seconds
    return seconds + finer_work.tables + finer_work.positions(count)


def _plane_seconds(
    described: Scene | Outlook, steps: Sequence[LevelSampling], step: LevelSampling, traits: Traits | None
) -> float:
    """Return the CPU-seconds of a plane and its probe with one step, on the reference machine."""
    if traits is None:
        traits = Traits.of(described) if isinstance(described, Scene) else Traits()
    work = engine_work(described, step, traits)
    count = math.prod(described.period) * traits.computed(step.level)
    return work.tables + work.positions(count) + _probe_seconds(described, steps, step, traits)


def efficient_steps(
    described: AnyScene | Outlook, level: str, traits: Traits | None = None
) -> tuple[LevelSampling, ...]:
    """Return the efficient samplings of a level, fastest first: those for which no finer sampling is as fast.

    The first sampling with an expected error within a tolerance is therefore the fastest such sampling, and never
    slower than that for a smaller tolerance. If a failed attempt would noticeably delay the finer samplings, windows
    are left out, and the expected errors of other samplings include a reserve (`WARY`). Times are those of the
    reference machine, so that an H does not depend on the machine that computes it. ``traits`` are those of the effects
    on an outlook, as in `engine_seconds`.
    """
    steps = _steps(described, level, traits)
    if isinstance(described, PupilScene) or all(step.level != "grid" for step in steps):
        return steps  # samplings of one engine become slower as they become finer
    if traits is None and isinstance(described, Scene):
        traits = Traits.of(described)
    best, kept = math.inf, []
    for step in reversed(steps):
        seconds = _plane_seconds(described, steps, step, traits)
        risk = _attempt_seconds(described, steps, step, traits) / (RISK * best)
        if (risk > 1 and step.level == "wave") or seconds >= best:
            continue
        best = seconds
        # a gradual reserve: times of a scene and of the outlook on it differ slightly
        kept.append(replace(step, expected=min(risk, WARY) * step.expected) if risk > 1 else step)
    return tuple(reversed(kept))


def _attempt_seconds(
    described: Scene | Outlook, steps: Sequence[LevelSampling], step: LevelSampling, traits: Traits | None
) -> float:
    """Return the CPU-seconds that are lost if a sampling fails; the next one uses the comparison of a grid again."""
    work = engine_work(described, step, traits)
    if step.level == "wave":
        return work.tables + _probe_seconds(described, steps, step, traits)
    return work.tables + work.positions(_probed(described))


def step_for(
    described: AnyScene | Outlook, level: str, tolerance: float, traits: Traits | None = None
) -> LevelSampling:
    """Return the fastest sampling of a level whose expected error is within ``tolerance``, or else the finest one.

    ``traits`` are as in `efficient_steps`.
    """
    steps = efficient_steps(described, level, traits)
    return next((step for step in steps if step.expected <= tolerance), steps[-1])
