"""What is held as described, though what was found may stand in for it, is named."""

from __future__ import annotations

import numpy as np

from lfcal.camera import ScanPlan
from lfcal.fit import Setup, Unknown
from lfcal.fit.fit import problem_of
from lfcal.fit.model import Fineness, predict
from lfcal.fit.normal import Columns, Local
from lfcal.fit.setup import called_for
from lfcal.fit.stand_ins import stand_ins
from lfcal.fit.summary import summarised
from lfcal.progress import drain
from lfcal.simulate.effects import IndexMismatch
from tests.fit.common import measured, small_camera, some_index


def test_only_what_would_make_the_others_much_less_sure_is_named() -> None:
    unknowns = [Unknown(name, "some", "µm", 5.0, 0.5) for name in ("found", "other", "held")]
    which, held, u = np.array([0, 1]), np.array([2]), np.zeros(3)
    alike = np.array([[100.0, 0, 99.5], [0, 100, 0], [99.5, 0, 100]])
    # sigma 0.1 scales, or 0.1 / sqrt(1 - 0.995²)
    said = "held, held at 5 µm, with found (± 0.05 would be ± 0.5 µm)"
    assert stand_ins(unknowns, which, held, alike, u) == (said,)
    # known well beforehand it cannot be otherwise by as much
    known = alike + np.diag([0.0, 0.0, 40.0])
    assert stand_ins(unknowns, which, held, known, u) == ()
    apart = np.array([[100.0, 0, 98], [0, 100, 0], [98, 0, 100]])
    assert stand_ins(unknowns, which, held, apart, u) == () == stand_ins(unknowns, which, held[:0], alike, u)


def test_derivatives_of_a_round_keep_those_by_all_else() -> None:
    before = Columns(np.ones((3, 2, 4), np.float32))
    now = Columns(np.full((3, 2, 4), 2.0, np.float32)).beside(before, [1])
    assert now.shared[:, 0, 0].tolist() == [1.0, 2.0, 1.0]


def test_a_planes_distance_is_named_beside_the_depth_in_a_specimen() -> None:
    """Of an oil lens in water 2 µm of depth look as 0.1 µm of distance and some spherical aberration."""
    plan = ScanPlan.for_camera(small_camera("lfm_60x12"), depths_um=[-1.0, 2.0], cutout=15)
    setup = Setup(plan.camera, (*called_for(plan), IndexMismatch(1.38, 12.0)), (0.0, 0.0))
    index = some_index(plan, 4)
    light = predict(setup, plan, index, np.zeros((4, 2)), Fineness.coarse)
    noise = (4.0, 1.0)
    patterns = measured(plan, 16e3 * light / light.max(), index, noise)
    rest = ("wavefront", "higher_wavefront")
    names = ("geometry", "distance", *rest, "specimen", "crosstalk")
    problem = problem_of(patterns, setup, names, 1)
    point = problem.point(np.zeros(len(problem.vector)), Local(np.zeros((4, 2))), Fineness.coarse)
    columns = drain(problem.columns(point, range(len(problem.vector)), "", own=False))

    def named(*groups: str) -> tuple[str, ...]:
        (fit,) = summarised(problem, point, columns, groups=groups, tried=names, outliers=())
        return fit.unidentified

    (deep,) = named("geometry", "distance", *rest)
    assert deep.startswith("specimen_depth_um, held at 12 µm, with distance_um (± ")
    (near,) = named("geometry", "specimen", *rest)
    assert near.startswith("distance_um, held at 0 µm, with specimen_depth_um (± ")
    # found with both of them nothing is held, and standard deviations are what they are
    assert named("geometry", "distance", *rest, "specimen") == ()
