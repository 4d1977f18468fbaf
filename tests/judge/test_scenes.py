"""Scenes that costs are measured by: what is wrong costs the same in small and large images, and by whatever noise."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest

from lfcal.judge._scenes import SceneTrial, difference, scene
from tests.judge.common import clean, light, noisy, scaled, sensor


def test_the_scene_and_its_difference() -> None:
    one = scene((2, 40, 50))
    assert one.shape == (2, 40, 50) and one.min() > 0 and np.array_equal(one, scene((2, 40, 50)))
    assert difference(3 * one, one) == pytest.approx(0, abs=1e-12), "brightness as a whole is none"
    other = one + np.random.default_rng(0).normal(0, 0.1 * np.sqrt(np.mean(one**2)), one.shape)
    assert difference(other, one) == pytest.approx(0.1, rel=0.05)


@cache
def trial(side: int, seed: int) -> SceneTrial:
    return SceneTrial(light(), side, (partial(scene, seed=seed),))


@pytest.mark.long
@pytest.mark.parametrize(
    ("row", "images"),
    [
        (31, ((40, 0), (60, 2))),
        *(pytest.param(row, ((40, 0), (40, 1), (60, 2)), marks=pytest.mark.long) for row in (20, 31, 40)),
    ],
)
def test_a_dead_pixel_costs_the_same_wherever_the_image_ends_and_by_whatever_noise(
    row: int, images: tuple[tuple[int, int], ...]
) -> None:
    """Its row lies at the border of one image and amid another: light that is divided by noise cost .01 or .3."""
    image = sensor(1.0)
    image[row, 33] = 0.0
    costs = []
    for side, seed in images:
        one = trial(side, seed)
        alone = one.error(noisy(light(), seed))
        costs.append(one.error(noisy(scaled(light(), image), seed)) - alone)
    # at row 40 hardly any light falls: a pixel there costs a few hundredths of what noise does
    assert min(costs) > 0 and max(costs) < 1.6 * min(costs) + 0.05 * alone, costs


def test_patterns_without_light_are_all_wrong() -> None:
    assert trial(40, 0).error(np.zeros_like(light())) == 1.0
    assert trial(40, 0).error(light()) == pytest.approx(0, abs=1e-6)


@pytest.mark.long
def test_several_scenes_err_by_their_root_mean_square() -> None:
    both = SceneTrial(light(), 40, tuple(partial(scene, seed=seed) for seed in (0, 1)))
    each = [trial(40, seed).error(clean()) for seed in (0, 1)]
    assert both.error(clean()) == pytest.approx(np.sqrt(np.mean(np.square(each))), rel=0.02)
