"""Trials of solvers against time."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from benchmarks import _solver_trials
from benchmarks._solver_scenes import Problem, Subject
from benchmarks._solver_tables import verdict
from benchmarks._solver_trials import Trial, trial
from lfcal.psf import PSFMatrix
from lfcal.reconstruct import Projector


def small() -> tuple[Subject, Projector, Problem]:
    H = PSFMatrix(np.random.default_rng(0).random((2, 3, 3, 5, 5), np.float32))
    P = Projector(H, (18, 18), workers=1)
    truth = np.random.default_rng(1).random((2, 18, 18))
    problem = Problem(truth, P.forward(truth).astype(np.float64) + 1.0, np.empty((0, 3)))
    return Subject("small", H, H, 18), P, problem


def test_a_solver_that_ends_before_its_time_is_judged_by_its_last_volume() -> None:
    # of ten iterations at most, in more time than they take
    found = trial(*small(), ("shell", "rl"), 1e9, 1.0)
    assert len(found.errors) == 10 and found.at(1) == found.errors[-1]


def test_judging_a_volume_leaves_no_thread_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads of linear algebra that wait for more would count as the processor time of the next iteration."""
    threads: list[int] = []

    def judged(volume: object, truth: object) -> float:
        threads.extend(found["num_threads"] for found in threadpool_info() if found["user_api"] == "blas")
        return 0.5

    monkeypatch.setattr(_solver_trials, "nrmse", judged)
    found = trial(*small(), ("shell", "rl"), 1e9, 1.0)
    assert set(found.errors) == {0.5} and found.stop[1] == 0.5
    assert threads and set(threads) == {1}


def test_who_wins_is_told_at_equal_time_and_after_its_own_iterations() -> None:
    """One iteration a second: the default is behind after 5 and 10, within 3 % after 15 and before 20."""
    seconds = tuple(float(k) for k in range(1, 21))
    ours = tuple(2.0 if k < 15 else 1.02 for k in seconds)
    trials = [
        Trial("bench", "shell", name, 1.0, seconds, errors, None, (1.0, 1.0))
        for name, errors in (("sieve", ours), ("rl", (1.0,) * 20))
    ]
    assert verdict(trials) == [
        "sieve wins or ties after 5 iterations of rl: bench nothing",
        "sieve wins or ties after 10 iterations of rl: bench nothing",
        "sieve wins or ties after 20 iterations of rl: bench shell",
        "sieve wins or ties after its own 15 iterations: bench shell",
    ]
