"""Small scans of the bench camera that a fit takes seconds for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.fit import Fit, Measured, Setup, fit_camera, measured_of
from lfcal.fit.fit import problem_of
from lfcal.fit.model import Fineness, predict
from lfcal.fit.parameters import Vector
from lfcal.fit.setup import described_effects
from lfcal.fit.spread import held_out_rows, spread_out
from lfcal.psf import PSFMatrix
from lfcal.psf.facts import Facts

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
    aside[held_out_rows(index, round(0.2 * n), plan)] = True
    valid = np.ones(patterns.shape, bool)
    return Measured(plan, index, patterns.astype(np.float32), np.tile(noise, (n, 1)), np.zeros((n, 2)), valid, aside)


@cache
def few_patterns() -> PSFMatrix:
    """Return an H of eight positions, six of them recorded with noise, whose gap is 1 % off its camera's."""
    plan = replace(small_plan(15, (2.2,)), period=(2, 4))
    true = replace(plan.camera, lattice=replace(plan.camera.lattice, gap_um=1.01 * plan.camera.lattice.gap_um))
    index = np.argwhere(np.ones(plan.shape[:3], bool))[[0, 1, 3, 4, 6, 7]]
    setup = replace(setup_of(plan), camera=true)
    light = predict(setup, plan, index, np.zeros((len(index), 2)), Fineness.finest)
    rng = np.random.default_rng(0)
    clean = 16e3 * np.maximum(light, 0) / light.max()
    noisy = rng.poisson(clean) + 8.0 * rng.standard_normal(clean.shape)
    values, recorded = np.zeros(plan.shape, np.float32), np.zeros(plan.shape[:3], int)
    values[tuple(index.T)], recorded[tuple(index.T)] = noisy, 1
    noise = np.tile([64.0, 1.0], (*plan.shape[:3], 1))
    facts = Facts.of(plan.shape[:3], plan.cutout, recorded=recorded, noise=noise)
    return PSFMatrix(values, depths=plan.depths_um, camera=plan.camera, anchor=plan.anchor, facts=facts)


@cache
def few_fit() -> Fit:
    """Return the fit of the few patterns' array."""
    return fit_camera(measured_of(few_patterns()), unknowns=["geometry"], workers=1)


def vector_of(plan: ScanPlan, groups: Sequence[str]) -> Vector:
    index = np.zeros((0, 3), np.intp)
    nothing = np.zeros((0, *plan.cutout), np.float32)
    empty = Measured(plan, index, nothing, np.zeros((0, 2)), np.zeros((0, 2)), nothing > 0, np.zeros(0, bool))
    return problem_of(empty, setup_of(plan), groups, 1).vector
