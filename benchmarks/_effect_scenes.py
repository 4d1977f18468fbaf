"""Random cameras, depths and known errors of construction, as varied as real ones."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from lfcal.camera import Camera, ScanPlan
    from lfcal.simulate.effects import Effect

__all__ = ["random_plan"]

WIDEST = 121
"""Largest cutout (px); wider patterns are cropped, as a user would crop them."""

F_NUMBERS = (1.8, 16.0)
"""Smallest and largest working f-number of photographic lenses."""

OBJECTIVES = (
    (4, 0.1, 1.0),
    (10, 0.3, 1.0),
    (20, 0.5, 1.0),
    (40, 0.8, 1.0),
    (40, 0.95, 1.0),
    (60, 1.2, 1.33),
    (60, 1.4, 1.515),
)
VIRTUAL_DEPTHS = (0, 0, 0.02, -0.05, 0.2, -0.4, 0.7, -0.8, 1.2, 1.5, 2, 2.2, 3, 4, 6, -1.5, -2, -3, -5)
DEFOCUS = (0, 0, 1, -1, 3, -5, 10, 25, -25)
"""Distance from the focal plane in units of lambda / (2 NA²)."""


def random_plan(number: int) -> tuple[ScanPlan, tuple[Effect, ...]]:
    """Return the plan of one plane of a camera, and its four known errors of construction.

    About every fourth camera is a microscope. About every fifth plane is at or near the working plane.
    """
    import numpy as np

    from lfcal.base.errors import LfcalError
    from lfcal.camera import ScanPlan

    rng = np.random.default_rng(7000 + number)
    while True:
        try:
            camera, z_um = _microscope(rng) if rng.random() < 0.25 else _photographic(rng)
            plan = ScanPlan.for_camera(camera, depths_um=[z_um])
        except LfcalError:
            continue  # no object is imaged there, or the pattern is wider than the sensor
        plan = replace(plan, cutout=(min(plan.cutout[0], WIDEST), min(plan.cutout[1], WIDEST)))
        return plan, _known(rng, plan)


def _microscope(rng: np.random.Generator) -> tuple[Camera, float]:
    from lfcal.camera import Camera, LensletLattice, LensType, Microscope, Sensor

    magnification, na, index = OBJECTIVES[rng.integers(len(OBJECTIVES))]
    pixel = float(rng.choice([4.5, 6.5, 8.3]))
    pitch = pixel * float(rng.uniform(8, 16))
    gap = pitch * magnification / (2 * na) * float(rng.uniform(0.85, 1.15))
    focal = gap * float(rng.choice([1.0, 1.0, 1.0, 0.8]))
    camera = Camera(
        "microscope",
        Microscope(float(magnification), na, index),
        LensletLattice("square", pitch, gap, (LensType(focal),)),
        Sensor((800, 800), pixel, 12, 20e3, 5.0),
        wavelength_um=float(rng.uniform(0.45, 0.68)),
        bandwidth_um=float(rng.choice([0, 0.01, 0.02, 0.05, 0.1])),
    )
    return camera, float(rng.choice(DEFOCUS)) * camera.wavelength_um / na**2 / (2 if na > 1 else 1)


def _photographic(rng: np.random.Generator) -> tuple[Camera, float]:
    from lfcal.camera import Camera, LensletLattice, LensType, MainLens, Sensor

    pixel = float(rng.choice([2.2, 3.45, 4.5, 5.5, 7.4, 9.0]))
    low, high = map(math.log, F_NUMBERS)
    working = math.exp(float(rng.uniform(low, high)))
    pitch = pixel * float(rng.uniform(9, 20))
    hexagonal = rng.random() < 0.7
    focal = float(rng.choice([25e3, 50e3, 100e3]))
    distance = focal * float(rng.choice([4, 6, 12]))
    image = 1 / (1 / focal - 1 / distance)
    gap = pitch * working * float(rng.uniform(0.9, 1.1))
    alike = [(2.0,), (3.0,), (math.inf,)]
    kinds = [*alike, (2.0, 3.0, 5.0), (1.8, 2.5, 4.0)] if hexagonal else alike
    types = tuple(LensType.focused_at(v, gap) for v in kinds[rng.integers(len(kinds))])
    camera = Camera(
        "photographic",
        MainLens(
            focal,
            working * focal / image,
            distance,
            blades=int(rng.choice([0, 5, 6, 7, 9])),
            blade_curvature=float(rng.choice([0, 0, 0.5, 0.9])),
            blade_rotation_rad=0.3,
        ),
        LensletLattice(
            "hexagonal" if hexagonal else "square", pitch, gap, types, clear_um=pitch * float(rng.uniform(0.85, 0.98))
        ),
        Sensor((800, 800), pixel, 12, 20e3, 5.0),
        wavelength_um=float(rng.uniform(0.45, 0.68)),
        bandwidth_um=float(rng.choice([0, 0.01, 0.02, 0.05, 0.1])),
    )
    return camera, camera.depth_of(float(rng.choice(VIRTUAL_DEPTHS)))


def _known(rng: np.random.Generator, plan: ScanPlan) -> tuple[Effect, ...]:
    from lfcal.camera import MainLens
    from lfcal.simulate import effects

    camera = plan.camera
    pool: list[Effect] = [
        effects.Spherical(float(rng.choice([0.03, 0.1, 0.3]))),
        effects.LensletGap(float(rng.choice([0.002, 0.01, -0.02])) * camera.lattice.gap_um),
        effects.ArrayRotation(math.radians(float(rng.choice([0.02, 0.1, 0.3])))),
        effects.PitchError(float(rng.choice([1e-4, 1e-3, 3e-3]))),
        effects.Crosstalk(float(rng.choice([0.002, 0.01, 0.05]))),
        effects.FiniteSource(float(rng.choice([0.2, 0.6, 1.5])) * camera.step_um(plan.depths_um[0])),
        effects.PixelFill(float(rng.choice([0.5, 0.8, 0.95]))),
    ]
    if isinstance(camera.optics, MainLens):  # in a microscope, only rotationally symmetric aberrations are computed
        pool.append(effects.Coma(float(rng.choice([0.03, 0.1, 0.3])), 0.7))
    return tuple(pool[k] for k in rng.choice(len(pool), 4, replace=False))
