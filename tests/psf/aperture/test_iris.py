import math
from dataclasses import replace

import numpy as np
import pytest

from lfcal.psf.aperture import fit_aperture, joint_iris
from lfcal.psf.aperture._synthetic import Disturbance, depth_sum_of


def plane(blades, curvature, seed, *, noise=0.3, turned=False, side=131):
    disturbance = Disturbance(noise, ellipticity=0.0)
    image, truth = depth_sum_of(side, blades, curvature, disturbance, np.random.default_rng(seed))
    # all planes of an iris share its rotation: turn by hand would blur, so the fit's own is turned
    found = fit_aperture(image)
    return found, truth


def upright(found, truth, turned):
    """Return what the fit said, as if the iris had its first vertex at 0.2 rad, or upside down."""
    shift = 0.2 + (math.pi if turned else 0.0) - truth.rotation_rad
    counts = tuple(replace(c, rotation_rad=(c.rotation_rad + shift) % (2 * math.pi / c.blades)) for c in found.counts)
    return replace(found, counts=counts)


def planes(blades, curvature, noise, sides, turns=None):
    found = [plane(blades, curvature, seed, noise=noise) for seed in range(len(sides))]
    return [
        upright(a, t, side if turns is None else turns[k])
        for k, ((a, t), side) in enumerate(zip(found, sides, strict=True))
    ]


@pytest.mark.long
def test_planes_that_are_unclear_add_to_a_clear_one():
    sides = [False, True, False, True]
    seen = [*planes(9, 0.6, 0.2, sides[:1]), *planes(9, 0.6, 0.5, sides)[1:]]
    assert seen[0].confident and not all(a.confident for a in seen)
    iris = joint_iris(seen, sides)
    assert iris.confident and iris.blades == 9 and iris.planes == len(seen)
    assert abs(iris.curvature - 0.6) < 3 * iris.curvature_sigma
    assert iris.rotation_rad == pytest.approx(0.2, abs=0.03)
    assert iris.curvature_sigma < min(c.curvature_sigma for a in seen for c in a.counts if c.blades == 9)


def test_planes_that_are_each_unclear_state_no_iris():
    """A partly blocked iris made two unclear planes, whose joint count had a small error and was wrong."""
    seen = [replace(a, kind="", confident=False, refusal="unclear") for a in planes(6, 0.0, 0.05, [False, True])]
    assert joint_iris(seen, [False, True]) is None
    assert joint_iris([*planes(6, 0.0, 0.05, [False]), seen[1]], [False, True]).blades == 6


def test_a_side_taken_for_the_other_contradicts():
    sides = [False, True, False, True]
    seen = planes(9, 0.0, 0.05, sides)
    right = joint_iris(seen, sides)
    wrong = joint_iris(seen, [False] * 4)
    assert right.confident and right.blades == 9
    # half a step apart in every second plane
    assert wrong.blades != 9 or wrong.margin < right.margin / 2


def test_round_stops_stay_round_and_nothing_stays_nothing():
    seen = planes(9, 1.0, 0.02, [False, True])
    iris = joint_iris(seen, [False, True])
    assert (iris.blades, iris.confident) == (0, True) and "round" in iris.describe()
    assert joint_iris([fit_aperture(np.zeros((31, 31)))], [None]) is None
