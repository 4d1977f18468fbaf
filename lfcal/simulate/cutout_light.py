"""Fraction of the light that is inside the cutout of an H; the rest is lost, whatever the tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import ScanPlan
from lfcal.psf import PSFMatrix
from lfcal.simulate._pupil_scene import PupilScene
from lfcal.simulate.engines import lattice_passed, pupil_passed
from lfcal.simulate.plane_task import Budget, EffectsLike, budgeted
from lfcal.simulate.scene import Scene
from lfcal.simulate.sensor import white_tile
from lfcal.simulate.staging import scene_for

__all__ = ["light_in_cutout"]

PLACES = 16
"""Largest number of positions along each axis of the period at which the light is summed."""


def light_in_cutout(H: PSFMatrix, plan: ScanPlan, effects: EffectsLike) -> tuple[float, ...]:
    """Return the light inside the cutout relative to the light that the lenslets transmit, for each plane.

    Parameters
    ----------
    H
        H simulated for ``plan``.
    plan, effects
        As in `simulate_psf`.

    Returns
    -------
    tuple of float
        Means over positions spread evenly over the period, one for each plane, at most 1; NaN if no light passes.
    """
    budget = budgeted(effects, plan, None)
    rows, columns = (_evenly_spaced(n) for n in plan.period)
    if plan.camera.has_lattice:
        passed = _passed_by_lattice(plan, budget)
    else:
        scenes = (scene_for(plan, z, budget.at(depth)[0]) for z, depth in enumerate(plan.depths_um))
        passed = [pupil_passed(scene) for scene in scenes if isinstance(scene, PupilScene)]
    found = []
    for z, light in enumerate(passed):
        held = [float(np.sum(H[z, int(y), int(x)], dtype=np.float64)) for y in rows for x in columns]
        found.append(min(1.0, float(np.mean(held)) / light) if light > 0 else float("nan"))
    return tuple(found)


def _passed_by_lattice(plan: ScanPlan, budget: Budget) -> list[float]:
    """Return the light that the lenslets let through, by planes."""
    each = [budget.at(depth)[0] for depth in plan.depths_um]
    scenes = (scene_for(plan, z, effects) for z, effects in enumerate(each))
    found = [lattice_passed(scene) for scene in scenes if isinstance(scene, Scene)]
    # by rays if pixels respond differently to angles: the mean over one cell of the array, or over the part of it that
    # the sensor contains, beginning where it fits
    sizes = plan.camera.sensor.shape
    ny, nx = (max(1, min(round(side), n)) for side, n in zip(plan.cell_camera.period_px, sizes, strict=True))
    row, column = (min(a, float(n - size)) for a, n, size in zip(plan.anchor, sizes, (ny, nx), strict=True))
    cell = replace(plan, period=(ny, nx), cutout=(1, 1), anchor=(row, column))
    return [
        float(white_tile(cell, effects).mean()) if light is None else light
        for light, effects in zip(found, each, strict=True)
    ]


def _evenly_spaced(count: int) -> NDArray[np.intp]:
    return np.unique(np.linspace(0, count - 1, min(count, PLACES)).round().astype(np.intp))
