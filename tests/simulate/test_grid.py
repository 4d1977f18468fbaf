"""All lenslets on one grid: how few samples it takes."""

from __future__ import annotations

import pytest

from lfcal.simulate.engines.base import Sampling
from lfcal.simulate.response import PlaneResponse
from tests.simulate.common import BASE, difference, small_plan


@pytest.mark.parametrize(("samples", "error"), [(4.0, 0.015), (6.0, 0.005)])
def test_few_samples_are_not_taken_for_light_too_much(samples: float, error: float) -> None:
    plan = small_plan(3.0, cutout=55)
    found, finer = (
        PlaneResponse(plan, 0, BASE, level="grid", sampling=Sampling(s)).rows([1, 9], [2, 9, 23])
        for s in (samples, 10.0)
    )
    assert difference(found, finer) < error
