"""Windows of the sensor, and the margins that light from outside may reach."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.recalibrate._window import SIDE, windows_of
from tests.recalibrate.common import small_plan


def test_a_small_sensor_is_one_window_with_all_pixels() -> None:
    (window,) = windows_of(small_plan(side=60))
    assert window.shape == (60, 60) and window.origin == (0, 0)
    assert window.plan.period == (40, 40)


def test_a_large_sensor_has_windows_in_the_middle_and_near_the_corners() -> None:
    plan = small_plan(side=900)
    found = windows_of(plan)
    assert len(found) == 5
    assert all(window.shape == (SIDE + 40, SIDE + 40) for window in found)
    ends = [np.add(window.origin, window.shape) for window in found]
    assert min(min(window.origin) for window in found) >= 0 and max(int(end.max()) for end in ends) <= 900
    middle = np.add(found[0].origin, np.array(found[0].shape) / 2)
    assert middle == pytest.approx([450, 450], abs=1)
    assert len(windows_of(plan, 2)) == 2


def test_a_side_with_light_at_its_edge_has_a_margin() -> None:
    (window,) = windows_of(small_plan(side=100))
    light = np.full(window.shape, 10, np.float32)
    light[40:60, 40:60] = 1000
    valid = np.ones_like(light)
    assert np.array_equal(window.trusted(light, valid), valid)
    light[:, -2:] = 500
    found = window.trusted(light, valid)
    assert found[:, -20:].max() == 0 and found[:, :-20].min() == 1
    # of a mosaic, other colours are 0 and not valid
    colour = np.zeros_like(light)
    colour[1::2, ::2] = 1
    assert np.array_equal(window.trusted(light * colour, colour), found * colour)
    light[:, -2:] = 25
    assert np.array_equal(window.trusted(light * colour, colour), colour)


def test_a_window_too_small_for_margins_has_none() -> None:
    (window,) = windows_of(small_plan(side=60))
    light = np.random.default_rng(0).uniform(0, 100, window.shape).astype(np.float32)
    assert window.trusted(light, np.ones_like(light)).min() == 1
