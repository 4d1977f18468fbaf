"""How finely an engine must compute for a tolerance, and what to do where that proves too coarse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.errors import InputError
from lfcal.simulate.effects.outlook import Outlook
from lfcal.simulate.engines.base import EnergyError, PlaneEngine, Sampling
from lfcal.simulate.engines.choose import engine_for
from lfcal.simulate.scene import Scene

__all__ = ["MOST_NODES", "STEPS", "checked_engine", "finer", "incoherent_floor", "sampling_for"]

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
"""Nodes per pixel of the Debye path, and the tolerance from which each is tried first; `checked_engine` measures."""

MOST_NODES = 12
"""Nodes per pixel up to which the Debye path is refined."""

SHARE = 0.5
"""Share of the tolerance that the sampling may take; the rest is for the effects that are left out."""

SUMMED = 2.5
"""What a node more per pixel divides the error of the sum over lenslets by, at least (measured: 2.6 to 4.4)."""

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


def checked_engine(
    scene: Scene, level: str, sampling: Sampling, tolerance: float = 0.03
) -> tuple[PlaneEngine, Sampling]:
    """Return an engine, refined until four positions spread over the period are right, and how finely.

    Their energy must balance. The Debye path, whose nodes are cheap, must also agree with itself at a node more per
    pixel to half of ``tolerance``: a node more divides its error by about five, so what changes is the error. Of
    arrays that are summed lenslet by lenslet it divides the error by `SUMMED` only, and what changes is raised by that.

    Raises
    ------
    EnergyError
        If the energy does not balance after four refinements.
    InputError
        If the Debye path does not reach ``tolerance`` with `MOST_NODES`.
    """
    engine, found, sampling = _balanced(scene, level, sampling)
    left = 1.0 if engine.level == "debye" else 1 - 1 / SUMMED
    # a microscope's array that is not square and upright is computed by the wave engine
    while level == "debye":
        following, better, next_sampling = _balanced(scene, level, finer(sampling))
        error = float((np.abs(found - better).sum(axis=(2, 3)) / better.sum(axis=(2, 3))).max()) / left
        if error <= SHARE * tolerance:
            break
        if next_sampling.nodes_per_px > MOST_NODES:
            z, least = scene.z_um, f"at least {error / SHARE:.1g} at a depth of {scene.z_um:g} µm"
            raise InputError.expected("tolerance", least, tolerance, f"raise it, or leave out the plane at {z:g} µm")
        engine, found, sampling = following, better, next_sampling
    return engine, sampling


def _balanced(scene: Scene, level: str, sampling: Sampling) -> tuple[PlaneEngine, NDArray[np.float64], Sampling]:
    """Return an engine whose energy balances, its responses at four positions, and how finely it samples."""
    ny, nx = scene.period
    for attempt in range(RETRIES + 1):
        engine = engine_for(scene, level, sampling)
        try:
            # Four positions spread over the period stand for all; every response is certified again later.
            found = engine.rows(sorted({0, ny // 2}), sorted({nx // 4, (3 * nx) // 4}), workers=1)
        except EnergyError:
            if attempt == RETRIES:
                raise
            sampling = finer(sampling)
        else:
            break
    return engine, found.astype(np.float64), sampling
