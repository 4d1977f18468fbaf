"""Random cameras that differ from their description, and patterns recorded with them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lfcal.camera import Camera, ScanPlan, preset
from lfcal.fit.fit import problem_of
from lfcal.fit.measured import Measured
from lfcal.fit.model import Fineness, predict
from lfcal.fit.parameters import GROUPS, Vector
from lfcal.fit.setup import Setup, described_effects
from lfcal.fit.spread import held_out_rows, spread_out

__all__ = ["Truth", "described_plan", "random_truth", "recorded"]

FULL = 0.8
"""Fraction of the full well that the brightest pixel reaches."""

DEPTHS = (3.0, 4.0)
"""Virtual depths of the planes."""

CUTOUTS = {"bench": 55, "r29": 141}


@dataclass(frozen=True, eq=False)
class Truth:
    """A true camera and its description.

    Attributes
    ----------
    plan
        The scan with the described camera.
    setup
        The true camera.
    values
        True values of all unknowns by name.
    """

    plan: ScanPlan
    setup: Setup
    values: Mapping[str, float]


def described_plan(name: str = "bench", *, cutout: int | None = None, depths: tuple[float, ...] = DEPTHS) -> ScanPlan:
    """Return the scan of some virtual depths of a preset on the smallest sufficient sensor."""
    camera = preset(name)
    size = cutout or CUTOUTS[name]
    ny, nx = (round(n) for n in camera.period_px)
    rows, columns = (n + size + 40 for n in (ny, nx))
    small: Camera = replace(camera, sensor=replace(camera.sensor, shape=(rows, columns)))
    return ScanPlan.for_camera(small, virtual_depths=depths, cutout=size)


def random_truth(plan: ScanPlan, rng: np.random.Generator, *, size: float = 0.3) -> Truth:
    """Return a camera with errors of 1-3 % of gap and focal lengths, aberrations, iris and offset errors.

    The aberrations add up in quadrature to ``size`` waves. The array is rotated by 0.1 degrees and displaced by a
    third of a pixel. The iris is rotated by 0.1 rad, and its size differs by 5 %. These values are rms values.
    """
    setup = Setup(plan.camera, described_effects(plan.camera), (0.0,) * len(plan.depths_um))
    vector = _vector(plan, setup)
    camera, pixel = plan.camera, plan.camera.sensor.pixel_um
    waves = rng.standard_normal(5)
    waves *= size / math.sqrt(float((waves**2).sum()))
    off = {
        "gap_um": camera.lattice.gap_um * _percent(rng),
        "rotation_rad": math.radians(0.1) * rng.standard_normal(),
        "offset_y_um": 0.33 * pixel * rng.standard_normal(),
        "offset_x_um": 0.33 * pixel * rng.standard_normal(),
        "f_number": 0.05 * 4.0 * rng.standard_normal(),
        "iris_rotation_rad": 0.1 * rng.standard_normal(),
    }
    off |= {f"focal_{k}_um": t.focal_length_um * _percent(rng) for k, t in enumerate(camera.lattice.types)}
    off |= dict(zip(("zernike_2_2", "zernike_2_m2", "zernike_3_1", "zernike_3_m1", "zernike_4_0"), waves, strict=True))
    u = np.array([off.get(one.name, 0.0) / one.scale for one in vector.unknowns])
    return Truth(plan, vector.setup_at(u), vector.values(u))


def _percent(rng: np.random.Generator) -> float:
    """Return a fraction of 1 to 3 % with a random sign."""
    return float(rng.choice([-1.0, 1.0]) * rng.uniform(0.01, 0.03))


def _vector(plan: ScanPlan, setup: Setup) -> Vector:
    nothing = np.zeros((0, *plan.cutout), np.float32)
    empty = np.zeros((0, 2))
    index = np.zeros((0, 3), np.intp)
    measured = Measured(plan, index, nothing, empty, empty, nothing > 0, np.zeros(0, np.bool_))
    return problem_of(measured, setup, GROUPS.names(), 1).vector


def recorded(
    truth: Truth,
    count: int,
    rng: np.random.Generator,
    *,
    stage_px: float = 0.0,
    index: NDArray[np.intp] | None = None,
) -> Measured:
    """Return ``count`` noisy patterns in electrons, spread over period and planes; a fifth of them is held out.

    The brightest pixel reaches 80 % of the full well. The noise is photon noise and read noise.
    """
    plan, sensor = truth.plan, truth.plan.camera.sensor
    every = np.argwhere(np.ones(plan.shape[:3], np.bool_))
    chosen = every[spread_out(every, count, plan.period)] if index is None else index
    beside = stage_px * rng.standard_normal((len(chosen), 2))
    light = predict(truth.setup, plan, chosen, beside, Fineness.finest).astype(np.float64)
    electrons = FULL * sensor.full_well_e * np.maximum(light, 0) / light.max()
    values = rng.poisson(electrons) + sensor.read_noise_e * rng.standard_normal(light.shape)
    aside = np.zeros(len(chosen), np.bool_)
    aside[held_out_rows(chosen, round(0.2 * len(chosen)), plan)] = True
    noise = np.tile([sensor.read_noise_e**2, 1.0], (len(chosen), 1))
    patterns = values.astype(np.float32)
    return Measured(plan, chosen, patterns, noise, np.zeros((len(chosen), 2)), patterns == patterns, aside)
