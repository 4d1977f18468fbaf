"""Twenty-four cameras with distorted lattices, for the long test of the fit."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tests.lattice.white_frames import WhiteFrame, barrel, draw_white, relay

SHAPE = (700, 900)
COUNT = 24


@dataclass(frozen=True)
class DistortedCamera:
    """A drawn white image, its nominal pitch (2 % wrong), and the lattice form that made it."""

    truth: WhiteFrame
    nominal_px: float
    form: str


def distorted_camera(number: int) -> DistortedCamera:
    """Square or hexagonal, turned up to 45 degrees, 1-3 px radial or relay distortion, SNR 20, 5 % dead."""
    rng = np.random.default_rng(100 + number)
    pitch, turn, by = rng.uniform(9, 26), rng.uniform(-math.pi / 4, math.pi / 4), rng.uniform(1, 3)
    reach = math.hypot(*SHAPE) / 2
    radial = number % 4 < 2
    sign, centre = rng.choice([-1, 1]), rng.uniform(-0.2, 0.2, 2) * reach
    bend = barrel(sign * by, reach, (centre[0], centre[1])) if radial else relay(by, reach, number)
    truth = draw_white(
        SHAPE, float(pitch), ("hexagonal", "square")[number % 2], rotation=float(turn), seed=number, bend=bend
    )
    return DistortedCamera(truth, float(pitch * rng.choice([0.98, 1.02])), "radial" if radial else "cubic")
