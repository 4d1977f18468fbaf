"""How finely an engine must compute for a tolerance, and what to do where that proves too coarse."""

from __future__ import annotations

from dataclasses import replace

from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.engines.base import EnergyError, PlaneEngine, Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.scene import Scene

__all__ = ["STEPS", "checked_engine", "incoherent_floor", "sampling_for"]

STEPS: tuple[tuple[Sampling, float], ...] = (
    (Sampling(nodes_per_px=2, margin_px=3), 0.10),
    (Sampling(nodes_per_px=3, margin_px=4), 0.03),
    (Sampling(nodes_per_px=4, margin_px=5), 0.012),
    (Sampling(nodes_per_px=4, margin_px=8), 0.008),
    (Sampling(nodes_per_px=4, margin_px=8, coherent=True), 0.014),
    (Sampling(nodes_per_px=5, margin_px=12, coherent=True), 0.009),
)
"""Samplings of the wave engine, cheapest first, with the relative L1 error that its sampling makes (measured)."""

DEBYE_NODES = ((1, 0.12), (2, 0.015), (3, 0.005), (4, 0.0))
"""Nodes per pixel of the Debye path, and the error from which each will do."""

RETRIES = 4


def incoherent_floor(outlook: Outlook) -> float:
    """Return the error of adding intensities of neighbouring lenslets instead of fields: 0.4 px over the pitch."""
    return 0.4 / outlook.camera.pitch_px


def sampling_for(outlook: Outlook, level: str, tolerance: float) -> Sampling:
    """Return the cheapest sampling of a level that keeps ``tolerance``, or the finest."""
    if level == "debye":
        return Sampling(nodes_per_px=next(n for n, error in DEBYE_NODES if tolerance >= error))
    if level == "reference":
        return Sampling(samples_per_px=12 if tolerance < 0.01 else 8)
    floor = incoherent_floor(outlook)
    for sampling, error in STEPS:
        if error + (0.0 if sampling.coherent else floor) <= tolerance:
            return sampling
    return STEPS[-1][0]


def finer(sampling: Sampling) -> Sampling:
    """Return the next finer sampling: a node more per pixel, and samples for a window a quarter wider."""
    return replace(sampling, nodes_per_px=min(32, sampling.nodes_per_px + 1), margin_px=sampling.margin_px + 3)


def checked_engine(scene: Scene, level: str, sampling: Sampling) -> tuple[PlaneEngine, Sampling]:
    """Return an engine, refined until its energy balances at four positions spread over the period, and how finely.

    Raises
    ------
    EnergyError
        If it does not balance after four refinements.
    """
    ny, nx = scene.period
    for attempt in range(RETRIES + 1):
        engine = engine_for(scene, level, sampling)
        try:
            # Four positions spread over the period stand for all; every response is certified again later.
            engine.rows(sorted({0, ny // 2}), sorted({nx // 4, (3 * nx) // 4}), workers=1)
        except EnergyError:
            if attempt == RETRIES:
                raise
            sampling = finer(sampling)
        else:
            break
    return engine, sampling
