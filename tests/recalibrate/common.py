"""A small sensor, and frames of beads on it by a finer sampling than that of the fit."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from lfcal.base import plain
from lfcal.camera import ScanPlan, preset
from lfcal.fit import NewFrame, Setup
from lfcal.fit.model import Fineness, Sampling, predict
from lfcal.fit.parameters import ScanScales, Vector
from lfcal.fit.setup import starting_effects
from lfcal.psf import PSFMatrix
from lfcal.recalibrate._patterns import VoxelPatterns, Voxels, every_voxel, patterns_at
from lfcal.recalibrate._window import SensorWindow, windows_of

GROUPS = ("geometry", "iris")
WRONG = {"gap_um": 3.0, "offset_x_um": 1.0, "offset_y_um": -0.8, "f_number": 0.12}
"""Differences of the true camera from the described one."""


def small_plan(depths: tuple[float, ...] = (2.2, 2.7), side: int = 60, cutout: int = 21) -> ScanPlan:
    """Return the plan of the described camera with a small sensor."""
    camera = preset("bench")
    camera = replace(camera, sensor=replace(camera.sensor, shape=(side, side), prnu=0.0))
    return ScanPlan.for_camera(camera, virtual_depths=depths, cutout=cutout)


def the_window(plan: ScanPlan) -> SensorWindow:
    """Return the only window of a small sensor."""
    (window,) = windows_of(plan)
    return window


def described(plan: ScanPlan) -> Setup:
    """Return the setup from which a fit starts."""
    return Setup(plan.camera, starting_effects(plan), (0.0,) * len(plan.depths_um))


def true_setup(plan: ScanPlan) -> Setup:
    """Return the true camera of the frames."""
    vector = Vector(described(plan), ScanScales.of(the_window(plan).plan), GROUPS)
    return vector.setup_at(vector.at(WRONG))


@cache
def true_patterns(plan: ScanPlan) -> VoxelPatterns:
    """Return H of the true camera over the window, by finer sampling."""
    own = the_window(plan).plan
    return patterns_at(true_setup(plan), own, every_voxel(own), Fineness.fine, 1)


def beads(plan: ScanPlan, seed: int, count: int = 15) -> NDArray[np.float32]:
    """Return a volume ``(n,)`` of beads, none at the edge."""
    rng = np.random.default_rng(seed)
    nz, ny, nx = len(plan.depths_um), *the_window(plan).plan.period
    volume = np.zeros((nz, ny, nx), np.float32)
    for _ in range(count):
        volume[rng.integers(nz), rng.integers(3, ny - 3), rng.integers(3, nx - 3)] += rng.uniform(0.3, 1)
    return volume.ravel()


def frame_of(plan: ScanPlan, volume: NDArray[np.float32], seed: int, *, peak: float = 3000.0) -> NewFrame:
    """Return a noisy frame with a dark field that slopes; ``peak`` is the brightest pixel (electrons)."""
    rng = np.random.default_rng(seed)
    light = true_patterns(plan).images(volume[None])[0]
    y, x = np.mgrid[-1 : 1 : light.shape[0] * 1j, -1 : 1 : light.shape[1] * 1j]
    mean = light * peak / light.max() + 20 + 6 * y - 4 * x
    electrons = rng.poisson(mean) + 3 * rng.standard_normal(mean.shape)
    return NewFrame(electrons.astype(np.float32), noise=(9.0, 1.0), label=f"beads {seed}")


@contextmanager
def shared_patterns() -> Iterator[None]:
    """Return a context in which patterns of one setup, plan and sampling are computed once."""
    known: dict[bytes, VoxelPatterns] = {}

    def shared(setup: Setup, plan: ScanPlan, voxels: Voxels, sampling: Sampling, workers: int | None) -> VoxelPatterns:
        key = pickle.dumps((setup, plan, voxels, sampling))
        if key not in known:
            known[key] = patterns_at(setup, plan, voxels, sampling, workers)
        return replace(known[key], values=known[key].values.copy())  # derivatives are computed in place

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("lfcal.recalibrate.model.patterns_at", shared)
        yield


def small_h(plan: ScanPlan, setup: Setup) -> PSFMatrix:
    """Return H of a few positions by the model of a fit, with its camera and effects."""
    own = replace(plan, period=(3, 3))
    index = np.indices(own.shape[:3]).reshape(3, -1).T
    values = predict(setup, own, index, np.zeros((len(index), 2)), Fineness.fine).reshape(own.shape)
    known = {"effects": [{"name": one.name, **plain(one)} for one in setup.effects]}
    return PSFMatrix(
        values.astype(np.float32), depths=own.depths_um, camera=setup.camera, anchor=own.anchor, provenance=known
    )
