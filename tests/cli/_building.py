"""What tests of several packages build or compare."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from lfcal.camera import Camera, Microscope, PupilLenslets, Sensor
from lfcal.fit import Fit
from tests.fit.common import few_fit


def alike(one: Any, two: Any) -> bool:
    """Return whether two reports are equal, except for the time they took and the page."""
    if isinstance(one, dict):
        return one.keys() == two.keys() and all(alike(one[k], two[k]) for k in one if k not in ("seconds", "report"))
    if isinstance(one, list):
        return len(one) == len(two) and all(map(alike, one, two))
    return bool(one == two) or (isinstance(one, float) and math.isnan(one) and math.isnan(two))


def two_planes() -> Fit:
    """Return a fit of two planes: that of the few patterns, and the same a little farther away."""
    fit = few_fit()
    planned = replace(fit.planned, depths_um=(fit.planned.depths_um[0], 1.02 * fit.planned.depths_um[0]))
    setup = replace(fit.setup, depth_errors_um=(*fit.setup.depth_errors_um, 3.0))
    gains = np.array([fit.levels.gains[0], 0.9 * fit.levels.gains[0]])
    return replace(fit, planned=planned, setup=setup, levels=replace(fit.levels, gains=gains))


CENTRES = ((-210.0, 20.0), (190.0, -60.0))
DEPTHS = (-40.0, 0.0, 40.0)


def fourier_camera(centres: tuple[tuple[float, float], ...] = CENTRES) -> Camera:
    """Return a Fourier light-field microscope of two lenslets."""
    lenslets = PupilLenslets(centres, 30e3, 4e3, (4e3,), 200.0)
    return Camera("two", Microscope(20.0, 0.4, 1.0), lenslets, Sensor((131, 151), 5.5, 12, 20e3, 5.0), 0.55)
