"""Aperture fit: error of the iris measured in a depth-plane sum, versus the number of summed frames."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lfcal.accuracy.curves import CostPoint
from lfcal.accuracy.part import AccuracyPart, AccuracyStep, Measuring, Truth
from lfcal.accuracy.subject import Subject
from lfcal.base import InputError
from lfcal.camera import Camera, MainLens, Sensor
from lfcal.psf.aperture import fit_aperture
from lfcal.simulate import PlaneResponse, plan_effects

__all__ = ["PART", "iris_diameter_px", "noisy_sum"]

SIDES = (3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128)
"""Number of positions along each axis of the period: from coarse grids to every position."""

FULL = 0.8
"""Fraction of the full well that the brightest pixel reaches."""

ROUNDS = 3
"""Number of fits at each point of the curve, with different noise."""

TOLERANCE = 0.05


def measure(subject: Subject, seconds: float) -> Measuring:
    """Yield the error of the iris diameter fitted to noisy sums of patterns, for increasingly fine grids of positions.

    The patterns are simulated with rays.
    """
    plan, z = subject.planned, subject.middle
    camera = plan.camera
    diameter = iris_diameter_px(camera, plan.depths_um[z])
    effects = plan_effects(plan, TOLERANCE).effects
    response = PlaneResponse(plan, z, effects, level="geometric")
    yield Truth(
        f"the iris of the camera description: its shadow at plane {z} has the area of a circle of {diameter:.1f} px",
        (
            f"patterns from ray optics; brightest pixel at {100 * FULL:g} % of {camera.sensor.full_well_e:g} "
            f"e-, read noise {camera.sensor.read_noise_e:g} e-; {ROUNDS} fits for each point",
            "lenslets blur the sum by their width: the error that remains with all positions is due to this "
            "blur, not to noise",
        ),
    )
    ny, nx = plan.period
    done = (0, 0)
    for side in SIDES:
        grid = min(side, ny), min(side, nx)
        if grid == done:
            return
        done = grid
        yield AccuracyStep(f"{grid[0]} x {grid[1]} positions")
        ys, xs = (
            np.unique(np.linspace(0, n - 1, k).round().astype(int)) for n, k in zip(plan.period, grid, strict=True)
        )
        total, brightest = np.zeros(plan.cutout), 0.0
        for y in ys:
            row = response.rows([y], xs, subject.workers)[0]
            total += row.sum(axis=0, dtype=np.float64)
            brightest = max(brightest, float(row.max()))
            yield AccuracyStep(f"{grid[0]} x {grid[1]} positions, row {y}", 0.0)
        yield _point(total / brightest, (len(ys), len(xs)), diameter, camera.sensor)


def iris_diameter_px(camera: Camera, z_um: float) -> float:
    """Return the diameter (px) of a circle with the area of the iris's shadow, for a source at depth ``z_um`` (µm).

    Without the lenslets, a ray through the point p of the iris would meet the sensor at ``p (a - B)/(b + a)``, relative
    to the chief ray. Here p is measured from the centre of the iris, and b is the distance from the main lens to the
    lenslet array. The distances from the array to the image, a, and to the sensor, B, are positive behind the array.

    Raises
    ------
    InputError
        If the camera has no main lens, or the shadow is smaller than a lenslet.
    """
    optics = camera.optics
    if not isinstance(optics, MainLens):
        raise InputError.expected(
            "iris to measure", "the iris of a main lens", "a microscope", "leave the part aperture out (--part)"
        )
    shift = camera.image_shift_um(z_um)
    radius = optics.focal_length_um / optics.f_number / 2
    shadow = radius * abs(shift - camera.lattice.gap_um) / (optics.image_distance_um + shift)
    if 2 * shadow < camera.lattice.clear_diameter_um:
        raise InputError.expected(
            "iris", "a shadow larger than a lenslet", "an iris in focus", "choose planes farther from the focus"
        )
    return 2 * shadow / camera.sensor.pixel_um


def noisy_sum(total: NDArray[np.float64], frames: int, sensor: Sensor, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a sum of frames (electrons) with simulated photon and read noise.

    Parameters
    ----------
    total
        Sum of the noise-free patterns ``(rows, columns)``. A value of 1 is the brightest pixel of a single frame; it
        receives the fraction `FULL` of the full well.
    frames
        Number of frames in the sum, each with read noise.
    sensor, rng
        Sensor with its full well and read noise, and random generator for the noise.
    """
    electrons = np.maximum(total, 0) * FULL * sensor.full_well_e
    noise: NDArray[np.float64] = rng.normal(0, math.sqrt(frames) * sensor.read_noise_e, total.shape)
    return rng.poisson(electrons) + noise


def _point(total: NDArray[np.float64], grid: tuple[int, int], diameter: float, sensor: Sensor) -> CostPoint:
    frames = grid[0] * grid[1]
    found = [fit_aperture(noisy_sum(total, frames, sensor, np.random.default_rng([frames, k]))) for k in range(ROUNDS)]
    # a sum without an outline does not determine the diameter: the error is 100 %
    errors = [abs(fit.diameter_px / diameter - 1) if fit.diameter_px > 0 else 1.0 for fit in found]
    refused = next((fit.reason for fit in found if fit.refusal), "")
    settings = {"rows": grid[0], "columns": grid[1]}
    others = {"blades found": float(np.median([fit.blades for fit in found]))}
    label = f"{grid[1]} x {grid[0]} positions"
    return CostPoint(label, settings, float(np.mean(errors)), float(frames), "frames", others, refused)


PART = AccuracyPart(
    "aperture",
    "Depth-plane sum: aperture fit",
    "relative error of the iris diameter, mean of several fits",
    "frames summed in one depth plane",
    "frames",
    measure,
    rank=65,
)
