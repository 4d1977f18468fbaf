"""Seconds predicted from the description."""

from __future__ import annotations

import pytest

from lfcal.simulate.accuracy.cost import engine_seconds
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
