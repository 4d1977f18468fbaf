"""Seconds predicted from the description."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from lfcal.simulate import simulate_psf
from lfcal.simulate.accuracy import cost
from lfcal.simulate.accuracy.cost import engine_seconds, machine_rate
from lfcal.simulate.staging import outlook_of
from tests.simulate.common import small_plan


@pytest.mark.parametrize("level", ["geometric", "wave"])
def test_lenslets_that_miss_the_cutout_cost_nothing(level: str) -> None:
    """A shadow grows without end as the source goes away; those of its lenslets that are computed do not."""
    near, far, farther = (
        engine_seconds(outlook_of(small_plan(v, cutout=49), 0), level, 0.03) for v in (30.0, 300.0, 3000.0)
    )
    assert far < 1.2 * near and farther < 1.2 * near
    wide = engine_seconds(outlook_of(small_plan(300.0, cutout=99), 0), level, 0.03)
    assert 2 * far < wide < 5 * far


@pytest.fixture
def fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Forget what this process knows about the machine."""
    monkeypatch.setattr(cost, "_RATE", cost._Rate())
    monkeypatch.setattr(cost, "INTERVAL_S", 0.0)
    yield


@pytest.mark.usefixtures("fresh")
def test_a_slow_moment_does_not_stand(monkeypatch: pytest.MonkeyPatch) -> None:
    """One slow timing made forecasts 725 times too long for the life of a window."""
    moments = iter([2e7, 2e7, 2e7, 2e10, 1e8, 1e8])
    monkeypatch.setattr(cost, "_timed_rate", lambda: next(moments))
    outlook = outlook_of(small_plan(3.0, cutout=21), 0)
    first = engine_seconds(outlook, "geometric")
    assert engine_seconds(outlook, "geometric") == pytest.approx(first / 1000)
    assert engine_seconds(outlook, "geometric") == pytest.approx(first / 1000)


@pytest.mark.usefixtures("fresh")
def test_other_programs_do_not_slow_the_timing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock on the wall that runs a thousand times too fast, as it does for a process that rarely gets its turn."""
    monkeypatch.setattr(time, "perf_counter", lambda: 1000 * time.monotonic())
    assert 1e8 < machine_rate() < 1e13


@pytest.mark.usefixtures("fresh")
@pytest.mark.parametrize("off", [100.0, 0.01])
def test_simulations_correct_the_forecast(off: float, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = small_plan(3.0, cutout=21)
    monkeypatch.setattr(cost, "LEAST_RUN_S", 0.0)
    monkeypatch.setattr(cost, "_timed_rate", lambda: cost.FITTED_RATE / off)
    before = machine_rate()
    for _ in range(4):
        simulate_psf(plan, (), "wave", workers=1)
    # as far as simulations may correct it, in the right direction
    assert machine_rate() == pytest.approx(before * (5 if off > 1 else 0.2), rel=1e-6)
