"""Small scans of the bench camera that a fit takes seconds for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.fit import Measured, Setup
from lfcal.fit.fit import problem_of
from lfcal.fit.parameters import Vector
from lfcal.fit.setup import described_effects
from lfcal.fit.spread import spread_out

CORE = ("geometry", "focal_lengths", "iris")


def small_camera(name: str = "bench") -> Camera:
    camera = preset(name)
    return replace(camera, sensor=replace(camera.sensor, shape=(120, 120)))


@cache
def small_plan(cutout: int = 29, depths: tuple[float, ...] = (2.2, 2.7)) -> ScanPlan:
    return ScanPlan.for_camera(small_camera(), virtual_depths=depths, cutout=cutout)


def setup_of(plan: ScanPlan) -> Setup:
    return Setup(plan.camera, described_effects(plan.camera), (0.0,) * len(plan.depths_um))


def some_index(plan: ScanPlan, count: int) -> np.ndarray:
    every = np.argwhere(np.ones(plan.shape[:3], bool))
    return every[spread_out(every, count, plan.period)]


def measured(plan: ScanPlan, patterns: np.ndarray, index: np.ndarray, noise: tuple[float, float]) -> Measured:
    n = len(index)
    aside = np.zeros(n, bool)
    aside[spread_out(index, round(0.2 * n), plan.period)] = True
    valid = np.ones(patterns.shape, bool)
    return Measured(plan, index, patterns.astype(np.float32), np.tile(noise, (n, 1)), np.zeros((n, 2)), valid, aside)


def vector_of(plan: ScanPlan, groups: Sequence[str]) -> Vector:
    index = np.zeros((0, 3), np.intp)
    nothing = np.zeros((0, *plan.cutout), np.float32)
    empty = Measured(plan, index, nothing, np.zeros((0, 2)), np.zeros((0, 2)), nothing > 0, np.zeros(0, bool))
    return problem_of(empty, setup_of(plan), groups, 1).vector
