"""Simulated light of random cameras: finite, never negative, no more than came in, or refused in one line."""

from __future__ import annotations

import pytest

from lfcal.simulate import predict_bytes
from tests.fuzz.cameras import random_trial, verdict

SEEDS = 12
FEW_SEEDS = 5
LONG_SEEDS = 400


def check(seeds: range, allowed: float = 0.5) -> None:
    wrong, refused = {}, 0
    for seed in seeds:
        trial = random_trial(seed)
        fault, refusal, *_ = verdict(trial)
        refused += bool(refusal)
        if fault:
            wrong[str(trial)] = fault
    assert not wrong, "\n".join(f"{fault}\n    {trial}" for trial, fault in wrong.items())
    assert refused <= allowed * len(seeds), f"{refused} of {len(seeds)} cameras are refused"


def test_very_few_cameras() -> None:
    check(range(1, FEW_SEEDS), allowed=0.75)


@pytest.mark.long
def test_a_few_cameras() -> None:
    check(range(1, SEEDS))


@pytest.mark.long
@pytest.mark.parametrize("seed", [112, 302, 202, 272, 307])
def test_nearly_black_cutouts_end_in_the_memory_that_was_foretold(seed: int) -> None:
    """A thousandth of the light and less: every step was far off by its own light, down to the finest there is."""
    fault, *_ = verdict(random_trial(seed))
    assert not fault


def test_dim_cutouts_may_try_every_step() -> None:
    """A cutout of 1.4 % of the shadow's area tried them all and took 1.76 GB, 1.25 by the forecast."""
    trial = random_trial(364)
    assert predict_bytes(trial.plan, trial.effects, tolerance=trial.tolerance, workers=1) > 1.76e9


@pytest.mark.long
def test_many_cameras() -> None:
    check(range(LONG_SEEDS))


@pytest.mark.long
def test_times_beside_their_forecast(capsys: pytest.CaptureFixture[str]) -> None:
    """Time depends on the machine: it is shown, and decides nothing."""
    lines = []
    for seed in range(60):
        _, _, forecast, taken = verdict(random_trial(seed), timed=True)
        if taken:
            lines.append(f"seed {seed:3d}: forecast {forecast:8.2f} s, taken {taken:8.2f} s, {taken / forecast:5.2f}")
    with capsys.disabled():
        print("\n" + "\n".join(lines))
    assert lines
