"""The share of the light that a camera leaves, whatever is masked or dark."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.inspect.scatter import misfit

LIGHT = np.full((6, 5, 5), 100.0, np.float32)
SEEN = np.ones(LIGHT.shape, np.bool_)
NOISE = np.ones_like(LIGHT)


def test_it_is_that_of_the_patterns_that_are_seen() -> None:
    left, valid = 0.2 * LIGHT, SEEN.copy()
    valid[:4] = False
    assert misfit(left, LIGHT, valid, 0 * NOISE) == pytest.approx(0.2)
    assert misfit(left, LIGHT, ~SEEN, NOISE) == 0.0


def test_where_there_should_be_no_light_nothing_is_explained() -> None:
    assert misfit(1e3 * LIGHT, 0 * LIGHT, SEEN, NOISE) == 1.0


def test_noise_is_no_misfit() -> None:
    left = np.random.default_rng(0).standard_normal(LIGHT.shape).astype(np.float32)
    assert misfit(left, LIGHT, SEEN, NOISE) < 0.01
