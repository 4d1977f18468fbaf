"""Trials of solvers against time."""

from __future__ import annotations

import numpy as np

from lfcal.bench._solver_scenes import Problem, Subject
from lfcal.bench._solver_trials import trial
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import Projector


def test_a_solver_that_ends_before_its_time_is_judged_by_its_last_volume() -> None:
    H = PSFMatrix(np.random.default_rng(0).random((2, 3, 3, 5, 5), np.float32))
    P = Projector(H, (18, 18), workers=1)
    truth = np.random.default_rng(1).random((2, 18, 18))
    problem = Problem(truth, P.forward(truth).astype(np.float64) + 1.0, np.empty((0, 3)))
    # of ten iterations at most, in more time than they take
    found = trial(Subject("small", H, H, 18), P, problem, ("shell", "rl"), 1e9, 1.0)
    assert len(found.errors) == 10 and found.at(1) == found.errors[-1]
