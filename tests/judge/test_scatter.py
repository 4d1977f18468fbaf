"""The share of the light that a camera leaves, whatever is masked or dark."""

from __future__ import annotations

import numpy as np
import pytest

from lfcal.judge._scatter import misfit, variance_of

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


def test_noise_of_photons_is_no_misfit_and_errors_of_the_model_are_no_noise() -> None:
    """Noise that grows with the light, and an error of the model of 10 % of the light that grows faster."""
    rng = np.random.default_rng(3)
    light = (1000 * rng.random((20, 40, 40)) ** 4).astype(np.float32)
    seen = np.ones(light.shape, np.bool_)
    photons = (np.sqrt(4 + 2 * light) * rng.standard_normal(light.shape)).astype(np.float32)
    wrong = (0.1 * light * np.where(rng.random(light.shape) < 0.5, -1, 1)).astype(np.float32)
    for left, least, most in ((photons, 0.0, 0.03), (photons + wrong, 0.09, 0.11)):
        _, constant, slope = variance_of(left, light, seen)
        assert slope == pytest.approx(2, rel=0.25)
        assert least <= misfit(left, light, seen, constant + np.float32(slope) * light) < most
